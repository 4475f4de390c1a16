#![doc = include_str!("people.md")]

use evermap_algorithms::ground::people::teaching::{Belief, belief, foretold};
use evermap_algorithms::learning::gaussian_process::LinearProcess;
use evermap_contract::{Fault, Operator, Port, Reason, Sides, Work};
use evermap_schemas::layers::{Person, PersonHypothesis, PersonModel};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::people::learnt;

/// See the module's page.
pub struct People;

/// Who is believed to be there.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct BelievingParams {
    /// What is less probably a person than this is left out.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub least_probability: f64,
}

impl Default for BelievingParams {
    fn default() -> Self {
        Self {
            least_probability: 0.5,
        }
    }
}

impl Operator for People {
    const NAME: &'static str = "people";
    const VERSION: u32 = 2;
    const PAGE: &'static str = include_str!("people.md");
    type Params = BelievingParams;
    type Output = Person;

    fn work() -> Work<Self::Params> {
        let hypotheses = Port::session::<PersonHypothesis>("hypotheses");
        let models = Port::site::<PersonModel>("models").optional();
        Work::each_row(hypotheses, vec![models], Believing::new, Believing::person)
    }
}

struct Believing {
    least_probability: f64,
    /// What answers taught; `None` before there are any.
    learnt: Option<LinearProcess>,
}

impl Believing {
    fn new(params: &BelievingParams, sides: &Sides) -> Result<Self, Fault> {
        Ok(Self {
            least_probability: params.least_probability,
            learnt: learnt(sides)?,
        })
    }

    fn person(&self, seen: PersonHypothesis) -> Result<Option<Person>, Reason> {
        if !seen.probability.is_finite() {
            return Err("person without a probability".into());
        }
        let believed = match &self.learnt {
            Some(learnt) => Some(
                belief(learnt, &seen.description, seen.probability)
                    .ok_or("person whose description is not like those that were learnt from")?,
            ),
            None => None,
        };
        let probability = believed.map_or(seen.probability, |it: Belief| it.probability);
        Ok((probability >= self.least_probability).then(|| Person {
            site: seen.site,
            session: seen.session,
            stamp: seen.stamp,
            camera: seen.camera,
            person: seen.person,
            x: seen.x,
            y: seen.y,
            z: seen.z,
            var_x_m2: seen.var_x_m2,
            cov_xy_m2: seen.cov_xy_m2,
            var_y_m2: seen.var_y_m2,
            range_m: seen.range_m,
            rectangle: seen.rectangle,
            score: seen.score,
            mean: believed.map_or(foretold(probability), |it| it.mean),
            variance: believed.map(|it| it.variance),
            probability,
        }))
    }
}
