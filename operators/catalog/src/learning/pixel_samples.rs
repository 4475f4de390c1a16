#![doc = include_str!("pixel_samples.md")]

use arrow::array::RecordBatch;
use evermap_algorithms::learning::dense_crf::ColourView;
use evermap_algorithms::learning::pixel_features::{
    FeatureDescription, SamplingOptions, Window, labelled_features,
};
use evermap_contract::{Emit, Fault, Grain, Kernel, MapKernel, Mapper, Operator, Port, Sides};
use evermap_schemas::layers::{LabelledFrame, PixelSamples};
use evermap_schemas::{Bytes, Stamp, record};
use evermap_vision::{Decoder, Rgb, decode_labels};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::images::each_image;
use crate::inputs::rig::Reason;

/// See the module's page.
pub struct PixelSampling;

/// Which pixels are taken, and what is seen of them.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PixelSamplingParams {
    /// About how many pixels of an image.
    pub samples: u32,
    /// Only pixels whose row and column are multiples of this.
    pub stride_px: u32,
    /// A class with n pixels gets samples in proportion to n^(1 - balance).
    pub balance: f64,
    /// As many samples again from the image's mirror image.
    pub mirror: bool,
    /// Side of a SIFT bin, once per scale.
    pub sift_bins_px: Vec<u32>,
    /// Where colour and texture are averaged: [columns away, rows away, half the width].
    pub windows_px: Vec<[i32; 3]>,
    /// The last column is next to the first: full panoramas.
    pub wraps: bool,
    /// Where random numbers start.
    pub seed: u64,
}

impl Default for PixelSamplingParams {
    fn default() -> Self {
        let FeatureDescription {
            sift_bins_px,
            windows,
            wraps,
        } = FeatureDescription::default();
        let SamplingOptions {
            count,
            stride_px,
            balance,
            mirror,
            seed,
        } = SamplingOptions::default();
        let window = |window: &Window| [window.du, window.dv, window.half as i32];
        Self {
            samples: count,
            stride_px,
            balance,
            mirror,
            sift_bins_px,
            windows_px: windows.iter().map(window).collect(),
            wraps,
            seed,
        }
    }
}

impl PixelSamplingParams {
    fn description(&self) -> Result<FeatureDescription, Fault> {
        let window = |[du, dv, half]: &[i32; 3]| {
            let half = u32::try_from(*half).map_err(|_| {
                Fault::user(format!("expected half widths of at least 0, found {half}"))
            })?;
            Ok(Window {
                du: *du,
                dv: *dv,
                half,
            })
        };
        let description = FeatureDescription {
            sift_bins_px: self.sift_bins_px.clone(),
            windows: self
                .windows_px
                .iter()
                .map(window)
                .collect::<Result<_, Fault>>()?,
            wraps: self.wraps,
        };
        let checked = description.check();
        checked.map_err(|error| Fault::user(error.to_string()))?;
        Ok(description)
    }
}

impl Operator for PixelSampling {
    const NAME: &'static str = "pixel_samples";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("pixel_samples.md");
    type Params = PixelSamplingParams;
    type Output = PixelSamples;

    fn ports() -> Vec<Port> {
        vec![Port::of::<LabelledFrame>("labelled_frames", Grain::Row).with_pixels("image")]
    }

    fn kernel(params: PixelSamplingParams) -> Result<Kernel, Fault> {
        if !(0.0..=1.0).contains(&params.balance) {
            return Err(Fault::user(format!(
                "expected balance from 0 (every pixel has the same chance) to 1 (every class), found {}",
                params.balance
            )));
        }
        let what = params.description()?;
        let json = serde_json::to_string(&what)
            .map_err(|error| Fault::bug(format!("features as JSON: {error}")))?;
        Ok(Kernel::Map(Box::new(Opener(Sampler {
            params,
            what,
            json,
        }))))
    }
}

struct Opener(Sampler);

impl MapKernel for Opener {
    fn open(&self, _: &Sides) -> Result<Box<dyn Mapper>, Fault> {
        Ok(Box::new(self.0.clone()))
    }
}

#[derive(Clone)]
struct Sampler {
    params: PixelSamplingParams,
    what: FeatureDescription,
    json: String,
}

record! {
    /// The columns of a labelled frame beside its pixels.
    pub struct Look {
        /// Site.
        site: String,
        /// Session.
        session: String,
        /// Exposure.
        stamp: Stamp,
        /// Camera.
        camera: String,
        /// Names of the classes.
        classes: Vec<String>,
        /// The labels.
        png: Bytes,
    }
}

impl Mapper for Sampler {
    fn map(&self, batch: &RecordBatch, emit: &mut Emit<'_>) -> Result<(), Fault> {
        each_image(batch, "labelled_frames", emit, |look, bytes, rgb| {
            self.row(look, bytes, rgb)
        })
    }
}

impl Sampler {
    fn row(&self, look: Look, bytes: &[u8], rgb: &mut Rgb) -> Result<PixelSamples, Reason> {
        let labels = decode_labels(&look.png.0).map_err(|_| "labels do not decode")?;
        Decoder::new()
            .decode_colour_into(bytes, rgb)
            .map_err(|_| "image does not decode")?;
        if (labels.width, labels.height) != (rgb.width, rgb.height) {
            return Err("labels are of another size than the image");
        }
        let image =
            ColourView::new(rgb.width, rgb.height, &rgb.data).ok_or("image does not decode")?;
        let options = SamplingOptions {
            count: self.params.samples,
            stride_px: self.params.stride_px,
            balance: self.params.balance,
            mirror: self.params.mirror,
            // Other pixels of every image, and the same ones in every run.
            seed: self.params.seed.wrapping_add(look.stamp.0 as u64),
        };
        let classes = look.classes.len().min(usize::from(u8::MAX));
        let found = labelled_features(&self.what, &image, &labels.data, classes, &options)
            .map_err(|_| "features cannot be computed")?;
        if found.labels.is_empty() {
            return Err("image has no labelled pixels");
        }
        Ok(PixelSamples {
            site: look.site,
            session: look.session,
            stamp: look.stamp,
            camera: look.camera,
            classes: look.classes,
            features: self.json.clone(),
            class_pixels: found.class_pixels,
            dimensions: self.what.dimensions() as u32,
            labels: found.labels,
            values: Bytes(found.values),
        })
    }
}
