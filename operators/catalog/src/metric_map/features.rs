#![doc = include_str!("features.md")]

use std::collections::BTreeMap;

use evermap_contract::{Fault, Operator, Port, Reason, Sides, Work};
use evermap_schemas::Bytes;
use evermap_schemas::layers::{BodyMask, Features as FeaturesRow, FrameImage};
use evermap_vision::{Blind, Detectors, FeatureParams, Grey, decode_grey};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::bodies::bodies;
use crate::inputs::masks::{CameraMasks, Masks};
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
    /// Where images show the vehicle.
    #[serde(flatten)]
    pub masks: Masks,
}

impl Operator for Features {
    const NAME: &'static str = "features";
    const VERSION: u32 = 2;
    const PAGE: &'static str = include_str!("features.md");
    type Params = FeaturesParams;
    type Output = FeaturesRow;

    fn check(params: &Self::Params) -> Result<(), Fault> {
        params.masks.check()
    }

    fn work() -> Work<Self::Params> {
        let images = Port::session::<FrameImage>("images").pixels("image");
        let bodies = Port::session::<BodyMask>("body_masks").optional();
        Work::each_image(images, vec![bodies], Finder::new, Finder::row)
    }
}

struct Finder {
    detectors: Detectors,
    wanted: FeatureParams,
    drawn: CameraMasks,
    /// Of `body_masks`, by session and camera.
    bodies: BTreeMap<(String, String), Blind>,
}

impl Finder {
    fn new(params: &FeaturesParams, sides: &Sides) -> Result<Self, Fault> {
        let drawn = CameraMasks::new(&params.masks);
        let bodies = bodies(sides)?.into_iter().map(|((session, camera), body)| {
            let mut blind = drawn.of(&camera).cloned().unwrap_or_default();
            blind.mask.get_or_insert(body);
            ((session, camera), blind)
        });
        Ok(Self {
            detectors: Detectors::default(),
            wanted: params.wanted,
            bodies: bodies.collect(),
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
        let named = (image.session.clone(), frame(&image.camera).to_owned());
        let fits = |blind: &&Blind| {
            let mask = blind.mask.as_ref();
            mask.is_none_or(|mask| (mask.width, mask.height) == (grey.width, grey.height))
        };
        let body = self.bodies.get(&named).filter(fits);
        let blind = body.or_else(|| self.drawn.of(&image.camera));
        if blind.is_some_and(|blind| !fits(&blind)) {
            return Err("image has another size than the mask of its camera".into());
        }
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
