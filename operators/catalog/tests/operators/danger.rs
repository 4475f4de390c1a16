//! Danger maps of settings that nobody made here.

use std::collections::BTreeMap;

use evermap_contract::laws::{Split, inputs_of, run};
use evermap_schemas::Stamp;
use evermap_schemas::layers::{Danger, DangerSetting, Exposure, GroundPrior};
use serde_json::json;

use crate::yields;

fn looked() -> Exposure {
    Exposure {
        site: "lot".into(),
        session: "a".into(),
        column: 3,
        row: 4,
        cell_m: 0.5,
        look_s: 0.7,
        looks: 2,
        first_stamp: Stamp(1),
    }
}

/// Settings with a prior for each of these kinds.
fn settings(kinds: &[(&str, f64)]) -> DangerSetting {
    let prior = |(kind, probability): &(&str, f64)| GroundPrior {
        kind: (*kind).into(),
        expected: *probability,
        probability: *probability,
    };
    DangerSetting {
        site: "lot".into(),
        visits: 1,
        visits_with_people: 0,
        priors: kinds.iter().map(prior).collect(),
        prior_looks: 1.0,
        tie_looks: 1.0,
        foretold_looks: 0.0,
        log_likelihood: None,
        log_likelihood_of_expected: None,
        log_likelihood_of_kinds: None,
        log_likelihood_of_counts: None,
    }
}

#[test]
fn settings_in_any_order_mean_the_same() {
    let inputs = [
        inputs_of("exposure", vec![looked()]).unwrap(),
        inputs_of(
            "settings",
            vec![settings(&[("other", 0.1), ("crossing", 0.4)])],
        )
        .unwrap(),
    ];
    let (rows, _) = yields::<Danger>("danger_map", json!({}), inputs);
    assert_eq!(rows.len(), 1);
    assert_eq!((rows[0].ground.as_str(), rows[0].prior), ("other", 0.1));
}

#[test]
fn settings_without_the_rest_of_the_ground_are_refused() {
    let registry = evermap_catalog::registry();
    let inputs = BTreeMap::from([
        inputs_of("exposure", vec![looked()]).unwrap(),
        inputs_of("settings", vec![settings(&[])]).unwrap(),
    ]);
    let entry = registry.get("danger_map").unwrap();
    let fault = run(entry, &json!({}), &inputs, Split::default()).unwrap_err();
    assert!(
        fault
            .to_string()
            .contains("expected settings with a prior of other")
    );
}
