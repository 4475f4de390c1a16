#![doc = include_str!("class_scores.md")]

use evermap_algorithms::learning::pixel_classifier::{PixelClassifier, quantised};
use evermap_algorithms::learning::pixel_features::FeatureDescription;
use evermap_algorithms::learning::random_forest::{prior_factors, with_priors};
use evermap_contract::{Fault, Operator, Port, Reason, Sides, Work};
use evermap_schemas::Bytes;
use evermap_schemas::layers::{ClassScores, DecisionTree};
use evermap_schemas::roles::Frame;
use evermap_vision::Rgb;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::forest::{LearntForest, wrong};
use crate::inputs::pixels::{colours, undecoded};

/// See the module's page.
pub struct ClassScoring;

/// How images are scored.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct ClassScoringParams {
    /// Side of a cell (px).
    #[schemars(range(min = 1, max = 256))]
    pub stride_px: u32,
    /// Classes count by their frequency to this power. On CamVid, -0.2 is best for the sum of pixels right and class
    /// average, for contiguous folds as for interleaved ones; 0.2 gives the most pixels, -0.4 the best class average.
    #[schemars(range(min = -2.0, max = 2.0))]
    pub prior_power: f64,
}

impl Default for ClassScoringParams {
    fn default() -> Self {
        Self {
            stride_px: 2,
            prior_power: -0.2,
        }
    }
}

impl Operator for ClassScoring {
    const NAME: &'static str = "class_scores";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("class_scores.md");
    type Params = ClassScoringParams;
    type Output = ClassScores;

    fn work() -> Work<Self::Params> {
        let frames = Port::session::<Frame>("frames").pixels("image");
        let forest = Port::site::<DecisionTree>("forest");
        Work::each_image(frames, vec![forest], Scorer::new, Scorer::scores)
    }
}

struct Scorer {
    stride_px: u32,
    /// None where the site has no forest.
    model: Option<Model>,
}

impl Scorer {
    fn new(params: &ClassScoringParams, sides: &Sides) -> Result<Self, Fault> {
        let forest = LearntForest::new(sides)?;
        let model = forest.map(|forest| Model::new(forest, params.prior_power));
        Ok(Self {
            stride_px: params.stride_px,
            model: model.transpose()?,
        })
    }

    fn scores(
        &self,
        frame: Frame,
        bytes: &[u8],
        rgb: &mut Rgb,
    ) -> Result<Option<ClassScores>, Reason> {
        let model = self.model.as_ref().ok_or("site has no forest")?;
        let undecoded = || undecoded(&frame.camera, &frame.image.format);
        let image = colours(bytes, rgb, undecoded)?;
        let block = model.forest.block(&frame.session, frame.stamp);
        let mut scores = model
            .classifier
            .scores(&image, block, self.stride_px)
            .map_err(|_| "features cannot be computed")?;
        for cell in scores.chunks_exact_mut(model.forest.classes.len()) {
            with_priors(cell, &model.factors);
        }
        Ok(Some(ClassScores {
            site: frame.site,
            session: frame.session,
            stamp: frame.stamp,
            camera: frame.camera,
            width: rgb.width,
            height: rgb.height,
            stride_px: self.stride_px,
            classes: model.forest.classes.clone(),
            probabilities: Bytes(scores.into_iter().map(quantised).collect()),
        }))
    }
}

/// A site's forest, ready to predict.
struct Model {
    forest: LearntForest,
    classifier: PixelClassifier,
    /// What counts for each class by its frequency.
    factors: Vec<f32>,
}

impl Model {
    fn new(forest: LearntForest, prior_power: f64) -> Result<Self, Fault> {
        let what: FeatureDescription = serde_json::from_str(&forest.features)
            .map_err(|error| wrong(format!("column features: {error}")))?;
        let classifier =
            PixelClassifier::new(what, &forest.trees, forest.classes.len()).map_err(wrong)?;
        Ok(Self {
            factors: prior_factors(&forest.priors, prior_power),
            classifier,
            forest,
        })
    }
}
