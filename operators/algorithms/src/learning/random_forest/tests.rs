#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
use proptest::prelude::*;

use super::split::Histogram;
use super::*;
use crate::learning::samples::Samples;
use crate::solving::random::SplitMix64;

/// Two features decide (their exclusive or), the others are noise; class 2 is rare.
fn puzzle(count: usize, seed: u64) -> (Vec<u8>, Vec<u8>) {
    let mut random = SplitMix64(seed);
    let (mut labels, mut values) = (Vec::new(), Vec::new());
    for _ in 0..count {
        let sample: [u8; 6] = std::array::from_fn(|_| random.below(256) as u8);
        let rare = sample[0] > 250;
        labels.push(if rare {
            2
        } else {
            u8::from((sample[0] > 90) ^ (sample[3] > 170))
        });
        values.extend(sample);
    }
    (labels, values)
}

fn options() -> ForestOptions {
    ForestOptions {
        trees: 12,
        tried_features: 3,
        min_leaf: 2,
        ..ForestOptions::default()
    }
}

fn samples<'a>(labels: &'a [u8], values: &'a [u8], blocks: &'a [u32]) -> Samples<'a> {
    Samples {
        dimensions: 6,
        classes: 3,
        labels,
        values,
        blocks,
    }
}

fn predicted(forest: &Forest, values: &[u8], block: Option<u32>) -> Vec<f32> {
    let mut scores = vec![0.0; values.len() / forest.dimensions() * forest.classes()];
    forest.predict(values, block, &mut scores);
    scores
}

fn accuracy(scores: &[f32], labels: &[u8]) -> f64 {
    let right = scores
        .chunks_exact(3)
        .zip(labels)
        .filter(|(scores, label)| {
            let own = scores[usize::from(**label)];
            scores.iter().all(|score| *score <= own)
        });
    right.count() as f64 / labels.len() as f64
}

#[test]
fn what_two_features_decide_is_learnt_and_holds_for_others() {
    let (labels, values) = puzzle(4000, 1);
    let trees = train(&samples(&labels, &values, &[]), &options());
    let forest = Forest::new(&trees, 6, 3).unwrap();
    let (others, unseen) = puzzle(2000, 2);
    let scores = predicted(&forest, &unseen, None);
    let found = accuracy(&scores, &others);
    assert!(found > 0.95, "{found}");
    let sums = scores
        .chunks_exact(3)
        .map(|scores| scores.iter().sum::<f32>());
    assert!(sums.into_iter().all(|sum| (sum - 1.0).abs() < 1e-5));
}

#[test]
fn the_forest_is_the_same_on_any_number_of_threads() {
    let (labels, values) = puzzle(1500, 3);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| train(&samples(&labels, &values, &[]), &options()))
    };
    assert_eq!(on(1), on(4));
    let other = ForestOptions {
        seed: 2,
        ..options()
    };
    assert_ne!(on(1), train(&samples(&labels, &values, &[]), &other));
}

#[test]
fn trees_do_not_know_the_block_that_they_held_out() {
    let (mut labels, values) = puzzle(1200, 4);
    let blocks: Vec<u32> = (0..1200).map(|i| 5 * (i / 400)).collect();
    // Class 2 only occurs in the last block.
    for (label, block) in labels.iter_mut().zip(&blocks) {
        *label = if *block == 10 { 2 } else { (*label).min(1) };
    }
    let trees = train(&samples(&labels, &values, &blocks), &options());
    let mut held_out: Vec<_> = trees.iter().filter_map(|tree| tree.held_out).collect();
    held_out.sort_unstable();
    assert_eq!(held_out, [0, 0, 0, 0, 5, 5, 5, 5, 10, 10, 10, 10]);
    let forest = Forest::new(&trees, 6, 3).unwrap();
    let honest = predicted(&forest, &values, Some(10));
    assert!(honest.chunks_exact(3).all(|scores| scores[2] == 0.0));
    let all = predicted(&forest, &values, None);
    assert!(all.chunks_exact(3).any(|scores| scores[2] > 0.3));
    assert_eq!(predicted(&forest, &values, Some(77)), all);
}

