//! Parameters: what several operators share is one thing, and what makes no sense is refused.

use std::collections::BTreeMap;

use serde_json::{Value, json};

/// What is wrong with parameters of an operator.
fn faults(operator: &str, params: Value) -> Vec<String> {
    let registry = evermap_catalog::registry();
    let faults = registry.get(operator).unwrap().faults(&params);
    faults.into_iter().map(|fault| fault.message).collect()
}

#[test]
fn what_operators_share_has_one_default_range_and_meaning() {
    let registry = evermap_catalog::registry();
    let mut declared = BTreeMap::new();
    let mut sharing: BTreeMap<String, usize> = BTreeMap::new();
    let shared = [
        "vehicle_frame",
        "match_bits",
        "match_ratio",
        "odometry_scale_sigma",
        "sigma_px",
    ];
    for entry in registry.entries() {
        for parameter in entry.parameters() {
            if shared.contains(&parameter.name.as_str()) {
                *sharing.entry(parameter.name.clone()).or_default() += 1;
                let first = declared
                    .entry(parameter.name.clone())
                    .or_insert_with(|| parameter.clone());
                assert_eq!(*first, parameter, "{}", entry.name);
            }
        }
    }
    assert!(
        sharing.len() == shared.len() && sharing.values().all(|operators| *operators >= 3),
        "{sharing:?}"
    );
}

#[test]
fn the_tree_that_compares_views_is_a_word() {
    for operator in ["relocations", "relocation_calibrations"] {
        for tree in ["weighted", "interpretation"] {
            let params = json!({ "tree": tree, "contact_rad": 0.1, "fused": true });
            assert_eq!(faults(operator, params), Vec::<String>::new());
        }
        assert_eq!(faults(operator, json!({ "tree": "papers" })).len(), 1);
        let limits = json!({ "max_eccentricity": 1.5, "contact_rad": -1 });
        assert_eq!(faults(operator, limits).len(), 2);
    }
}

#[test]
fn senseless_parameters_are_refused() {
    assert_eq!(
        faults(
            "keyframes",
            json!({ "baseline_m": 0, "deadband_m": -0.1, "max_speed_mps": 0.0 })
        ),
        [
            "expected `baseline_m` above 0, found 0",
            "expected `deadband_m` of at least 0, found -0.1",
            "expected `max_speed_mps` above 0 and at most 1000, found 0.0",
        ]
    );
    assert_eq!(
        faults("keyframes", json!({ "deadband_m": 0.3 })),
        ["expected deadband_m <= baseline_m, found 0.3 and 0.2"]
    );
    assert_eq!(
        faults(
            "localisation",
            json!({ "sigma_px": 0, "min_inlier_share": 1.5, "min_inliers": 5 })
        ),
        [
            "expected `sigma_px` above 0, found 0",
            "expected `min_inlier_share` from 0 to 1, found 1.5",
            "expected `min_inliers` of at least 6, found 5",
        ]
    );
    assert_eq!(
        faults("localisation", json!({ "sigma_px": 4 })),
        ["expected verify_px of at least 4 times sigma_px (4 px), found 12"]
    );
    assert_eq!(
        faults("features", json!({ "scale": 9, "min_contrast": 0 })),
        [
            "expected `scale` from 0 to 8, found 9",
            "expected `min_contrast` from 1 to 255, found 0"
        ]
    );
}
