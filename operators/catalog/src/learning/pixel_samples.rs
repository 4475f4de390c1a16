#![doc = include_str!("pixel_samples.md")]

use evermap_algorithms::learning::pixel_features::{
    FeatureDescription, SamplingOptions, labelled_features,
};
use evermap_contract::{Fault, Operator, Port, Reason, Sides, Work};
use evermap_schemas::Bytes;
use evermap_schemas::layers::{LabelledFrame, PixelSamples};
use evermap_vision::{Rgb, decode_labels};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::pixels::colours;

/// See the module's page.
pub struct PixelSampling;

/// Which pixels are taken, and what is seen of them.
#[derive(Debug, Clone, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct PixelSamplingParams {
    /// Which pixels.
    #[serde(flatten)]
    pub sampling: SamplingOptions,
    /// What is seen of them.
    #[serde(flatten)]
    pub features: FeatureDescription,
}

impl Operator for PixelSampling {
    const NAME: &'static str = "pixel_samples";
    const VERSION: u32 = 2;
    const PAGE: &'static str = include_str!("pixel_samples.md");
    type Params = PixelSamplingParams;
    type Output = PixelSamples;

    fn work() -> Work<Self::Params> {
        let labelled = Port::session::<LabelledFrame>("labelled_frames").pixels("image");
        Work::each_image(labelled, vec![], Sampler::new, Sampler::samples)
    }

    fn check(params: &Self::Params) -> Result<(), Fault> {
        let checked = params.features.check();
        checked.map_err(|error| Fault::user(error.to_string()))
    }
}

struct Sampler {
    params: PixelSamplingParams,
    /// The features, as models carry them.
    features: String,
}

impl Sampler {
    fn new(params: &PixelSamplingParams, _: &Sides) -> Result<Self, Fault> {
        let features = serde_json::to_string(&params.features);
        Ok(Self {
            params: params.clone(),
            features: features.map_err(|error| Fault::bug(format!("features as JSON: {error}")))?,
        })
    }

    fn samples(
        &self,
        frame: LabelledFrame,
        bytes: &[u8],
        rgb: &mut Rgb,
    ) -> Result<Option<PixelSamples>, Reason> {
        let labels = decode_labels(&frame.png.0).map_err(|_| "labels do not decode")?;
        let image = colours(bytes, rgb)?;
        let size = [labels.width, labels.height].map(|side| side as usize);
        if size != [image.width(), image.height()] {
            return Err("labels are of another size than the image");
        }
        let PixelSamplingParams { sampling, features } = &self.params;
        let sampling = SamplingOptions {
            // Other pixels of every image, and the same ones in every run.
            seed: sampling.seed.wrapping_add(frame.stamp.0 as u64),
            ..*sampling
        };
        let classes = frame.classes.len().min(usize::from(u8::MAX));
        let found = labelled_features(features, &image, &labels.data, classes, &sampling)
            .map_err(|_| "features cannot be computed")?;
        if found.labels.is_empty() {
            return Err("image has no labelled pixels");
        }
        Ok(Some(PixelSamples {
            site: frame.site,
            session: frame.session,
            stamp: frame.stamp,
            camera: frame.camera,
            classes: frame.classes,
            features: self.features.clone(),
            class_pixels: found.class_pixels,
            dimensions: features.dimensions() as u32,
            labels: found.labels,
            values: Bytes(found.values),
        }))
    }
}
