#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
mod examples;

use super::*;
use proptest::prelude::*;

// Wider than a tile.
const WIDTH: usize = 19;
const HEIGHT: usize = 3;
const PIXELS: usize = WIDTH * HEIGHT;

/// What pixels are by labels that are right with probability `confidence`, and else any other class. A label that is no
/// class says nothing.
pub(super) fn of_labels(classes: usize, labels: &[u8], confidence: f64) -> Unary {
    let others = (classes - 1) as f64;
    let (right, wrong) = (-confidence.ln(), -((1.0 - confidence) / others).ln());
    let unknown = (classes as f64).ln();
    let cost = |label: usize, class: usize| match label {
        label if label >= classes => unknown,
        label if label == class => right,
        _ => wrong,
    };
    let mut costs = Vec::with_capacity(labels.len() * classes);
    for label in labels {
        costs.extend((0..classes).map(|class| cost(usize::from(*label), class) as f32));
    }
    Unary::new(classes, costs).unwrap()
}

fn kernels() -> Kernels {
    Kernels {
        appearance_px: 2.0,
        appearance_colour: 20.0,
        appearance_weight: 2.0,
        smoothness_px: 1.2,
        smoothness_weight: 1.0,
    }
}

/// The pixels in the order of the lattices' positions.
fn order(field: &RandomField) -> Vec<usize> {
    let mut order = Vec::new();
    field.tiles.visit(|pixels| order.extend(pixels));
    order
}

/// Σ_m w_m k_m between all pairs, column by column: what the filters make of a single pixel.
fn pairs(field: &RandomField) -> Vec<Vec<f64>> {
    let order = order(field);
    let at = |pixel: usize| order.iter().position(|of| *of == pixel).unwrap();
    (0..PIXELS)
        .map(|pixel| {
            let mut one = vec![0.0; PIXELS];
            one[at(pixel)] = 1.0;
            let of_appearance = field
                .appearance
                .as_ref()
                .map(|kernel| (f64::from(kernel.weight), kernel.lattice.filter(&one)));
            let of_smoothness = field
                .smoothness
                .as_ref()
                .map(|kernel| (f64::from(kernel.weight), kernel.lattice.filter(&one)));
            let mut column = vec![0.0; PIXELS];
            for (weight, filtered) in of_appearance.into_iter().chain(of_smoothness) {
                for (pixel, sum) in column.iter_mut().enumerate() {
                    *sum += weight * f64::from(filtered[at(pixel)]);
                }
            }
            column
        })
        .collect()
}

/// The Gibbs energy of a labelling, up to what is equal for all labellings.
fn energy(field: &RandomField, unary: &Unary, labels: &[u8]) -> f64 {
    let costs = unary.costs.chunks(unary.classes).zip(labels);
    let own: f64 = costs
        .map(|(of, label)| f64::from(of[usize::from(*label)]))
        .sum();
    let joint = |class: u8| {
        let one: Vec<f32> = order(field)
            .into_iter()
            .map(|pixel| f32::from(u8::from(labels[pixel] == class)))
            .collect();
        let together = |filtered: Vec<f32>, weight: f32| {
            let products = one.iter().zip(filtered).map(|(a, b)| f64::from(a * b));
            f64::from(weight) * products.sum::<f64>()
        };
        let appearance = field.appearance.as_ref();
        let smoothness = field.smoothness.as_ref();
        appearance.map_or(0.0, |kernel| {
            together(kernel.lattice.filter(&one), kernel.weight)
        }) + smoothness.map_or(0.0, |kernel| {
            together(kernel.lattice.filter(&one), kernel.weight)
        })
    };
    own - 0.5 * (0..unary.classes as u8).map(joint).sum::<f64>()
}

/// Mean field as it is written down, with every pair.
fn brute_force(pairs: &[Vec<f64>], costs: &[f64], classes: usize, rounds: u32) -> Vec<f64> {
    let softmax = |logarithms: Vec<f64>| -> Vec<f64> {
        let mut all = Vec::new();
        for of_pixel in logarithms.chunks(classes) {
            let top = of_pixel.iter().copied().fold(f64::MIN, f64::max);
            let sum: f64 = of_pixel.iter().map(|value| (value - top).exp()).sum();
            all.extend(of_pixel.iter().map(|value| (value - top).exp() / sum));
        }
        all
    };
    let mut beliefs = softmax(costs.iter().map(|cost| -cost).collect());
    for _ in 0..rounds {
        let mut logarithms: Vec<f64> = costs.iter().map(|cost| -cost).collect();
        for from in 0..PIXELS {
            for to in 0..PIXELS {
                for class in 0..classes {
                    logarithms[to * classes + class] +=
                        pairs[from][to] * beliefs[from * classes + class];
                }
            }
        }
        beliefs = softmax(logarithms);
    }
    beliefs
}

