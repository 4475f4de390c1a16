#![doc = include_str!("label_images.md")]

use std::collections::BTreeMap;

use arrow::array::RecordBatch;
use evermap_algorithms::semantic_map::class_scores::ScoresView;
use evermap_algorithms::learning::dense_crf::{
    ColourView, ITERATIONS, Kernels, MOST_CLASSES, RandomField, Unary,
};
use evermap_contract::{Emit, Fault, Grain, Kernel, MapKernel, Mapper, Operator, Port, Sides};
use evermap_schemas::Bytes;
use evermap_schemas::layers::{ClassScores, CrfSetting, LabelImage, ScoredFrame};
use evermap_vision::{Decoder, Grey, Rgb, encode_png};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::images::each_image;
use crate::inputs::rig::Reason;

/// See the module's page.
pub struct LabelImages;

/// How pixels are joined.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LabelImagesParams {
    /// Standard deviation of the appearance kernel in the image (px).
    pub appearance_px: f64,
    /// Standard deviation of the appearance kernel in colour (8-bit values).
    pub appearance_colour: f64,
    /// Weight of the appearance kernel; 0 leaves it out.
    pub appearance_weight: f64,
    /// Standard deviation of the smoothness kernel (px).
    pub smoothness_px: f64,
    /// Weight of the smoothness kernel; 0 leaves it out.
    pub smoothness_weight: f64,
    /// Rounds of mean field.
    pub iterations: u32,
    /// Whether the last column of an image is next to its first one, as in a full panorama.
    pub wraps: bool,
}

impl Default for LabelImagesParams {
    fn default() -> Self {
        let kernels = Kernels::default();
        Self {
            appearance_px: kernels.appearance_px,
            appearance_colour: kernels.appearance_colour,
            appearance_weight: kernels.appearance_weight,
            smoothness_px: kernels.smoothness_px,
            smoothness_weight: kernels.smoothness_weight,
            iterations: ITERATIONS,
            wraps: false,
        }
    }
}

impl LabelImagesParams {
    fn kernels(&self) -> Kernels {
        Kernels {
            appearance_px: self.appearance_px,
            appearance_colour: self.appearance_colour,
            appearance_weight: self.appearance_weight,
            smoothness_px: self.smoothness_px,
            smoothness_weight: self.smoothness_weight,
        }
    }
}

impl Operator for LabelImages {
    const NAME: &'static str = "label_images";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("label_images.md");
    type Params = LabelImagesParams;
    type Output = LabelImage;

    fn ports() -> Vec<Port> {
        vec![
            Port::of::<ScoredFrame>("scores", Grain::Row).with_pixels("image"),
            Port::of::<CrfSetting>("settings", Grain::Whole).optional(),
        ]
    }

    fn kernel(params: LabelImagesParams) -> Result<Kernel, Fault> {
        let checked = params.kernels().check();
        checked.map_err(|error| Fault::user(error.to_string()))?;
        if params.iterations > 1000 {
            return Err(Fault::user(format!(
                "expected iterations up to 1000, found {}",
                params.iterations
            )));
        }
        Ok(Kernel::Map(Box::new(Opener { params })))
    }
}

struct Opener {
    params: LabelImagesParams,
}

impl MapKernel for Opener {
    fn open(&self, sides: &Sides) -> Result<Box<dyn Mapper>, Fault> {
        let mut settings = sides.rows::<CrfSetting>("settings")?;
        settings.retain(|setting| setting.rank == 0);
        let learnt = settings.into_iter().map(|setting| {
            let kernels = Kernels {
                appearance_px: setting.appearance_px,
                appearance_colour: setting.appearance_colour,
                appearance_weight: setting.appearance_weight,
                smoothness_px: setting.smoothness_px,
                smoothness_weight: setting.smoothness_weight,
            };
            (setting.site, kernels)
        });
        Ok(Box::new(Labeller {
            kernels: self.params.kernels(),
            learnt: learnt.collect(),
            iterations: self.params.iterations,
            wraps: self.params.wraps,
        }))
    }
}

struct Labeller {
    kernels: Kernels,
    /// By site.
    learnt: BTreeMap<String, Kernels>,
    iterations: u32,
    wraps: bool,
}

impl Mapper for Labeller {
    fn map(&self, batch: &RecordBatch, emit: &mut Emit<'_>) -> Result<(), Fault> {
        each_image(batch, "scores", emit, |scored, bytes, rgb| {
            self.row(scored, bytes, rgb)
        })
    }
}

impl Labeller {
    fn row(&self, scored: ClassScores, bytes: &[u8], rgb: &mut Rgb) -> Result<LabelImage, Reason> {
        let (size, classes) = ([scored.width, scored.height], scored.classes.len());
        if classes > MOST_CLASSES {
            return Err("more classes than labels");
        }
        let scores = ScoresView::new(size, scored.stride_px, classes, &scored.probabilities.0)
            .ok_or("scores do not have the size that they claim")?;
        Decoder::new()
            .decode_colour_into(bytes, rgb)
            .map_err(|_| "image does not decode")?;
        if [rgb.width, rgb.height] != size {
            return Err("image has another size than its scores");
        }
        let image =
            ColourView::new(rgb.width, rgb.height, &rgb.data).ok_or("image does not decode")?;
        let kernels = self.learnt.get(&scored.site).unwrap_or(&self.kernels);
        let unusable = |_| "kernels do not fit the image";
        let field = RandomField::new(&image, kernels, self.wraps).map_err(unusable)?;
        let unary = Unary::from_scores(&scores, self.wraps).map_err(unusable)?;
        let found = field.infer(&unary, self.iterations).map_err(unusable)?;
        let labels = Grey {
            width: scored.width,
            height: scored.height,
            data: found.labels(),
        };
        let png = encode_png(&labels).map_err(|_| "labels do not encode")?;
        Ok(LabelImage {
            site: scored.site,
            session: scored.session,
            stamp: scored.stamp,
            camera: scored.camera,
            width: scored.width,
            height: scored.height,
            classes: scored.classes,
            png: Bytes(png),
        })
    }
}