#[test]
fn weights_find_the_rare_class() {
    let (mut labels, values) = puzzle(6000, 5);
    // Rare, and not to be told for certain: 30 of 100 above the threshold.
    let mut random = SplitMix64(9);
    for (label, sample) in labels.iter_mut().zip(values.chunks_exact(6)) {
        *label = u8::from(sample[1] > 200 && random.below(100) < 30);
    }
    let recall = |balance: f64| {
        let options = ForestOptions {
            balance,
            min_leaf: 20,
            ..options()
        };
        let trees = train(&samples(&labels, &values, &[]), &options);
        let scores = predicted(&Forest::new(&trees, 6, 3).unwrap(), &values, None);
        let found = scores
            .chunks_exact(3)
            .zip(&labels)
            .filter(|(s, l)| **l == 1 && s[1] > s[0]);
        found.count() as f64 / labels.iter().filter(|label| **label == 1).count() as f64
    };
    let (plain, weighted) = (recall(0.0), recall(1.0));
    assert!(weighted > 0.9 && plain < 0.7, "{plain} {weighted}");
}

#[test]
fn nothing_to_learn_from_gives_no_trees() {
    assert!(train(&samples(&[], &[], &[]), &options()).is_empty());
    assert!(train(&samples(&[0, 1], &[0; 6], &[]), &options()).is_empty());
    assert!(train(&samples(&[0], &[0; 6], &[0, 1]), &options()).is_empty());
    // One class, one block, labels out of range.
    let trees = train(&samples(&[1, 1, 9], &[7; 18], &[4, 4, 4]), &options());
    assert_eq!(trees.len(), 12);
    assert!(
        trees
            .iter()
            .all(|tree| tree.nodes.len() == 1 && tree.held_out.is_none())
    );
    assert_eq!(trees[0].distributions, [0.0, 1.0, 0.0]);
    let nothing = train(&samples(&[9], &[7; 6], &[]), &options());
    assert!(Forest::new(&nothing, 6, 3).is_ok());
}

#[test]
fn trees_that_would_lead_astray_are_refused() {
    let leaf = |leaf| Node {
        leaf,
        ..Node::default()
    };
    let inner = |left, feature| Node {
        feature,
        threshold: 3,
        left,
        leaf: 0,
    };
    let tree = |nodes: Vec<Node>| Tree {
        nodes,
        distributions: vec![0.5; 4],
        held_out: None,
    };
    let check = |nodes| Forest::new(&[tree(nodes)], 2, 2).map(drop);
    assert_eq!(check(vec![inner(1, 1), leaf(0), leaf(1)]), Ok(()));
    assert_eq!(check(vec![]), Err(TreeError::Empty));
    assert!(matches!(
        check(vec![inner(1, 0), inner(1, 0), leaf(0)]),
        Err(TreeError::Child { node: 1, .. })
    ));
    assert!(matches!(
        check(vec![inner(2, 0), leaf(0), leaf(1)]),
        Err(TreeError::Child { node: 0, .. })
    ));
    assert!(matches!(
        check(vec![inner(1, 2), leaf(0), leaf(1)]),
        Err(TreeError::Feature { .. })
    ));
    assert!(matches!(
        check(vec![leaf(2)]),
        Err(TreeError::Leaf { leaf: 2, .. })
    ));
    assert!(matches!(
        check(vec![leaf(u32::MAX)]),
        Err(TreeError::Leaf { .. })
    ));
    assert!(Forest::new(&[], 2, 2).is_err());
    let nan = Tree {
        distributions: vec![f32::NAN; 4],
        ..tree(vec![leaf(0)])
    };
    assert!(Forest::new(&[nan], 2, 2).is_err());
}

#[test]
fn priors_favour_what_is_frequent() {
    let mut p = [0.4, 0.35, 0.25];
    with_priors(&mut p, &prior_factors(&[0.0, 0.75, 0.25], 1.0));
    assert_eq!(p.map(|p| (1000.0 * p).round()), [0.0, 808.0, 192.0]);
    let mut same = [0.4, 0.6];
    with_priors(&mut same, &prior_factors(&[0.9, 0.1], 0.0));
    assert_eq!(same, [0.4, 0.6]);
    let mut none = [1.0, 0.0];
    with_priors(&mut none, &[0.0, 1.0]);
    assert_eq!(none, [1.0, 0.0]);
}

/// What is left of Gini's impurity on both sides, times the samples: the smaller, the better the split.
fn impurity(samples: &[(u8, u8, u32)], weights: &[f64], threshold: u8) -> Option<f64> {
    let side = |left: bool| {
        let mut sums = vec![0.0; weights.len()];
        for (value, class, count) in samples {
            if (*value <= threshold) == left {
                sums[usize::from(*class)] += f64::from(*count) * weights[usize::from(*class)];
            }
        }
        let all: f64 = sums.iter().sum();
        (all > 0.0).then(|| all * (1.0 - sums.iter().map(|sum| (sum / all).powi(2)).sum::<f64>()))
    };
    Some(side(true)? + side(false)?)
}

