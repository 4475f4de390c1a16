#![doc = include_str!("features.md")]

use std::collections::BTreeMap;

use evermap_contract::{Fault, Operator, Port, Reason, Sides, Work};
use evermap_schemas::Bytes;
use evermap_schemas::layers::{Features as FeaturesRow, FrameImage};
use evermap_vision::{Blind, FeatureParams, Grey, decode_grey, features};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::rig::frame;

/// See the module's page.
pub struct Features;

/// How features are found.
#[derive(Debug, Clone, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct FeaturesParams {
    /// In the image.
    #[serde(flatten)]
    pub wanted: FeatureParams,
    /// Where no features are wanted, by camera: polygons of `[u, v]` in the full image (px), such as the own body's
    /// outline. The camera `*` stands for all that are not named.
    pub mask: BTreeMap<String, Blind>,
}

impl Operator for Features {
    const NAME: &'static str = "features";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("features.md");
    type Params = FeaturesParams;
    type Output = FeaturesRow;

    fn work() -> Work<Self::Params> {
        let images = Port::session::<FrameImage>("images").pixels("image");
        Work::each_image(images, vec![], Finder::new, Finder::row)
    }
}

struct Finder {
    wanted: FeatureParams,
    /// By camera.
    mask: BTreeMap<String, Blind>,
    everywhere: Blind,
}

impl Finder {
    fn new(params: &FeaturesParams, _: &Sides) -> Result<Self, Fault> {
        let mask = params.mask.iter();
        let mask = mask.map(|(camera, blind)| (frame(camera).to_owned(), blind.clone()));
        Ok(Self {
            wanted: params.wanted,
            mask: mask.collect(),
            everywhere: Blind::default(),
        })
    }

    fn row(
        &self,
        image: FrameImage,
        bytes: &[u8],
        grey: &mut Grey,
    ) -> Result<Option<FeaturesRow>, Reason> {
        decode_grey(bytes, grey).map_err(|_| "image does not decode")?;
        let blind = [frame(&image.camera), "*"]
            .into_iter()
            .find_map(|name| self.mask.get(name));
        let found = features(grey, &self.wanted, blind.unwrap_or(&self.everywhere))
            .map_err(|_| "no features can be found at this scale")?;
        Ok(Some(FeaturesRow {
            site: image.site,
            session: image.session,
            stamp: image.stamp,
            keyframe: image.keyframe,
            camera: image.camera,
            width: grey.width,
            height: grey.height,
            u: found.u,
            v: found.v,
            size_px: found.size_px,
            descriptors: Bytes(found.descriptors),
        }))
    }
}
