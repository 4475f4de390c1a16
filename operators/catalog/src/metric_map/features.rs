#![doc = include_str!("features.md")]

use std::collections::BTreeMap;

use arrow::array::RecordBatch;
use evermap_contract::{Emit, Fault, Grain, Kernel, MapKernel, Mapper, Operator, Port, Sides};
use evermap_schemas::layers::{Features as FeaturesRow, FrameImage};
use evermap_schemas::{Bytes, Stamp, record};
use evermap_vision::{Blind, Decoder, FeatureParams, Grey, features};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::images::each_image;
use crate::inputs::rig::{Reason, frame};

/// See the module's page.
pub struct Features;

/// How features are found.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FeaturesParams {
    /// Features are found in the image resized by this factor; 0 brings it to a width of 600 to 1200 px.
    pub scale: f64,
    /// The most features of one image.
    pub count: u32,
    /// Octaves of the scale space.
    pub octaves: u32,
    /// Corners with less contrast than this are noise (grey values).
    pub min_contrast: u32,
    /// Where features are not wanted, by camera: polygons of [u, v] in the full image (px), such as the own body's
    /// outline. The camera `*` stands for all.
    pub mask: BTreeMap<String, Vec<Vec<[f64; 2]>>>,
}

impl Default for FeaturesParams {
    fn default() -> Self {
        let FeatureParams {
            count,
            octaves,
            min_contrast,
            ..
        } = FeatureParams::default();
        Self {
            scale: 0.0,
            count,
            octaves,
            min_contrast,
            mask: BTreeMap::new(),
        }
    }
}

impl Operator for Features {
    const NAME: &'static str = "features";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("features.md");
    type Params = FeaturesParams;
    type Output = FeaturesRow;

    fn ports() -> Vec<Port> {
        vec![Port::of::<FrameImage>("images", Grain::Row).with_pixels("image")]
    }

    fn kernel(params: FeaturesParams) -> Result<Kernel, Fault> {
        if !(0.0..=8.0).contains(&params.scale) {
            return Err(Fault::user(format!(
                "expected scale from 0 (chosen by size) to 8, found {}",
                params.scale
            )));
        }
        if !(1..=255).contains(&params.min_contrast) {
            return Err(Fault::user(format!(
                "expected min_contrast from 1 to 255 grey values, found {}",
                params.min_contrast
            )));
        }
        Ok(Kernel::Map(Box::new(Opener { params })))
    }
}

record! {
    /// The columns of an image row beside its pixels.
    pub struct Look {
        /// Site.
        site: String,
        /// Session.
        session: String,
        /// Exposure.
        stamp: Stamp,
        /// Number of the keyframe.
        keyframe: u32,
        /// Camera.
        camera: String,
    }
}

struct Opener {
    params: FeaturesParams,
}

impl MapKernel for Opener {
    fn open(&self, _: &Sides) -> Result<Box<dyn Mapper>, Fault> {
        let FeaturesParams {
            scale,
            count,
            octaves,
            min_contrast,
            mask,
        } = &self.params;
        let blind = |polygons: &Vec<_>| Blind {
            polygons: polygons.clone(),
        };
        Ok(Box::new(Finder {
            params: FeatureParams {
                scale: (*scale > 0.0).then_some(*scale),
                count: *count,
                octaves: *octaves,
                min_contrast: *min_contrast,
            },
            blind: mask
                .iter()
                .map(|(camera, polygons)| (frame(camera).to_owned(), blind(polygons)))
                .collect(),
            everywhere: Blind::default(),
        }))
    }
}

struct Finder {
    params: FeatureParams,
    /// By camera.
    blind: BTreeMap<String, Blind>,
    everywhere: Blind,
}

impl Mapper for Finder {
    fn map(&self, batch: &RecordBatch, emit: &mut Emit<'_>) -> Result<(), Fault> {
        each_image(batch, "images", emit, |look, bytes, grey| {
            self.row(look, bytes, grey)
        })
    }
}

impl Finder {
    fn row(&self, look: Look, bytes: &[u8], grey: &mut Grey) -> Result<FeaturesRow, Reason> {
        Decoder::new()
            .decode_into(bytes, grey)
            .map_err(|_| "image does not decode")?;
        let blind = [frame(&look.camera), "*"]
            .into_iter()
            .find_map(|name| self.blind.get(name));
        let found = features(grey, &self.params, blind.unwrap_or(&self.everywhere))
            .map_err(|_| "no features can be found at this scale")?;
        Ok(FeaturesRow {
            site: look.site,
            session: look.session,
            stamp: look.stamp,
            keyframe: look.keyframe,
            camera: look.camera,
            width: grey.width,
            height: grey.height,
            u: found.u,
            v: found.v,
            size_px: found.size_px,
            descriptors: Bytes(found.descriptors),
        })
    }
}
