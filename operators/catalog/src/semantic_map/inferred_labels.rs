#![doc = include_str!("inferred_labels.md")]

use evermap_algorithms::learning::random_forest::Forest;
use evermap_algorithms::semantic_map::semantic_graph::Labels;
use evermap_algorithms::semantic_map::stable::inference::{Options, Teller, infer};
use evermap_algorithms::semantic_map::stable::occlusion::{Model, Occlusion};
use evermap_algorithms::semantic_map::stable::surroundings::DIMENSIONS;
use evermap_contract::{Fault, Operator, Port, Reach, Reason, Sides, Work};
use evermap_schemas::layers::{
    DecisionTree, InferredArea, InferredLabels, OcclusionProbability, WarpedLabels,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::classifier::LearntModels;
use crate::inputs::graphs::no_graph;
use crate::inputs::lenses::{self, Lenses};
use crate::inputs::pixels::{label_image, values};
use crate::inputs::spheres::{MovingClasses, surroundings};

/// See the module's page.
pub struct InferredLabelImages;

/// How what nobody saw is inferred.
#[derive(Debug, Clone, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct InferredLabelsParams {
    /// The equations, and how sure is sure.
    #[serde(flatten)]
    pub options: Options,
    /// What moves.
    #[serde(flatten)]
    pub classes: MovingClasses,
}

impl Operator for InferredLabelImages {
    const NAME: &'static str = "inferred_labels";
    const VERSION: u32 = 5;
    const PAGE: &'static str = include_str!("inferred_labels.md");
    type Params = InferredLabelsParams;
    type Output = InferredLabels;

    fn work() -> Work<Self::Params> {
        let warped = Port::session::<WarpedLabels>("warped_labels");
        let model = Port::site::<OcclusionProbability>("occlusion_model");
        let forest = Port::site::<DecisionTree>("forest").optional();
        Work::each_row(
            warped,
            vec![model, forest, lenses::port(Reach::Session)],
            Site::new,
            Site::inferred,
        )
    }
}

struct Site {
    params: InferredLabelsParams,
    model: Vec<OcclusionProbability>,
    lenses: Lenses,
    /// What was learnt from what was seen behind things, ready to predict.
    learnt: Option<(LearntModels<DecisionTree>, Forest)>,
}

impl Site {
    fn new(params: &InferredLabelsParams, sides: &Sides) -> Result<Self, Fault> {
        let learnt = LearntModels::new(sides)?.map(|learnt| {
            let forest = Forest::new(&learnt.models, DIMENSIONS, learnt.classes.len());
            forest
                .map(|forest| (learnt, forest))
                .map_err(LearntModels::<DecisionTree>::wrong)
        });
        Ok(Self {
            params: params.clone(),
            model: sides.rows("occlusion_model")?,
            lenses: Lenses::new(sides)?,
            learnt: learnt.transpose()?,
        })
    }

    /// The model in the numbers of a list of classes.
    fn model(&self, classes: &[String]) -> Model {
        let number = |name: &String| {
            let found = classes.iter().position(|class| class == name);
            found.and_then(|index| u8::try_from(index).ok())
        };
        let counts = self.model.iter().filter_map(|row| {
            Some(Occlusion {
                dynamic: number(&row.dynamic)?,
                class: number(&row.class)?,
                pixels: row.pixels,
            })
        });
        Model::new(classes.len(), counts)
    }

    fn inferred(&self, row: WarpedLabels) -> Result<[InferredLabels; 1], Reason> {
        let (width, height) = (row.width, row.height);
        let before = values(&row.png.0, [width, height])?;
        let kinds = self.params.classes.kinds(&row.classes)?;
        let labels = Labels {
            width,
            height,
            values: &before,
        };
        let options = &self.params.options;
        let model = self.model(&row.classes);
        // A forest that numbers classes otherwise says nothing of these.
        let learnt = self.learnt.as_ref().filter(|(learnt, _)| {
            learnt.classes == row.classes && learnt.features == surroundings(&row.classes)
        });
        let teller = match learnt {
            Some((learnt, forest)) => {
                Teller::Forest(forest, learnt.held_out.block(&row.session, row.stamp))
            }
            None => Teller::Ellipses(&model),
        };
        let taken = (row.session.as_str(), row.camera.as_str(), row.stamp);
        let wraps = self.lenses.wraps(taken, [width, height]);
        let stable = infer(&labels, wraps, &kinds, teller, options);
        let stable = stable.map_err(|error| no_graph(&error))?;
        let name = |class: u8| row.classes[usize::from(class)].clone();
        let areas = stable.inferred.iter().map(|area| InferredArea {
            dynamic: name(area.dynamic),
            class: name(area.class),
            pixels: area.pixels,
            u: area.u,
            v: area.v,
            probability: area.probability,
        });
        let png = |data: Vec<u8>| label_image([width, height], data);
        Ok([InferredLabels {
            inferred: areas.collect(),
            png: png(stable.labels)?,
            certainty: png(stable.certainty)?,
            unknown_px: stable.unknown,
            site: row.site,
            session: row.session,
            stamp: row.stamp,
            camera: row.camera,
            width,
            height,
            classes: row.classes,
        }])
    }
}
