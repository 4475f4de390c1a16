//! What there is to learn from: descriptions of examples, of what lies beside them, and of the floor, with their answers.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::GroundBox;
use super::box_index::BoxIndex;
use super::description::{LENGTH, describe, reach_m};
use super::mosaic::{Mosaic, TileBlock};
use super::overhead::Gradients;
use super::teaching::{Example, Judgement, TeachingParams};
use super::template::{Template, laid_out};
use crate::learning::gaussian_process::LinearProcess;
use crate::solving::random::SplitMix64;

/// Boxes whose sides differ by less than this part are of one size.
const ONE_SIZE: f64 = 0.15;
/// Times that all boxes are looked at to turn them, at most.
const MOST_TURNS: usize = 20;
/// A random box that overlaps a known one by more than this is no example of the floor.
const CLEAR: f64 = 0.1;

/// How far the largest of boxes is described from its middle (m).
pub(super) fn reach_of(sizes_m: &[[f64; 2]]) -> f64 {
    let reach = sizes_m.iter().map(|[length_m, width_m]| {
        let [long, wide] = reach_m(&GroundBox {
            centre: [0.0; 2],
            yaw: 0.0,
            length_m: *length_m,
            width_m: *width_m,
        });
        0.5 * long.hypot(wide)
    });
    reach.fold(0.0, f64::max)
}

/// What is to be learnt from one example, or from the floor.
struct TrainingExample {
    /// The example; `None` for random boxes.
    example: Option<Example>,
    /// What the image shows in it, as drawn and from its other end; one alone for random boxes.
    ways: Vec<Vec<f32>>,
    /// What it is worth: +1 for one of the kind.
    answer: f64,
    /// The same of what lies beside it.
    beside: Vec<(Vec<Vec<f32>>, f64)>,
    /// What the template is made of; `None` for what does not lie exactly where it is.
    layout: Option<Vec<[f32; 2]>>,
}

impl TrainingExample {
    /// The box from its other end.
    fn turn(&mut self) {
        let beside = self.beside.iter_mut().map(|(ways, _)| ways);
        let ways = std::iter::once(&mut self.ways).chain(beside);
        ways.for_each(|ways| ways.reverse());
        self.layout.iter_mut().for_each(|layout| layout.reverse());
    }
}

/// How far beyond a part is looked to learn from examples in it (m): boxes beside one begin a width away from it at most.
fn looked_at_m(examples: &[Example]) -> f64 {
    let sizes = examples.iter().map(|one| &one.place);
    let sizes = sizes.map(|place| [place.length_m, place.width_m]);
    2.0 * reach_of(&sizes.collect::<Vec<[f64; 2]>>())
}

/// Examples by the part that they lie in, each with its place among all.
fn by_part(mosaic: &Mosaic, examples: &[Example]) -> BTreeMap<TileBlock, Vec<(usize, Example)>> {
    let mut parts: BTreeMap<TileBlock, Vec<(usize, Example)>> = BTreeMap::new();
    for (at, example) in examples.iter().enumerate() {
        let part = parts.entry(mosaic.part(example.place.centre)).or_default();
        part.push((at, *example));
    }
    parts
}

/// Whether a tile is of those that examples are learnt from, on an image whose parts are counted.
pub(super) fn is_looked_at(
    mosaic: &Mosaic,
    examples: &[Example],
) -> impl Fn([i64; 2]) -> bool + use<> {
    let reach_m = looked_at_m(examples);
    let parts = by_part(mosaic, examples).into_keys();
    let spans: Vec<[[i64; 2]; 2]> = parts.map(|part| mosaic.span(part, reach_m)).collect();
    move |tile| {
        let is_in = |[first, last]: &[[i64; 2]; 2]| {
            (0..2).all(|axis| (first[axis]..last[axis]).contains(&tile[axis]))
        };
        spans.iter().any(is_in)
    }
}

/// What the image shows in the examples, in their order, and in random boxes near them.
fn described(
    mosaic: &Mosaic,
    examples: &[Example],
    params: &TeachingParams,
) -> Vec<TrainingExample> {
    let ones: Vec<GroundBox> = examples
        .iter()
        .filter(|one| one.is_one())
        .map(|one| one.place)
        .collect();
    let index = BoxIndex::of(&ones);
    let reach_m = looked_at_m(examples);
    let parts = by_part(mosaic, examples);
    let random = params.random_boxes.div_ceil(parts.len().max(1));
    let mut seen: Vec<(usize, TrainingExample)> = Vec::new();
    for (part, examples) in parts {
        let gradients = mosaic.gradients(part, reach_m);
        let found = examples.into_par_iter().filter_map(|(at, example)| {
            Some((at, described_example(&gradients, example, &index)?))
        });
        seen.extend(found.collect::<Vec<_>>());
        let is_here = |place: &GroundBox| mosaic.part(place.centre) == part;
        let floor = random_boxes(&gradients, &index, &ones, random, is_here).into_iter();
        let floor = floor.map(|sample| TrainingExample {
            example: None,
            ways: vec![sample],
            answer: -1.0,
            beside: Vec::new(),
            layout: None,
        });
        seen.extend(floor.map(|seen| (usize::MAX, seen)));
    }
    seen.sort_by_key(|(at, _)| *at);
    seen.into_iter().map(|(_, seen)| seen).collect()
}