fn view(colours: &[u8]) -> ColourView<'_> {
    ColourView::new(WIDTH as u32, HEIGHT as u32, colours).unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn mean_field_is_what_is_written_down(
        colours in prop::collection::vec(any::<u8>(), 3 * PIXELS),
        costs in prop::collection::vec(0.0..4.0f32, 11 * PIXELS),
        classes in 1..12usize,
        rounds in 0..6u32,
        wraps in any::<bool>(),
    ) {
        let field = RandomField::new(&view(&colours), &kernels(), wraps).unwrap();
        let costs = &costs[..classes * PIXELS];
        let unary = Unary::new(classes, costs.to_vec()).unwrap();
        let found = field.infer(&unary, rounds).unwrap();
        let costs: Vec<f64> = costs.iter().copied().map(f64::from).collect();
        let expected = brute_force(&pairs(&field), &costs, classes, rounds);
        for (found, expected) in found.probabilities.iter().zip(&expected) {
            prop_assert!((f64::from(*found) - expected).abs() < 2e-4, "{found} {expected}");
        }
    }

    /// Columns turned around a panorama by a lattice cell: labels turn with them.
    #[test]
    fn a_panorama_has_no_seam(noise in prop::collection::vec(0.0..1.0f32, 24 * 6)) {
        // σ is rounded to four cells around: six columns are a cell.
        let (width, height, turn) = (24, 6, 6);
        let kernels = Kernels { smoothness_px: 3.4, appearance_weight: 0.0, ..kernels() };
        let colours = vec![0; 3 * width * height];
        let image = ColourView::new(width as u32, height as u32, &colours).unwrap();
        let field = RandomField::new(&image, &kernels, true).unwrap();
        let costs = |turn: usize| -> Vec<f32> {
            let of = |i: usize| noise[i / width * width + (i + turn) % width];
            (0..width * height).flat_map(|i| [of(i), 1.0 - of(i)]).collect()
        };
        let infer = |turn| field.infer(&Unary::new(2, costs(turn)).unwrap(), 5).unwrap().probabilities;
        let (here, there) = (infer(0), infer(turn));
        for i in 0..width * height {
            let turned = i / width * width + (i + turn) % width;
            prop_assert!((here[2 * turned] - there[2 * i]).abs() < 1e-3);
        }
    }
}

/// A lonely wrong label gives way to its surroundings; the edge of colours holds.
#[test]
fn labels_follow_edges() {
    let (width, height) = (40, 30);
    let side = |i: usize| i % width >= 17;
    let colours: Vec<u8> = (0..width * height)
        .flat_map(|i| {
            if side(i) {
                [200, 180, 60]
            } else {
                [40, 60, 90]
            }
        })
        .collect();
    // Every seventh label is wrong.
    let labels: Vec<u8> = (0..width * height)
        .map(|i| u8::from(side(i) != (i * 31 % 7 == 0)))
        .collect();
    let image = ColourView::new(width as u32, height as u32, &colours).unwrap();
    let field = RandomField::new(&image, &Kernels::default(), false).unwrap();
    let unary = of_labels(2, &labels, 0.7);
    let found = field.infer(&unary, 10).unwrap().labels();
    let truth: Vec<u8> = (0..width * height).map(|i| u8::from(side(i))).collect();
    assert_eq!(found, truth);
    assert!(energy(&field, &unary, &found) < energy(&field, &unary, &labels));
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let (width, height) = (67, 41);
    let colours: Vec<u8> = (0..3 * width * height)
        .map(|i| (i * i / 7 % 251) as u8)
        .collect();
    let labels: Vec<u8> = (0..width * height).map(|i| (i / 5 % 9) as u8).collect();
    let image = ColourView::new(width as u32, height as u32, &colours).unwrap();
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            let field = RandomField::new(&image, &Kernels::default(), false).unwrap();
            field.infer(&of_labels(9, &labels, 0.6), 4).unwrap()
        })
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn what_makes_no_sense_is_refused() {
    let colours = [0; 12];
    assert!(ColourView::new(2, 3, &colours).is_none());
    assert!(ColourView::new(0, 0, &[]).is_none());
    let image = ColourView::new(2, 2, &colours).unwrap();
    for (px, weight) in [
        (0.0, 1.0),
        (f64::NAN, 1.0),
        (1.0, -1.0),
        (1.0, f64::INFINITY),
    ] {
        let kernels = Kernels {
            appearance_px: px,
            appearance_weight: weight,
            ..Kernels::default()
        };
        assert!(RandomField::new(&image, &kernels, false).is_err());
    }
    let tiny = Kernels {
        smoothness_px: 1e-9,
        ..Kernels::default()
    };
    assert!(matches!(
        RandomField::new(&image, &tiny, false),
        Err(CrfError::Lattice(_))
    ));
    assert!(Unary::new(0, Vec::new()).is_err());
    assert!(Unary::new(3, vec![0.0; 4]).is_err());
    assert!(Unary::new(2, vec![0.0, f32::NAN]).is_err());
    let field = RandomField::new(&image, &Kernels::default(), false).unwrap();
    let unary = of_labels(2, &[0; 5], 0.5);
    assert!(field.infer(&unary, 1).is_err());
    let uncertain = Unary::from_probabilities(2, &[f32::NAN, 2.0]).unwrap();
    assert_eq!(uncertain.costs, [-(1e-5f32.ln()), 0.0]);
}
