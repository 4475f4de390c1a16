#![doc = include_str!("features.md")]

use std::collections::BTreeMap;

use evermap_contract::{Fault, Operator, Port, Reason, Sides, Work};
use evermap_schemas::Bytes;
use evermap_schemas::layers::{BodyMask, Features as FeaturesRow, FrameImage};
use evermap_vision::{Blind, Detectors, FeatureParams, Grey, decode_grey};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::bodies::bodies;
use crate::inputs::pixels::{left_out, undecoded};
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
    const VERSION: u32 = 2;
    const PAGE: &'static str = include_str!("features.md");
    type Params = FeaturesParams;
    type Output = FeaturesRow;

    fn work() -> Work<Self::Params> {
        let images = Port::session::<FrameImage>("images").pixels("image");
        let bodies = Port::session::<BodyMask>("body_masks").optional();
        Work::each_image(images, vec![bodies], Finder::new, Finder::row)
    }
}

struct Finder {
    detectors: Detectors,
    wanted: FeatureParams,
    /// By camera.
    drawn: BTreeMap<String, Blind>,
    /// By session and camera.
    learnt: BTreeMap<(String, String), Blind>,
}

impl Finder {
    fn new(params: &FeaturesParams, sides: &Sides) -> Result<Self, Fault> {
        let drawn = params.mask.iter();
        let drawn: BTreeMap<String, Blind> = drawn
            .map(|(camera, blind)| (frame(camera).to_owned(), blind.clone()))
            .collect();
        let learnt = bodies(sides)?.into_iter().map(|((session, camera), body)| {
            let polygons = blind(&drawn, &camera).map(|drawn| drawn.polygons.clone());
            let both = Blind {
                polygons: polygons.unwrap_or_default(),
                mask: Some(body),
            };
            ((session, camera), both)
        });
        Ok(Self {
            detectors: Detectors::default(),
            wanted: params.wanted,
            learnt: learnt.collect(),
            drawn,
        })
    }

    fn row(
        &self,
        image: FrameImage,
        bytes: &[u8],
        grey: &mut Grey,
    ) -> Result<Option<FeaturesRow>, Reason> {
        let undecoded = || undecoded(&image.camera, &image.image.format);
        decode_grey(bytes, grey).map_err(|error| left_out(&error, undecoded()))?;
        let camera = frame(&image.camera);
        let named = (image.session.clone(), camera.to_owned());
        let fits = |mask: &Grey| (mask.width, mask.height) == (grey.width, grey.height);
        let learnt = self.learnt.get(&named);
        let learnt = learnt.filter(|blind| blind.mask.as_ref().is_some_and(fits));
        let blind = learnt.or_else(|| blind(&self.drawn, camera));
        let everywhere = Blind::default();
        let blind = blind.unwrap_or(&everywhere);
        let found = self.detectors.features(grey, &self.wanted, blind);
        let found = found.map_err(|_| "no features can be found at this scale")?;
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

/// What is drawn for a camera.
fn blind<'a>(drawn: &'a BTreeMap<String, Blind>, camera: &str) -> Option<&'a Blind> {
    drawn.get(camera).or_else(|| drawn.get("*"))
}