fn described_example(
    gradients: &Gradients,
    example: Example,
    ones: &BoxIndex,
) -> Option<TrainingExample> {
    let ways = |place: &GroundBox| -> Option<Vec<Vec<f32>>> {
        let turned = describe(gradients, &place.turned())?;
        Some(vec![describe(gradients, place)?, turned])
    };
    let beside = |place: GroundBox| Some((ways(&place)?, answer(example.place.overlap(&place))));
    Some(TrainingExample {
        example: Some(example),
        ways: ways(&example.place)?,
        answer: if example.is_one() {
            1.0
        } else {
            answer(ones.overlap(&example.place))
        },
        beside: if example.is_one() {
            beside_of(&example.place)
                .into_iter()
                .filter_map(beside)
                .collect()
        } else {
            Vec::new()
        },
        layout: (example.judgement == Judgement::Drawn)
            .then(|| laid_out(gradients, &example.place))
            .flatten(),
    })
}

/// What there is to learn from.
pub(super) struct Lesson {
    pub(super) samples: Vec<Vec<f32>>,
    pub(super) answers: Vec<f64>,
    /// What the boxes that were drawn show in detail.
    pub(super) template: Template,
    /// By example: its samples, how many of them are of the box itself, and whether it is one of the kind.
    examples: Vec<(std::ops::Range<usize>, usize, bool)>,
    /// Boxes of one size together.
    sizes: Vec<Vec<[f64; 2]>>,
}

impl Lesson {
    /// Of examples where an image shows them.
    pub(super) fn new(mosaic: &Mosaic, examples: &[Example], params: &TeachingParams) -> Self {
        let mut seen = described(mosaic, examples, params);
        turn_alike(&mut seen);
        let layouts = seen.iter_mut().filter_map(|one| one.layout.take());
        let layouts: Vec<Vec<[f32; 2]>> = layouts.collect();
        let mut lesson = Self {
            template: Template::learn(&layouts),
            samples: Vec::new(),
            answers: Vec::new(),
            examples: Vec::new(),
            sizes: Vec::new(),
        };
        for one in seen {
            let begin = lesson.samples.len();
            match one.example {
                Some(example) if example.is_one() => {
                    let GroundBox {
                        length_m, width_m, ..
                    } = example.place;
                    lesson.add_first(one.ways, 1, 1.0);
                    for (ways, answer) in one.beside {
                        let count = if answer == -1.0 { ways.len() } else { 1 };
                        lesson.add_first(ways, count, answer);
                    }
                    add_size(&mut lesson.sizes, [length_m, width_m]);
                    lesson.examples.push((begin..lesson.samples.len(), 1, true));
                }
                example => {
                    let count = one.ways.len();
                    lesson.add_first(one.ways, count, one.answer);
                    if example.is_some() {
                        lesson.examples.push((begin..begin + count, count, false));
                    }
                }
            }
        }
        let mut empty = vec![0.0; LENGTH];
        empty[LENGTH - 1] = 1.0;
        lesson.add_first(vec![empty], 1, -1.0);
        lesson
    }

    /// Lengths and widths of boxes of the kind (m).
    pub(super) fn sizes_m(&self) -> Vec<[f64; 2]> {
        self.sizes.iter().map(|sizes| mean(sizes)).collect()
    }

    /// Examples that an image shows, of the kind or not.
    pub(super) fn count(&self, are_ones: bool) -> u32 {
        let examples = self.examples.iter();
        examples
            .filter(|(_, _, is_one)| *is_one == are_ones)
            .count() as u32
    }

    /// Adds the first ones of some samples.
    fn add_first(&mut self, samples: Vec<Vec<f32>>, count: usize, answer: f64) {
        self.samples.extend(samples.into_iter().take(count));
        self.answers.resize(self.samples.len(), answer);
    }

