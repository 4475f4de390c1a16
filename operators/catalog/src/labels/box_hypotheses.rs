#![doc = include_str!("box_hypotheses.md")]

use evermap_algorithms::ground::boxes::mosaic::Mosaic;
use evermap_algorithms::ground::boxes::rows::LaneLine;
use evermap_algorithms::ground::boxes::teaching::{Candidates, Example, Hypothesis, Taught};
use evermap_algorithms::ground::boxes::template::Template;
use evermap_algorithms::learning::calibration::Calibration;
use evermap_algorithms::learning::gaussian_process::LinearProcess;
use evermap_contract::{Emit, Fault, Key, NothingToChoose, Operator, Port, Sides, Work};
use evermap_schemas::Wkb;
use evermap_schemas::layers::{BoxHypothesis, BoxModel, Lane, OverheadGradients, PlacedLabel};

use crate::inputs::asking::reason;
use crate::inputs::boxes::{boxes, lane_line, longest_m, mosaic, pose};

/// See the module's page.
pub struct BoxHypotheses;

impl Operator for BoxHypotheses {
    const NAME: &'static str = "box_hypotheses";
    const VERSION: u32 = 10;
    const PAGE: &'static str = include_str!("box_hypotheses.md");
    type Params = NothingToChoose;
    type Output = BoxHypothesis;

    fn work() -> Work<Self::Params> {
        let models = Port::site::<BoxModel>("models");
        let sides = vec![
            Port::site::<OverheadGradients>("gradients"),
            Port::site::<PlacedLabel>("labels"),
            Port::site::<Lane>("lanes").optional(),
        ];
        Work::group(models, Key::SITE, sides, hypotheses)
    }
}

fn hypotheses(
    _: &NothingToChoose,
    models: Vec<BoxModel>,
    mut sides: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let mut skip = |reason, count| emit.skip(reason, count);
    let mosaic = mosaic(sides.take("gradients")?, &mut skip);
    let labels: Vec<PlacedLabel> = sides.rows("labels")?;
    let lanes: Vec<Lane> = sides.rows("lanes")?;
    let mut found = Vec::new();
    for model in models {
        match Kind::new(model, &labels, &lanes, mosaic.cell_m()) {
            Some(kind) => found.extend(kind.weigh(&kind.search(&mosaic))),
            None => skip(
                "model does not have the numbers that it claims, or is of boxes of too many cells"
                    .into(),
                1,
            ),
        }
    }
    emit.rows(found)
}

/// What was learnt of a kind, what was said of its boxes, and the lanes that these lie at.
#[derive(Debug)]
pub struct Kind {
    model: BoxModel,
    taught: Taught,
    examples: Vec<Example>,
    lanes: Vec<LaneLine>,
}

impl Kind {
    /// Of a site's model, labels and lanes, on an image with cells of this side (m); `None` where the model does not have the
    /// numbers that it claims, or is of boxes that are too long for such cells.
    pub fn new(
        model: BoxModel,
        labels: &[PlacedLabel],
        lanes: &[Lane],
        cell_m: f64,
    ) -> Option<Self> {
        let said = boxes(labels, cell_m, &mut |_, _| {}).remove(&model.kind);
        Some(Self {
            taught: taught(&model, cell_m)?,
            examples: said.unwrap_or_default().examples,
            lanes: lanes.iter().map(lane_line).collect(),
            model,
        })
    }

    /// What of the overhead image may be of the kind, and of which nothing was said.
    pub fn search(&self, mosaic: &Mosaic) -> Candidates {
        self.taught.search(mosaic, &self.examples, &self.lanes)
    }

    /// What is left of candidates that were found when less was known.
    pub fn look_again(&self, candidates: &Candidates) -> Candidates {
        self.taught.look_again(candidates, &self.examples)
    }

    /// Candidates with what they are worth.
    pub fn weigh(&self, candidates: &Candidates) -> Vec<BoxHypothesis> {
        let row = |(number, one): (u32, Hypothesis)| BoxHypothesis {
            site: self.model.site.clone(),
            kind: self.model.kind.clone(),
            hypothesis: number,
            map_from_label: pose(&one.place, self.model.height_m),
            length_m: one.place.length_m,
            width_m: one.place.width_m,
            mean: one.mean,
            variance: one.variance,
            probability: one.probability,
            question: one.question.map(|question| question.number as u32),
            gain: one.question.map(|question| question.gain),
            reason: one.question.map(|_| reason(one.probability).to_owned()),
            geometry: Wkb::polygon(&one.place.corners()),
        };
        (0..).zip(self.taught.weigh(candidates)).map(row).collect()
    }
}

/// What was learnt; `None` where the row's numbers contradict each other, or cells of this side (m) are too small for its boxes.
fn taught(row: &BoxModel, cell_m: f64) -> Option<Taught> {
    let longest_m = longest_m(cell_m);
    let is_size = |[length_m, width_m]: &[f64; 2]| {
        let sides = [*length_m, *width_m];
        sides.iter().all(|side| (0.01..=longest_m).contains(side))
    };
    let is_sound = !row.sizes_m.is_empty()
        && row.sizes_m.iter().all(is_size)
        && row.middle.is_finite()
        && row.slope.is_finite()
        && row.height_m.is_finite();
    let taught = Taught {
        process: LinearProcess::from_parts(
            row.weights.clone(),
            [row.scale, row.noise],
            &row.spread,
        )?,
        calibration: Calibration {
            middle: row.middle,
            slope: row.slope,
        },
        template: Template::from_values(row.template.clone())?,
        sizes_m: row.sizes_m.clone(),
        accepted: row.accepted,
        rejected: row.rejected,
    };
    (is_sound && taught.is_sound()).then_some(taught)
}
