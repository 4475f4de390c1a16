//! Figures of relocation worked out by hand, and what they must not depend on.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use evermap_bench::relocation::{Distances, EvaluationOptions, evaluate};
use nalgebra::Vector3;
use proptest::prelude::*;

/// Places on a line, metres.
fn line(places: &[f64]) -> Vec<Vector3<f64>> {
    places.iter().map(|x| Vector3::new(*x, 0.0, 0.0)).collect()
}

fn matrix(rows: &[&[f64]]) -> Distances {
    Distances::new(rows.len(), rows[0].len(), |query| rows[query].to_vec())
}

/// Two queries, worked out by hand.
#[test]
fn figures_are_those_of_the_definition() {
    let distances = matrix(&[&[0.2, 0.4, 0.6, 1.0], &[0.5, 0.9, 0.5, 0.7]]);
    let views = line(&[0.0, 10.0, 20.0, 30.0]);
    let queries = line(&[1.0, 21.0]);
    let options = EvaluationOptions {
        within_m: 2.0,
        corresponding: 1,
    };
    let found = evaluate(&distances, &queries, &views, &options).unwrap();
    // The second query is equally near to the first view and to the third.
    assert!((found.recall - 0.75).abs() < 1e-12);
    assert!((found.possible - 1.0).abs() < 1e-12);
    // Query by query: 0, then 0.25, 0.5, 1; and 0, then 0, 1, 0.5.
    assert_eq!(found.d_true, 0.0);
    assert!((found.d_false - (1.75 / 3.0 + 0.5) / 2.0).abs() < 1e-12);
    assert_eq!(found.power, f64::INFINITY);
    // From 0.2 to 1: 0 and 0.375 are right.
    let right = (0.0 + 0.375) / 2.0;
    let wrong = ((0.25 + 0.5 + 1.0) / 3.0 + (0.375 + 0.875 + 0.625) / 3.0) / 2.0;
    assert!((found.power_of_matrix - wrong / right).abs() < 1e-12);
}

#[test]
fn a_method_that_says_nothing_has_no_power() {
    let views = line(&[0.0, 1.0, 2.0, 3.0, 4.0, 50.0, 60.0, 70.0]);
    let same = Distances::new(1, 8, |_| vec![0.3; 8]);
    let found = evaluate(&same, &line(&[0.0]), &views, &EvaluationOptions::default()).unwrap();
    assert_eq!((found.power, found.power_of_matrix), (1.0, 1.0));
    assert!((found.recall - 5.0 / 8.0).abs() < 1e-12);
    let silent = Distances::new(1, 8, |_| vec![f64::NAN, f64::INFINITY]);
    let found = evaluate(
        &silent,
        &line(&[0.0]),
        &views,
        &EvaluationOptions::default(),
    )
    .unwrap();
    assert_eq!(found.power, 1.0);
}

#[test]
fn nothing_is_said_of_nothing() {
    let options = EvaluationOptions::default();
    let views = line(&[0.0, 1.0, 2.0]);
    let none = Distances::new(0, 3, |_| Vec::new());
    assert_eq!(evaluate(&none, &[], &views, &options), None);
    assert!(none.row(0).is_empty() && none.normalised().is_empty());
    let few = Distances::new(1, 3, |_| vec![0.0; 3]);
    assert_eq!(evaluate(&few, &views[..1], &views, &options), None);
    assert_eq!(evaluate(&few, &views, &views, &options), None);
    let empty = Distances::new(2, 0, |_| Vec::new());
    assert_eq!((empty.queries(), empty.views()), (0, 0));
    assert_eq!(evaluate(&empty, &views[..2], &[], &options), None);
}

proptest! {
    /// Neither a method's unit nor the order of the views counts.
    #[test]
    fn scale_and_order_do_not_count(
        rows in prop::collection::vec(prop::collection::vec(0.0..1.0_f64, 9), 1..6),
        places in prop::collection::vec(-50.0..50.0_f64, 15),
        factor in 0.01..100.0_f64,
        offset in -5.0..5.0_f64,
    ) {
        let (queries, views) = (line(&places[9..][..rows.len()]), line(&places[..9]));
        let options = EvaluationOptions::default();
        let distances = Distances::new(rows.len(), 9, |query| rows[query].clone());
        let found = evaluate(&distances, &queries, &views, &options).unwrap();
        prop_assert!((0.0..=1.0).contains(&found.recall) && found.recall <= found.possible + 1e-12);
        prop_assert!(distances.normalised().iter().all(|value| (0.0..=1.0).contains(value)));
        let other = Distances::new(rows.len(), 9, |query| {
            rows[query].iter().rev().map(|value| value * factor + offset).collect()
        });
        let reversed: Vec<_> = views.iter().rev().copied().collect();
        let again = evaluate(&other, &queries, &reversed, &options).unwrap();
        prop_assert!((found.recall - again.recall).abs() < 1e-9);
        prop_assert!((found.power / again.power - 1.0).abs() < 1e-6);
        prop_assert!((found.power_of_matrix / again.power_of_matrix - 1.0).abs() < 1e-6);
    }
}