    /// By example: what would be held of it, had it not been learnt from, the better way round, and whether it is one.
    pub(super) fn left_out(&self, process: &LinearProcess) -> Vec<(f64, bool)> {
        let held = self.examples.par_iter().map(|(range, own, is_one)| {
            let samples = self.samples[range.clone()].iter().map(Vec::as_slice);
            let means =
                process.left_out(&samples.collect::<Vec<_>>(), &self.answers[range.clone()]);
            let best = means[..*own]
                .iter()
                .copied()
                .fold(f64::NEG_INFINITY, f64::max);
            (best, *is_one)
        });
        held.collect()
    }
}

/// Turns boxes of the kind round, of those that look more like all the others from their other end one after the other, until
/// there are none. Each turn makes the sum of their descriptions longer, so there is an end; that numbers are rounded may
/// hide it.
fn turn_alike(seen: &mut [TrainingExample]) {
    let is_one = |one: &&mut TrainingExample| one.example.is_some_and(|example| example.is_one());
    let mut ones: Vec<&mut TrainingExample> = seen.iter_mut().filter(is_one).collect();
    let mut all = vec![0.0_f32; LENGTH];
    ones.iter().for_each(|one| add(&mut all, &one.ways[0], 1.0));
    for _ in 0..MOST_TURNS {
        let mut are_alike = true;
        for one in &mut ones {
            add(&mut all, &one.ways[0], -1.0);
            if like(&one.ways[1], &all) > like(&one.ways[0], &all) {
                one.turn();
                are_alike = false;
            }
            add(&mut all, &one.ways[0], 1.0);
        }
        if are_alike {
            break;
        }
    }
}

fn add(sums: &mut [f32], values: &[f32], times: f32) {
    let pairs = sums.iter_mut().zip(values);
    pairs.for_each(|(sum, value)| *sum += times * value);
}

fn like(one: &[f32], other: &[f32]) -> f32 {
    one.iter().zip(other).map(|(a, b)| a * b).sum()
}

fn add_size(sizes: &mut Vec<Vec<[f64; 2]>>, size: [f64; 2]) {
    let like = |known: &&mut Vec<[f64; 2]>| {
        let mean = mean(known);
        (0..2).all(|side| (size[side] / mean[side]).ln().abs() < ONE_SIZE)
    };
    match sizes.iter_mut().find(like) {
        Some(known) => known.push(size),
        None => sizes.push(vec![size]),
    }
}

fn mean(sizes: &[[f64; 2]]) -> [f64; 2] {
    [0, 1].map(|side| sizes.iter().map(|size| size[side]).sum::<f64>() / sizes.len() as f64)
}

/// What a box is worth that overlaps one of the kind by so much: all where it is the same, nothing where it lies half a
/// width aside (an overlap of a third).
fn answer(overlap: f64) -> f64 {
    (3.0 * overlap - 2.0).max(-1.0)
}

/// Boxes beside one: a tenth, a quarter and half of its width to the sides, a quarter, half and a whole width ahead and
/// behind, turned by 5, 10, 45 and 90 degrees.
fn beside_of(place: &GroundBox) -> Vec<GroundBox> {
    let aside = [0.1, 0.25, 0.5].map(|part| [0.0, part * place.width_m]);
    let ahead = [0.25, 0.5, 1.0].map(|part| [part * place.width_m, 0.0]);
    let moved = aside.into_iter().chain(ahead);
    let moved = moved.flat_map(|[along, left]| [[along, left], [-along, -left]]);
    let moved = moved.map(|by| GroundBox {
        centre: place.point(by),
        ..*place
    });
    let turned = [5.0_f64, -5.0, 10.0, -10.0, 45.0, -45.0, 90.0];
    let turned = turned.into_iter().map(|by| GroundBox {
        yaw: place.yaw + by.to_radians(),
        ..*place
    });
    moved.chain(turned).collect()
}

/// Descriptions of boxes anywhere in the part of the image that is asked for, clear of those of the kind; the same for the
/// same image. Images of parts overlap: a box that counted in each would make the answers look more exact than they are.
fn random_boxes(
    gradients: &Gradients,
    index: &BoxIndex,
    ones: &[GroundBox],
    count: usize,
    is_here: impl Fn(&GroundBox) -> bool,
) -> Vec<Vec<f32>> {
    if ones.is_empty() {
        return Vec::new();
    }
    let mut random = SplitMix64(1);
    let mut tried = (0..20 * count).map(|at| GroundBox {
        centre: gradients.within([random.unit(), random.unit()]),
        yaw: std::f64::consts::TAU * random.unit(),
        ..ones[at % ones.len()]
    });
    let mut found = Vec::new();
    while found.len() < count
        && let Some(place) = tried.next()
    {
        if is_here(&place)
            && index.overlap(&place) < CLEAR
            && let Some(described) = describe(gradients, &place)
        {
            found.push(described);
        }
    }
    found
}