/// Each sample by itself, down the trees as they are stored.
fn one_by_one(trees: &[Tree], values: &[u8], dimensions: usize) -> Vec<f32> {
    let mut scores = Vec::new();
    for sample in values.chunks_exact(dimensions) {
        let mut sums = [0.0_f32; 3];
        for tree in trees {
            let mut node = tree.nodes[0];
            while node.left != 0 {
                let right = sample[usize::from(node.feature)] > node.threshold;
                node = tree.nodes[node.left as usize + usize::from(right)];
            }
            for (sum, p) in sums
                .iter_mut()
                .zip(&tree.distributions[3 * node.leaf as usize..])
            {
                *sum += p;
            }
        }
        scores.extend(sums.map(|sum| sum * (trees.len() as f32).recip()));
    }
    scores
}

/// A tree in which every sample takes so many steps, by features from `first` on.
fn full(depth: u32, first: u16) -> Tree {
    let inner = (1_u32 << depth) - 1;
    let node = |index: u32| match index.checked_sub(inner) {
        None => Node {
            feature: first + (index % 6) as u16,
            threshold: (97 * index % 251) as u8,
            left: 2 * index + 1,
            leaf: 0,
        },
        Some(leaf) => Node {
            leaf,
            ..Node::default()
        },
    };
    Tree {
        nodes: (0..=2 * inner).map(node).collect(),
        distributions: (0..3 * (inner + 1)).map(|i| (i % 31) as f32).collect(),
        held_out: None,
    }
}

#[test]
fn trees_with_many_nodes_or_features_are_walked_too() {
    let (_, unseen) = puzzle(700, 8);
    let short = full(3, 0);
    let far = Tree {
        nodes: full(3, 506).nodes,
        ..short.clone()
    };
    // One more than 9 bits count, and one more level than 15 bits do.
    for (trees, dimensions) in [
        ([short.clone(), full(14, 0)], 6),
        ([full(15, 0), short.clone()], 6),
        ([far, short], 512),
        ([full(4, 508), full(15, 507)], 514),
    ] {
        let mut values = vec![0; 700 * dimensions];
        for (all, last) in values.chunks_exact_mut(dimensions).zip(unseen.chunks(6)) {
            all[dimensions - 6..].copy_from_slice(last);
        }
        let forest = Forest::new(&trees, dimensions, 3).unwrap();
        let expected = one_by_one(&trees, &values, dimensions);
        assert_eq!(predicted(&forest, &values, None), expected);
    }
}

proptest! {
    #[test]
    fn the_best_split_is_found(
        samples in prop::collection::vec((prop_oneof![0_u8..6, any::<u8>()], 0_u8..3, 1_u32..4), 2..40),
        weights in prop::array::uniform3(0.1_f64..10.0),
        least in 1_u64..5,
    ) {
        let mut totals = vec![0; 3];
        let mut histogram = Histogram::new(3);
        for (value, class, count) in &samples {
            totals[usize::from(*class)] += count;
            histogram.add(*value, *class, *count);
        }
        let on_side = |threshold: u8, left: bool| -> u64 {
            samples.iter().filter(|s| (s.0 <= threshold) == left).map(|s| u64::from(s.2)).sum()
        };
        let allowed = |t: &u8| on_side(*t, true) >= least && on_side(*t, false) >= least;
        let best = (0..=254).filter(allowed).filter_map(|t| impurity(&samples, &weights, t)).reduce(f64::min);
        let found = histogram.take_best(&totals, &weights, least);
        prop_assert_eq!(found.is_some(), best.is_some());
        if let (Some((threshold, _)), Some(best)) = (found, best) {
            prop_assert!(allowed(&threshold));
            let own = impurity(&samples, &weights, threshold).unwrap();
            prop_assert!((own - best).abs() < 1e-6, "{} {}", own, best);
        }
        prop_assert!(histogram.take_best(&totals, &weights, 1).is_none(), "emptied");
    }

    #[test]
    fn many_at_once_are_as_each_by_itself(count in 0_usize..70, seed in any::<u64>()) {
        let (labels, values) = puzzle(300, seed);
        let trees = train(&samples(&labels, &values, &[]), &ForestOptions { trees: 3, ..options() });
        let forest = Forest::new(&trees, 6, 3).unwrap();
        let (_, unseen) = puzzle(count, seed.wrapping_add(1));
        prop_assert_eq!(predicted(&forest, &unseen, None), one_by_one(&trees, &unseen, 6));
    }
}
