#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
use super::*;
use proptest::prelude::*;

/// Σ_j exp(-|p_i - p_j|² / 2) in(j), the first coordinate around a circle of that length if there is one.
fn gaussian(coordinates: &[Vec<f32>], around: Option<f32>, values: &[f32]) -> Vec<f32> {
    let apart = |axis: usize, i: usize, j: usize| {
        let apart = (coordinates[axis][i] - coordinates[axis][j]).abs();
        match around {
            Some(around) if axis == 0 => apart.min(around - apart),
            _ => apart,
        }
    };
    let weight = |i: usize, j: usize| {
        let squared: f32 = (0..coordinates.len())
            .map(|axis| apart(axis, i, j).powi(2))
            .sum();
        (-0.5 * squared).exp()
    };
    (0..values.len())
        .map(|i| (0..values.len()).map(|j| weight(i, j) * values[j]).sum())
        .collect()
}

fn lists(coordinates: &[Vec<f32>]) -> Vec<&[f32]> {
    coordinates.iter().map(Vec::as_slice).collect()
}

/// Both filters of the values over both of ones: the largest and the mean difference.
fn difference(given: &[f32], lattice: [Vec<f32>; 2], exact: [Vec<f32>; 2]) -> [f32; 2] {
    let ratio = |of: &[Vec<f32>; 2], i: usize| of[0][i] / of[1][i];
    let differences: Vec<f32> = (0..given.len())
        .map(|i| (ratio(&lattice, i) - ratio(&exact, i)).abs())
        .collect();
    let most = differences.iter().copied().fold(0.0, f32::max);
    [most, differences.iter().sum::<f32>() / given.len() as f32]
}

