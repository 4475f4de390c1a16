#![doc = include_str!("body_masks.md")]

use std::collections::BTreeMap;

use evermap_algorithms::metric_map::body::BodySearch;
use evermap_contract::{Emit, Fault, Key, Operator, Pixels, Port, Reason, Sides, Stream, Work};
use evermap_schemas::Bytes;
use evermap_schemas::layers::{BodyMask, FrameImage, Keyframe};
use evermap_vision::{Grey, decode_grey, encode_png};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::pixels::{left_out, undecoded};

/// See the module's page.
pub struct BodyMasks;

/// Which images are compared.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct BodyMasksParams {
    /// Driven path between two images that are compared, at least (m): what moves past has then moved on.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub spacing_m: f64,
    /// Fewer images prove nothing: the mask is empty. With 2 m between them, 24 take 46 m, with a bend or two.
    #[schemars(range(min = 2))]
    pub fewest_images: u32,
    /// More images prove little more; they are taken farther apart instead.
    #[schemars(range(min = 2, max = 1000))]
    pub most_images: u32,
}

impl Default for BodyMasksParams {
    fn default() -> Self {
        Self {
            spacing_m: 2.0,
            fewest_images: 24,
            most_images: 96,
        }
    }
}

impl Operator for BodyMasks {
    const NAME: &'static str = "body_masks";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("body_masks.md");
    type Params = BodyMasksParams;
    type Output = BodyMask;

    fn work() -> Work<Self::Params> {
        let images = Port::session::<FrameImage>("images").pixels("image");
        let keyframes = Port::session::<Keyframe>("keyframes");
        Work::stream::<OfCamera>(images, Key::CAMERA, vec![keyframes])
    }
}

/// The images of one camera of a session.
struct OfCamera {
    fewest: usize,
    spacing_m: f64,
    /// Driven path by number of the keyframe.
    distances_m: BTreeMap<u32, f64>,
    /// Path of the last image that was compared.
    last_m: Option<f64>,
    grey: Grey,
    search: Option<Search>,
}

/// What was found of a camera so far.
struct Search {
    images: BodySearch,
    /// The mask, still empty.
    mask: BodyMask,
}

impl Stream for OfCamera {
    type Params = BodyMasksParams;
    type Row = FrameImage;

    fn open(params: &BodyMasksParams, sides: &Sides) -> Result<Self, Fault> {
        let keyframes = sides.rows::<Keyframe>("keyframes")?;
        let distances = keyframes.iter().map(|row| (row.keyframe, row.distance_m));
        let distances_m: BTreeMap<u32, f64> = distances.collect();
        let driven_m = distances_m.values().copied().fold(0.0, f64::max);
        Ok(Self {
            fewest: params.fewest_images as usize,
            spacing_m: params
                .spacing_m
                .max(driven_m / f64::from(params.most_images)),
            distances_m,
            last_m: None,
            grey: Grey::default(),
            search: None,
        })
    }

    fn push(
        &mut self,
        rows: Vec<FrameImage>,
        pixels: &Pixels,
        emit: &mut Emit<'_>,
    ) -> Result<(), Fault> {
        for (index, row) in rows.into_iter().enumerate() {
            if self.is_due(row.keyframe)
                && let Some(bytes) = pixels.get(index)
                && let Err(reason) = self.compare(row, bytes)
            {
                emit.skip(reason, 1);
            }
        }
        Ok(())
    }

    fn close(self, emit: &mut Emit<'_>) -> Result<(), Fault> {
        let Some(Search { images, mask }) = self.search else {
            return Ok(());
        };
        let found = images.found(self.fewest);
        let pixels = found.pixels().into_iter();
        let image = Grey {
            width: mask.width,
            height: mask.height,
            data: pixels.map(|body| if body { u8::MAX } else { 0 }).collect(),
        };
        let png = encode_png(&image).map_err(|error| Fault::bug(error.to_string()))?;
        emit.rows(vec![BodyMask {
            images: images.images() as u32,
            share: found.share(),
            png: Bytes(png),
            ..mask
        }])
    }
}

impl OfCamera {
    /// Whether the vehicle has moved on since the last image.
    fn is_due(&self, keyframe: u32) -> bool {
        let path_m = self.distances_m.get(&keyframe);
        path_m.is_some_and(|path_m| {
            self.last_m
                .is_none_or(|last| path_m - last >= self.spacing_m)
        })
    }

    fn compare(&mut self, row: FrameImage, bytes: &[u8]) -> Result<(), Reason> {
        decode_grey(bytes, &mut self.grey)
            .map_err(|error| left_out(&error, undecoded(&row.camera, &row.image.format)))?;
        let Grey { width, height, .. } = self.grey;
        self.last_m = self.distances_m.get(&row.keyframe).copied();
        let search = self.search.get_or_insert_with(|| Search {
            images: BodySearch::new([width, height]),
            mask: BodyMask {
                site: row.site,
                session: row.session,
                camera: row.camera,
                width,
                height,
                images: 0,
                share: 0.0,
                png: Bytes::default(),
            },
        });
        let added = search.images.add([width, height], &self.grey.data);
        added
            .then_some(())
            .ok_or("image has another size than the first of its camera".into())
    }
}
