#![doc = include_str!("class_scores.md")]

use evermap_algorithms::learning::pixel_classifier::{ClassifierError, PixelClassifier, quantised};
use evermap_algorithms::learning::pixel_features::FeatureDescription;
use evermap_algorithms::learning::random_forest::{prior_factors, with_priors};
use evermap_contract::{Fault, Operator, Port, Reason, Sides, Work};
use evermap_schemas::Bytes;
use evermap_schemas::layers::{ClassScores, DecisionTree, PixelPerceptron};
use evermap_schemas::roles::Frame;
use evermap_vision::Rgb;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::backbone::BACKBONE;
use crate::inputs::classifier::{HeldOut, LearntModels, ModelRow};
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
    /// Classes count by their frequency to this power. On contiguous folds of CamVid, -0.2 is best for the sum of pixels right
    /// and class average by a forest, and 0 by a network, of which it gives the best class average; 0.2 gives more pixels.
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
    const VERSION: u32 = 3;
    const PAGE: &'static str = include_str!("class_scores.md");
    type Params = ClassScoringParams;
    type Output = ClassScores;

    fn work() -> Work<Self::Params> {
        let frames = Port::session::<Frame>("frames").pixels("image");
        let forest = Port::site::<DecisionTree>("forest").optional();
        let network = Port::site::<PixelPerceptron>("network").optional();
        Work::each_image(frames, vec![forest, network], Scorer::new, Scorer::scores)
    }
}

struct Scorer {
    stride_px: u32,
    /// None where the site has no classifier.
    model: Option<Model>,
}

impl Scorer {
    fn new(params: &ClassScoringParams, sides: &Sides) -> Result<Self, Fault> {
        let power = params.prior_power;
        let forest = LearntModels::<DecisionTree>::new(sides)?;
        let network = LearntModels::<PixelPerceptron>::new(sides)?;
        let model = match (forest, network) {
            (None, None) => None,
            (Some(forest), None) => Some(Model::new(forest, power, |what, trees, classes| {
                PixelClassifier::of_trees(what, &trees, classes)
            })?),
            (None, Some(network)) => Some(Model::new(network, power, PixelClassifier::of_network)?),
            (Some(_), Some(_)) => {
                return Err(Fault::user("expected a forest or a network, found both"));
            }
        };
        Ok(Self {
            stride_px: params.stride_px,
            model,
        })
    }

    fn scores(
        &self,
        frame: Frame,
        bytes: &[u8],
        rgb: &mut Rgb,
    ) -> Result<Option<ClassScores>, Reason> {
        let model = self.model.as_ref().ok_or("site has no classifier")?;
        let undecoded = || undecoded(&frame.camera, &frame.image.format);
        let image = colours(bytes, rgb, undecoded)?;
        let block = model.held_out.block(&frame.session, frame.stamp);
        let mut scores = model
            .classifier
            .scores(&image, block, self.stride_px, BACKBONE)
            .map_err(|_| "features cannot be computed")?;
        for cell in scores.chunks_exact_mut(model.classes.len()) {
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
            classes: model.classes.clone(),
            probabilities: Bytes(scores.into_iter().map(quantised).collect()),
        }))
    }
}

/// A site's classifier, ready to predict.
struct Model {
    classes: Vec<String>,
    held_out: HeldOut,
    classifier: PixelClassifier,
    /// What counts for each class by its frequency.
    factors: Vec<f32>,
}

impl Model {
    fn new<R: ModelRow>(
        learnt: LearntModels<R>,
        prior_power: f64,
        classifier: impl FnOnce(
            FeatureDescription,
            Vec<R::Model>,
            usize,
        ) -> Result<PixelClassifier, ClassifierError>,
    ) -> Result<Self, Fault> {
        let what: FeatureDescription = serde_json::from_str(&learnt.features)
            .map_err(|error| LearntModels::<R>::wrong(format!("column features: {error}")))?;
        let classifier = classifier(what, learnt.models, learnt.classes.len());
        Ok(Self {
            factors: prior_factors(&learnt.priors, prior_power),
            classifier: classifier.map_err(LearntModels::<R>::wrong)?,
            classes: learnt.classes,
            held_out: learnt.held_out,
        })
    }
}
