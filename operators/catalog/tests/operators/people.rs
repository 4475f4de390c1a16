//! People learnt from answers: from examples to a model, to who is believed, and to what is asked.

use std::collections::BTreeMap;

use evermap_contract::laws::{Split, inputs_of, run};
use evermap_schemas::Stamp;
use evermap_schemas::layers::{
    Person, PersonExample, PersonHypothesis, PersonModel, PersonQuestion,
};
use serde_json::json;

use crate::yields;

/// A window: how much it looks like a person (1) or a post (-1), how it differs from all others otherwise, and a constant.
fn shown(number: u32, like: f32) -> Vec<f32> {
    let aside = 0.1 * (number as f32).sin();
    vec![like, aside, 1.0]
}

/// Whoever has an even number is a person. The untaught detector is as sure of posts as of people.
fn like(number: u32) -> f32 {
    if number.is_multiple_of(2) { 1.0 } else { -1.0 }
}

/// Probabilities from 0.3 to 0.7, in no order.
fn untaught(number: u32) -> f64 {
    0.3 + 0.4 * f64::from(number * 7 % 11) / 10.0
}

fn hypothesis(session: &str, number: u32) -> PersonHypothesis {
    PersonHypothesis {
        site: "lot".into(),
        session: session.into(),
        stamp: Stamp(i64::from(number)),
        camera: "front".into(),
        person: 0,
        x: 4.0,
        y: 1.0,
        z: 0.0,
        var_x_m2: 0.04,
        cov_xy_m2: 0.0,
        var_y_m2: 0.01,
        range_m: 3.0,
        rectangle: vec![10.0, 20.0, 30.0, 60.0],
        score: 1.3,
        probability: untaught(number),
        description: shown(number, like(number)),
    }
}

/// What somebody said of a hypothesis.
fn example(of: &PersonHypothesis, is_person: bool) -> PersonExample {
    PersonExample {
        site: of.site.clone(),
        session: of.session.clone(),
        stamp: of.stamp,
        camera: of.camera.clone(),
        label: format!("of {}", of.stamp.0),
        standing: if is_person { "accepted" } else { "rejected" }.into(),
        x: of.x,
        y: of.y,
        range_m: of.range_m,
        probability: of.probability,
        description: of.description.clone(),
    }
}

/// Twenty answers about one drive.
fn examples() -> Vec<PersonExample> {
    let answer = |number: u32| example(&hypothesis("a", number), like(number) > 0.0);
    (0..20).map(answer).collect()
}

fn models(examples: Vec<PersonExample>) -> Vec<PersonModel> {
    let inputs = [inputs_of("examples", examples).unwrap()];
    yields::<PersonModel>("person_models", json!({}), inputs).0
}

fn people(hypotheses: Vec<PersonHypothesis>, models: Vec<PersonModel>) -> Vec<Person> {
    let inputs = [
        inputs_of("hypotheses", hypotheses).unwrap(),
        inputs_of("models", models).unwrap(),
    ];
    let (rows, losses) = yields::<Person>("people", json!({}), inputs);
    assert!(losses.is_empty(), "{losses:?}");
    rows
}

fn drive(session: &str, count: u32) -> Vec<PersonHypothesis> {
    (0..count).map(|at| hypothesis(session, at)).collect()
}

#[test]
fn without_answers_people_are_those_of_the_untaught_detector() {
    let found = people(drive("b", 40), Vec::new());
    let held = drive("b", 40).into_iter();
    let held: Vec<_> = held.filter(|one| one.probability >= 0.5).collect();
    assert_eq!(found.len(), held.len());
    for (found, held) in found.iter().zip(&held) {
        assert_eq!(
            (found.stamp, found.probability),
            (held.stamp, held.probability)
        );
        assert_eq!(found.variance, None);
    }
    // Nor do answers of one kind alone teach anything.
    let people = examples()
        .into_iter()
        .filter(|one| one.standing == "accepted");
    assert!(models(people.collect()).is_empty());
}

