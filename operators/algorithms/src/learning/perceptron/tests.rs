#![allow(clippy::unwrap_used)]
use nalgebra::DMatrix;

use super::*;
use crate::learning::samples::Samples;
use crate::solving::random::SplitMix64;

/// Two features: classes 0 and 1 lie inside and outside of a ring, which no line tells apart; a third one is always the same.
fn ring(count: usize, seed: u64) -> (Vec<u8>, Vec<u8>) {
    let mut random = SplitMix64(seed);
    let (mut labels, mut values) = (Vec::new(), Vec::new());
    while labels.len() < count {
        let at = [random.unit(), random.unit()].map(|share| 2.0 * share - 1.0);
        let inside = at[0].hypot(at[1]) < 0.6;
        // Three of four that are outside are left out.
        if inside || random.below(4) == 0 {
            labels.push(u8::from(!inside));
            values.extend(at.map(|value| (128.0 + 100.0 * value) as u8));
            values.push(77);
        }
    }
    (labels, values)
}

fn samples<'a>(labels: &'a [u8], values: &'a [u8], blocks: &'a [u32]) -> Samples<'a> {
    Samples {
        dimensions: 3,
        classes: 2,
        labels,
        values,
        blocks,
    }
}

fn options() -> NetworkOptions {
    NetworkOptions {
        members: 3,
        least_steps: 1000,
        ..NetworkOptions::default()
    }
}

fn predict(network: &Network, values: &[u8], block: Option<u32>) -> Vec<f32> {
    let samples = values.len() / 3;
    let values = values.iter().map(|value| f32::from(*value));
    let values = DMatrix::from_iterator(3, samples, values);
    let voters = network.voters(block);
    let mut inner = voters.biases(samples);
    inner.gemm(1.0, voters.hidden(), &values, 1.0);
    let mut scores = vec![0.0; 2 * samples];
    voters.scores(inner, &mut scores);
    scores
}

#[test]
fn a_ring_is_told_from_what_is_around_it() {
    let (labels, values) = ring(4000, 1);
    let members = train(&samples(&labels, &values, &[]), &options());
    assert!(members.len() == 3 && members[0] != members[1]);
    assert_eq!(members, train(&samples(&labels, &values, &[]), &options()));
    let network = Network::new(members, 3, 2).unwrap();
    let (labels, values) = ring(1000, 2);
    let scores = predict(&network, &values, None);
    let right = labels.iter().zip(scores.chunks_exact(2));
    let right = right
        .filter(|(label, p)| (p[1] > p[0]) == (**label == 1))
        .count();
    assert!(right > 950, "{right}");
    assert!(
        scores
            .chunks_exact(2)
            .all(|p| (p[0] + p[1] - 1.0).abs() < 1e-5)
    );
}

#[test]
fn classes_count_as_if_they_were_equally_frequent() {
    // Nothing tells them apart, and one is nine times as frequent.
    let mut random = SplitMix64(5);
    let labels: Vec<u8> = (0..4000).map(|_| u8::from(random.below(10) == 0)).collect();
    let values: Vec<u8> = (0..12_000).map(|_| random.below(256) as u8).collect();
    let members = train(&samples(&labels, &values, &[]), &options());
    let network = Network::new(members, 3, 2).unwrap();
    let scores = predict(&network, &values[..900], None);
    let mean: f32 = scores.chunks_exact(2).map(|p| p[0]).sum::<f32>() / 300.0;
    assert!((0.45..0.55).contains(&mean), "{mean}");
}

#[test]
fn a_block_is_scored_by_those_that_have_not_seen_it() {
    let (labels, values) = ring(600, 3);
    let blocks: Vec<u32> = (0..600).map(|at| at / 200).collect();
    let members = train(&samples(&labels, &values, &blocks), &options());
    let held_out: Vec<_> = members.iter().map(|member| member.held_out).collect();
    assert_eq!(held_out, [Some(0), Some(1), Some(2)]);
    let alone = Network::new(vec![members[1].clone()], 3, 2).unwrap();
    // What is in a block that a member holds out does not matter to it.
    let mut other = values.clone();
    other[600..1200].fill(9);
    assert_eq!(
        train(&samples(&labels, &other, &blocks), &options())[1],
        members[1]
    );
    let network = Network::new(members, 3, 2).unwrap();
    assert_eq!(
        predict(&network, &values, Some(1)),
        predict(&alone, &values, None)
    );
    assert_eq!(
        predict(&network, &values, Some(7)),
        predict(&network, &values, None)
    );
}

#[test]
fn what_does_not_fit_is_refused() {
    let (labels, values) = ring(300, 4);
    let good = train(&samples(&labels, &values, &[]), &options())[0].clone();
    assert_eq!(
        Network::new(Vec::new(), 3, 2).unwrap_err(),
        NetworkError::Empty("member")
    );
    assert!(Network::new(vec![good.clone()], 4, 2).is_err());
    assert!(Network::new(vec![good.clone()], 3, 3).is_err());
    let nothing = Perceptron {
        hidden: Vec::new(),
        hidden_biases: Vec::new(),
        output: Vec::new(),
        output_biases: Vec::new(),
        held_out: None,
    };
    let refused = |classes| nothing.check(3, classes);
    assert_eq!(refused(0), Err(NetworkError::Empty("class")));
    assert_eq!(refused(2), Err(NetworkError::Empty("hidden unit")));
    let mut torn = good.clone();
    torn.hidden_biases.pop();
    let said = torn.check(3, 2).unwrap_err().to_string();
    assert_eq!(said, "expected 93 weights of hidden units, found 96");
    let mut wild = good;
    wild.output[0] = f32::NAN;
    assert_eq!(wild.check(3, 2), Err(NetworkError::NotFinite));
    assert!(train(&samples(&labels, &values[1..], &[]), &options()).is_empty());
    assert!(train(&samples(&[], &[], &[]), &options()).is_empty());
}
