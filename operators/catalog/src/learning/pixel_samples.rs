#![doc = include_str!("pixel_samples.md")]

use evermap_algorithms::learning::pixel_features::{
    FeatureDescription, FeatureOptions, SamplingOptions, labelled_features,
};
use evermap_algorithms::semantic_map::semantic_graph::MOST_CLASSES;
use evermap_contract::{Fault, Operator, Port, Reach, Reason, Sides, Work};
use evermap_schemas::Bytes;
use evermap_schemas::layers::{LabelledFrame, PixelSamples};
use evermap_vision::Rgb;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::backbone::BACKBONE;
use crate::inputs::lenses::{self, Lenses};
use crate::inputs::pixels::{colours, undecoded, values_on_image};

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
    pub features: FeatureOptions,
}

impl Operator for PixelSampling {
    const NAME: &'static str = "pixel_samples";
    const VERSION: u32 = 4;
    const PAGE: &'static str = include_str!("pixel_samples.md");
    type Params = PixelSamplingParams;
    type Output = PixelSamples;

    fn work() -> Work<Self::Params> {
        let labelled = Port::session::<LabelledFrame>("labelled_frames").pixels("image");
        let calibration = lenses::port(Reach::Session);
        Work::each_image(labelled, vec![calibration], Sampler::new, Sampler::samples)
    }

    fn check(params: &Self::Params) -> Result<(), Fault> {
        // A plain image has a feature more than a panorama.
        let checked = description(params, false).check();
        checked.map_err(|error| Fault::user(error.to_string()))
    }
}

struct Sampler {
    sampling: SamplingOptions,
    lenses: Lenses,
    plain: Features,
    panorama: Features,
}

/// What is seen of pixels, and how models carry it.
struct Features {
    description: FeatureDescription,
    json: String,
}

fn description(params: &PixelSamplingParams, wraps: bool) -> FeatureDescription {
    FeatureDescription {
        options: params.features.clone(),
        wraps,
    }
}

impl Features {
    fn new(params: &PixelSamplingParams, wraps: bool) -> Result<Self, Fault> {
        let description = description(params, wraps);
        let json = serde_json::to_string(&description);
        let json = json.map_err(|error| Fault::bug(format!("features as JSON: {error}")))?;
        Ok(Self { description, json })
    }
}

impl Sampler {
    fn new(params: &PixelSamplingParams, sides: &Sides) -> Result<Self, Fault> {
        Ok(Self {
            sampling: params.sampling,
            lenses: Lenses::new(sides)?,
            plain: Features::new(params, false)?,
            panorama: Features::new(params, true)?,
        })
    }

    fn samples(
        &self,
        frame: LabelledFrame,
        bytes: &[u8],
        rgb: &mut Rgb,
    ) -> Result<Option<PixelSamples>, Reason> {
        let undecoded = || undecoded(&frame.camera, &frame.image.format);
        let image = colours(bytes, rgb, undecoded)?;
        let size = [image.width(), image.height()].map(|side| side as u32);
        let labels = values_on_image(&frame.png.0, size)?;
        let taken = (frame.session.as_str(), frame.camera.as_str(), frame.stamp);
        let Features { description, json } = match self.lenses.wraps(taken, size) {
            true => &self.panorama,
            false => &self.plain,
        };
        let sampling = SamplingOptions {
            // Other pixels of every image, and the same ones in every run.
            seed: self.sampling.seed.wrapping_add(frame.stamp.0 as u64),
            ..self.sampling
        };
        let classes = frame.classes.len().min(MOST_CLASSES);
        let found = labelled_features(description, &image, &labels, classes, &sampling, BACKBONE);
        let found = found.map_err(|_| "features cannot be computed")?;
        if found.labels.is_empty() {
            return Err("image has no labelled pixels".into());
        }
        Ok(Some(PixelSamples {
            site: frame.site,
            session: frame.session,
            stamp: frame.stamp,
            camera: frame.camera,
            classes: frame.classes,
            features: json.clone(),
            class_pixels: found.class_pixels,
            dimensions: description.dimensions() as u32,
            labels: found.labels,
            values: Bytes(found.values),
        }))
    }
}