#[test]
fn answers_about_one_drive_keep_people_and_drop_posts_in_another() {
    let learnt = models(examples());
    assert_eq!((learnt[0].accepted, learnt[0].rejected), (10, 10));
    let found = people(drive("b", 40), learnt);
    let stamps: Vec<i64> = found.iter().map(|one| one.stamp.0).collect();
    let even: Vec<i64> = (0..20).map(|half| 2 * half).collect();
    assert_eq!(stamps, even);
    for one in &found {
        assert!(
            one.mean > 0.0 && one.variance.is_some_and(|it| it < 0.5),
            "{one:?}"
        );
    }
}

#[test]
fn questions_leave_out_what_was_answered_and_are_fifty_at_most() {
    let hypotheses = drive("a", 3000);
    let asked = |models: Vec<PersonModel>, examples: Vec<PersonExample>| {
        let inputs = [
            inputs_of("hypotheses", hypotheses.clone()).unwrap(),
            inputs_of("models", models).unwrap(),
            inputs_of("examples", examples).unwrap(),
        ];
        yields::<PersonQuestion>("person_questions", json!({}), inputs).0
    };
    let first = asked(Vec::new(), Vec::new());
    let then = asked(models(examples()), examples());
    for rows in [&first, &then] {
        let numbers: Vec<u32> = rows.iter().map(|row| row.question).collect();
        assert_eq!(numbers, (1..=50).collect::<Vec<u32>>());
        let mut stamps: Vec<Stamp> = rows.iter().map(|row| row.stamp).collect();
        stamps.sort_unstable();
        stamps.dedup();
        assert_eq!(stamps.len(), 50);
    }
    assert!(then.iter().all(|row| row.stamp.0 >= 20));
    // What is known already is hardly worth asking.
    assert!(
        then[0].gain < 0.1 * first[0].gain,
        "{} {}",
        then[0].gain,
        first[0].gain
    );
}

#[test]
fn a_model_without_the_numbers_that_it_claims_is_a_fault() {
    let mut learnt = models(examples());
    learnt[0].spread.pop();
    let registry = evermap_catalog::registry();
    for operator in ["people", "person_questions"] {
        let inputs = BTreeMap::from([
            inputs_of("hypotheses", drive("b", 4)).unwrap(),
            inputs_of("models", learnt.clone()).unwrap(),
        ]);
        let entry = registry.get(operator).unwrap();
        let fault = run(entry, &json!({}), &inputs, Split::default()).unwrap_err();
        assert!(
            fault.to_string().contains("expected a model of people"),
            "{fault}"
        );
    }
}

#[test]
fn what_is_not_described_as_others_are_is_counted() {
    let mut odd = examples();
    odd[3].description = vec![1.0; 2];
    odd[4].description[0] = f32::NAN;
    let inputs = [inputs_of("examples", odd).unwrap()];
    let (learnt, losses) = yields::<PersonModel>("person_models", json!({}), inputs);
    assert_eq!((learnt[0].accepted, learnt[0].rejected), (9, 9));
    assert_eq!(losses.total(), 2, "{losses:?}");
    for operator in ["people", "person_questions"] {
        let mut hypotheses = drive("b", 8);
        hypotheses[1].description = vec![1.0; 4];
        hypotheses[2].description = Vec::new();
        hypotheses[5].probability = f64::NAN;
        let inputs = [
            inputs_of("hypotheses", hypotheses).unwrap(),
            inputs_of("models", learnt.clone()).unwrap(),
        ];
        let registry = evermap_catalog::registry();
        let entry = registry.get(operator).unwrap();
        let found = run(entry, &json!({}), &BTreeMap::from(inputs), Split::default()).unwrap();
        assert_eq!(found.losses.total(), 3, "{operator}: {:?}", found.losses);
    }
}
