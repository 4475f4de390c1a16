#![doc = include_str!("body_masks.md")]

use std::collections::BTreeMap;

use evermap_algorithms::metric_map::body::BodySearch;
use evermap_contract::{Emit, Fault, Key, Operator, Pixels, Port, Reason, Sides, Stream, Work};
use evermap_schemas::Bytes;
use evermap_schemas::layers::{BodyMask, FrameImage, Keyframe};
use evermap_vision::{Blind, Grey, ImageError, decode_grey, encode_png};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::masks::{CameraMasks, Masks};
use crate::inputs::pixels::{left_out, undecoded};
use crate::inputs::rig::frame;

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
    /// What is known of them.
    #[serde(flatten)]
    pub masks: Masks,
}

impl Default for BodyMasksParams {
    fn default() -> Self {
        Self {
            spacing_m: 2.0,
            fewest_images: 24,
            most_images: 96,
            masks: Masks::default(),
        }
    }
}

impl Operator for BodyMasks {
    const NAME: &'static str = "body_masks";
    const VERSION: u32 = 2;
    const PAGE: &'static str = include_str!("body_masks.md");
    type Params = BodyMasksParams;
    type Output = BodyMask;

    fn check(params: &Self::Params) -> Result<(), Fault> {
        params.masks.check()
    }

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
    drawn: CameraMasks,
    search: Option<Search>,
}

/// What was found of a camera so far.
struct Search {
    images: BodySearch,
    /// What somebody has drawn. An image of it is all there is to know.
    drawn: Blind,
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
            drawn: CameraMasks::new(&params.masks),
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
                && let Err(reason) = self.compare(row, bytes)?
            {
                emit.skip(reason, 1);
            }
        }
        Ok(())
    }

    fn close(self, emit: &mut Emit<'_>) -> Result<(), Fault> {
        let Some(search) = self.search else {
            return Ok(());
        };
        emit.rows(vec![search.found(self.fewest)?])
    }
}

impl Search {
    /// Of the images of a camera that this one is the first of.
    ///
    /// # Errors
    /// A user fault where the mask that somebody has given has another size.
    fn begin(row: FrameImage, size: [u32; 2], drawn: Option<&Blind>) -> Result<Self, Fault> {
        let [width, height] = size;
        let drawn = drawn.cloned().unwrap_or_default();
        if let Some(mask) = &drawn.mask
            && [mask.width, mask.height] != size
        {
            let (camera, session) = (frame(&row.camera), &row.session);
            let found = format!("{} x {}", mask.width, mask.height);
            return Err(Fault::user(format!(
                "expected a mask of camera `{camera}` of {width} x {height} pixels, as its images in session {session} have, found one of {found}"
            ))
            .next("give `mask` an image of that size, or sessions of another size a manifest of their own"));
        }
        Ok(Self {
            images: BodySearch::new(size),
            drawn,
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
        })
    }

    /// Whether there is nothing to learn.
    fn is_given(&self) -> bool {
        self.drawn.mask.is_some()
    }

    /// The mask of the camera.
    fn found(self, fewest: usize) -> Result<BodyMask, Fault> {
        let bug = |error: ImageError| Fault::bug(error.to_string());
        let Self {
            images,
            drawn,
            mask,
        } = self;
        let learnt = images.found(fewest);
        let mut image = drawn.painted(mask.width, mask.height).map_err(bug)?;
        let drawn = image.data.iter().filter(|value| **value > 0).count();
        for (value, body) in image.data.iter_mut().zip(learnt.pixels()) {
            if body {
                *value = u8::MAX;
            }
        }
        let covered = image.data.iter().filter(|value| **value > 0).count();
        Ok(BodyMask {
            images: images.images() as u32,
            // What is learnt is learnt by cells, of which the last may reach beyond the image.
            share: match drawn {
                0 => learnt.share(),
                _ => covered as f64 / image.data.len() as f64,
            },
            png: Bytes(encode_png(&image).map_err(bug)?),
            ..mask
        })
    }
}

impl OfCamera {
    /// Whether the vehicle has moved on since the last image.
    fn is_due(&self, keyframe: u32) -> bool {
        if self.search.as_ref().is_some_and(Search::is_given) {
            return false;
        }
        let path_m = self.distances_m.get(&keyframe);
        path_m.is_some_and(|path_m| {
            self.last_m
                .is_none_or(|last| path_m - last >= self.spacing_m)
        })
    }

    /// Takes an image in; gives the reason why not.
    fn compare(&mut self, row: FrameImage, bytes: &[u8]) -> Result<Result<(), Reason>, Fault> {
        if let Err(error) = decode_grey(bytes, &mut self.grey) {
            let undecoded = undecoded(&row.camera, &row.image.format);
            return Ok(Err(left_out(&error, undecoded)));
        }
        let size = [self.grey.width, self.grey.height];
        self.last_m = self.distances_m.get(&row.keyframe).copied();
        let search = match &mut self.search {
            Some(search) => search,
            none => {
                let drawn = self.drawn.of(&row.camera);
                none.insert(Search::begin(row, size, drawn)?)
            }
        };
        let added = search.is_given() || search.images.add(size, &self.grey.data);
        Ok(added
            .then_some(())
            .ok_or("image has another size than the first of its camera".into()))
    }
}
