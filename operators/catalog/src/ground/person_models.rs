#![doc = include_str!("person_models.md")]

use evermap_algorithms::ground::people::teaching::{Answer, is_described, learn};
use evermap_contract::{Emit, Fault, Key, NothingToChoose, Operator, Port, Sides, Work};
use evermap_schemas::layers::{PersonExample, PersonModel};

use crate::inputs::people::REJECTED;

/// See the module's page.
pub struct PersonModels;

impl Operator for PersonModels {
    const NAME: &'static str = "person_models";
    const VERSION: u32 = 2;
    const PAGE: &'static str = include_str!("person_models.md");
    type Params = NothingToChoose;
    type Output = PersonModel;

    fn work() -> Work<Self::Params> {
        let examples = Port::site::<PersonExample>("examples");
        Work::group(examples, Key::SITE, Vec::new(), models)
    }
}

fn models(
    _: &NothingToChoose,
    examples: Vec<PersonExample>,
    _: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let site = examples[0].site.clone();
    let length = examples[0].description.len();
    let all = examples.len();
    let is_sound = |one: &PersonExample| {
        let is_like = one.description.len() == length && is_described(&one.description);
        is_like && one.probability.is_finite()
    };
    let sound = examples.into_iter().filter(is_sound);
    let answers: Vec<Answer> = sound
        .map(|one| Answer {
            is_person: one.standing != REJECTED,
            description: one.description,
            probability: one.probability,
        })
        .collect();
    let reason = "example that is not described as others are";
    emit.skip(reason, (all - answers.len()) as u64);
    let learnt = learn(&answers).map_err(|error| Fault::data(error.to_string()))?;
    let Some(process) = learnt else {
        return Ok(());
    };
    let accepted = answers.iter().filter(|answer| answer.is_person).count();
    emit.rows(vec![PersonModel {
        site,
        accepted: accepted as u32,
        rejected: (answers.len() - accepted) as u32,
        weights: process.weights().to_vec(),
        scale: process.scale(),
        noise: process.noise(),
        spread: process.spread(),
    }])
}