/// A grid of 18 × 14 positions, three to a deviation, with a value each.
fn grid(width: usize, step: f32) -> Vec<Vec<f32>> {
    let place = |i: usize| [(i % width) as f32 * step, (i / width) as f32 * step];
    (0..2)
        .map(|axis| (0..width * 14).map(|i| place(i)[axis]).collect())
        .collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn filters_like_a_gaussian(values in prop::collection::vec(0.0..1.0f32, 18 * 14)) {
        let coordinates = grid(18, 0.35);
        let lattice = Lattice::<3>::new(&lists(&coordinates)).unwrap();
        let ones = vec![1.0; values.len()];
        let found = [lattice.filter(&values), lattice.filter(&ones)];
        let exact = [gaussian(&coordinates, None, &values), gaussian(&coordinates, None, &ones)];
        let [most, mean] = difference(&values, found, exact);
        prop_assert!(most < 0.15 && mean < 0.03, "{most} {mean}");
    }

    #[test]
    fn filters_like_a_gaussian_around_a_circle(values in prop::collection::vec(0.0..1.0f32, 18 * 14)) {
        let around = Lattice::<3>::period(4) as f32;
        let mut coordinates = grid(18, 0.35);
        coordinates[0].iter_mut().for_each(|x| *x *= around / (18.0 * 0.35));
        let lattice = Lattice::<3>::periodic(&lists(&coordinates), 4).unwrap();
        let ones = vec![1.0; values.len()];
        let found = [lattice.filter(&values), lattice.filter(&ones)];
        let around = Some(around);
        let exact = [gaussian(&coordinates, around, &values), gaussian(&coordinates, around, &ones)];
        let [most, mean] = difference(&values, found, exact);
        prop_assert!(most < 0.15 && mean < 0.03, "{most} {mean}");
    }

    /// A cell's length around the circle changes nothing, wherever the seam is then.
    #[test]
    fn a_circle_has_no_seam(
        x in prop::collection::vec(0.0..1.0f32, 40),
        y in prop::collection::vec(0.0..4.0f32, 40),
        cells in 1..6u32,
        shift in 1..6u32,
    ) {
        let around = Lattice::<3>::period(cells) as f32;
        let placed = |shift: u32| -> Vec<f32> {
            let by = Lattice::<3>::period(shift) as f32;
            x.iter().map(|x| (x * around + by) % around).collect()
        };
        let values: Vec<f32> = (0..40).map(|i| (i * i % 17) as f32).collect();
        let here = Lattice::<3>::periodic(&[&placed(0), &y], cells).unwrap().filter(&values);
        let there = Lattice::<3>::periodic(&[&placed(shift), &y], cells).unwrap().filter(&values);
        for (here, there) in here.iter().zip(&there) {
            prop_assert!((here - there).abs() < 1e-3 * (1.0 + here.abs()), "{here} {there}");
        }
    }

    #[test]
    fn weights_are_barycentric(
        coordinates in prop::collection::vec(prop::collection::vec(-50.0..50.0f32, 33), 5),
    ) {
        let lattice = Lattice::<6>::new(&lists(&coordinates)).unwrap();
        for weights in lattice.grouping.weights() {
            prop_assert!(weights.iter().all(|weight| (-1e-4..1.0001).contains(weight)));
            prop_assert!((weights.iter().sum::<f32>() - 1.0).abs() < 1e-4);
        }
        for corners in &lattice.corners {
            prop_assert!(corners.iter().all(|corner| *corner > 0 && (*corner as usize) < lattice.corners()));
        }
    }

    /// In five dimensions positions are sparse, and the approximation is rough where only a few have weight.
    #[test]
    fn filters_in_five_dimensions(
        coordinates in prop::collection::vec(prop::collection::vec(0.0..1.5f32, 150), 5),
        values in prop::collection::vec(0.0..1.0f32, 150),
    ) {
        let lattice = Lattice::<6>::new(&lists(&coordinates)).unwrap();
        let ones = vec![1.0; values.len()];
        let found = [lattice.filter(&values), lattice.filter(&ones)];
        let exact = [gaussian(&coordinates, None, &values), gaussian(&coordinates, None, &ones)];
        let [most, mean] = difference(&values, found, exact);
        prop_assert!(most < 0.1 && mean < 0.03, "{most} {mean}");
    }

    /// Eight channels are filtered as one would be.
    #[test]
    fn channels_do_not_mix(values in prop::collection::vec(-1.0..1.0f32, 18 * 14)) {
        let lattice = Lattice::<3>::new(&lists(&grid(18, 0.35))).unwrap();
        let eights: Vec<[Eight; 1]> = values
            .iter()
            .map(|value| [Eight(std::array::from_fn(|channel| channel as f32 * value))])
            .collect();
        let mut buffer = lattice.buffer();
        for (block, eights) in eights.chunks(BLOCK).enumerate() {
            lattice.splat(block, eights, buffer.values_mut());
        }
        lattice.blur(&mut buffer, lattice.constant());
        let mut found = vec![<[Eight; 1]>::ZERO; values.len()];
        for (block, found) in found.chunks_mut(BLOCK).enumerate() {
            lattice.slice(block, buffer.values(), found);
        }
        for ([eight], one) in found.iter().zip(lattice.filter(&values)) {
            for (channel, value) in eight.0.iter().enumerate() {
                prop_assert!((value - channel as f32 * one).abs() < 1e-4);
            }
        }
    }
}

#[test]
fn positions_that_cannot_be_embedded_are_refused() {
    let line = [0.0, 1.0];
    assert!(matches!(
        Lattice::<3>::new(&[&line, &[f32::NAN, 0.0]]),
        Err(LatticeError::Position { .. })
    ));
    assert!(matches!(
        Lattice::<3>::new(&[&line, &[1e9, 0.0]]),
        Err(LatticeError::Position { .. })
    ));
    assert!(matches!(
        Lattice::<3>::new(&[&line, &line[..1]]),
        Err(LatticeError::Shape { .. })
    ));
    assert!(matches!(
        Lattice::<3>::new(&[&line]),
        Err(LatticeError::Shape { .. })
    ));
    let nobody = Lattice::<3>::new(&[&[], &[]]).unwrap();
    assert!(nobody.is_empty() && nobody.filter(&[]).is_empty());
}
