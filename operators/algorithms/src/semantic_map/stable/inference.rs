//! What nobody saw, inferred from what is around it.
//!
//! Two ways: by a forest that has learnt from what was seen behind things elsewhere ([`super::surroundings`]), or by the
//! equations of paper 3, which need no more than the occlusion model.
//!
//! Paper 3, equations 5 to 9: each area that touches a moving thing is a Gaussian with the shape of its ellipse, as high
//! as its class is probable behind the thing; at each of the thing's pixels, the largest Gaussian says what is there. It
//! is the largest, not the sum by class, that wins. What the equations leave open: the standard deviations are
//! [`Options::ellipse`] times the ellipse's half axes, which themselves are two standard deviations of the area's pixels.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::classes::Kinds;
use super::occlusion::Model;
use super::surroundings;
use crate::learning::random_forest::Forest;
use crate::semantic_map::semantic_graph::{
    Area, Graph, GraphError, GraphOptions, Labels, VOID, offset,
};

/// How what was not seen is inferred.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct Options {
    /// A neighbour's Gaussian has this many half axes of its ellipse as standard deviations: ½ is the scatter of its
    /// pixels, which does better on views held out than 1, the paper's σ = h.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub ellipse: f64,
    /// Areas that cover less of the image than this share are nobody's neighbour.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub min_area_share: f64,
    /// Pixels whose class is less probable than this get none: right, or silent. Of labels that are each at least this
    /// probable, more than this share is right: with 0.9, 97 to 99 % on the streets that were tried.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub min_probability: f64,
}

/// What tells what is behind moving things.
#[derive(Debug, Clone, Copy)]
pub enum Teller<'a> {
    /// The equations of paper 3, with its occlusion model.
    Ellipses(&'a Model),
    /// A forest over [`surroundings::features`], whose classes are those of the labels. Of an image of a block that some
    /// trees have held out, those alone are asked.
    Forest(&'a Forest, Option<u32>),
}

impl Default for Options {
    fn default() -> Self {
        Self {
            ellipse: 0.5,
            min_area_share: 0.001,
            min_probability: 0.9,
        }
    }
}

/// A stable label image.
#[derive(Debug, Clone, PartialEq)]
pub struct Stable {
    /// Class of each pixel: static, or [`VOID`] where nothing can be inferred.
    pub labels: Vec<u8>,
    /// How probable the label is, in units of 1/255: 255 where it was seen, 0 for [`VOID`].
    pub certainty: Vec<u8>,
    /// Pixels that were inferred, by moving thing, the largest first, and by what is taken to be behind it.
    pub inferred: Vec<Inferred>,
    /// Pixels of which nothing is known: those that are [`VOID`], whether they had no class before or get none.
    pub unknown: u64,
}

/// Pixels that were inferred alike.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Inferred {
    /// What is in front.
    pub dynamic: u8,
    /// What is taken to be behind.
    pub class: u8,
    /// Pixels.
    pub pixels: u64,
    /// Their mean column, from the first one around the seam (px).
    pub u: f32,
    /// Their mean row (px).
    pub v: f32,
    /// Mean of their probabilities.
    pub probability: f64,
}

/// Sums over the pixels of one thing that are inferred alike.
#[derive(Debug, Clone, Copy)]
struct Tally {
    pixels: u64,
    certainty: u64,
    first: f32,
    /// Columns from the first one on.
    right: f64,
    rows: f64,
}

impl Tally {
    fn new(at: &Area) -> Self {
        Self {
            pixels: 0,
            certainty: 0,
            first: at.u,
            right: 0.0,
            rows: 0.0,
        }
    }

    fn add(&mut self, at: &Area, certainty: u8, circle_px: Option<f32>) {
        let [right, _] = offset([self.first, 0.0], [at.u, 0.0], circle_px);
        self.pixels += 1;
        self.certainty += u64::from(certainty);
        self.right += f64::from(right);
        self.rows += f64::from(at.v);
    }

    fn inferred(&self, dynamic: u8, class: u8, circle_px: Option<f32>) -> Inferred {
        let pixels = self.pixels as f64;
        let u = self.first + (self.right / pixels) as f32;
        Inferred {
            dynamic,
            class,
            pixels: self.pixels,
            u: circle_px.map_or(u, |width| (u + 0.5).rem_euclid(width) - 0.5),
            v: (self.rows / pixels) as f32,
            probability: self.certainty as f64 / (255.0 * pixels),
        }
    }
}

/// A neighbour's Gaussian, as far as it is the same for all pixels.
struct Gaussian {
    area: Area,
    amplitude: f64,
    /// `a`, `b`, `c` of equations 6 to 8.
    form: [f64; 3],
}

impl Gaussian {
    fn new(area: &Area, amplitude: f64, ellipse: f64) -> Self {
        let (x, y) = (
            ellipse * f64::from(area.major_px),
            ellipse * f64::from(area.minor_px),
        );
        let (sin, cos) = f64::from(area.orientation_rad).sin_cos();
        let (x, y) = (0.5 / (x * x), 0.5 / (y * y));
        Self {
            area: *area,
            amplitude,
            form: [
                cos * cos * x + sin * sin * y,
                sin * cos * (x - y),
                sin * sin * x + cos * cos * y,
            ],
        }
    }

    /// The logarithm, as far-off tails would all be zero: `ln A - (a dx² + 2b dx dy + c dy²)`.
    fn logarithm(&self, graph: &Graph, at: &Area) -> f64 {
        let [dx, dy] = graph.offset(&self.area, at).map(f64::from);
        let [a, b, c] = self.form;
        self.amplitude.ln() - (a * dx * dx + 2.0 * b * dx * dy + c * dy * dy)
    }
}

/// Infers what is behind the moving things that are left in a label image.
///
/// By ellipses, where no neighbour can be behind a thing (all are dynamic, or of classes that it was never seen to hide), the model's
/// most probable class is taken; where the model knows nothing of it either, nothing is.
///
/// # Errors
/// As [`Graph::from_labels`].
pub fn infer(
    labels: &Labels<'_>,
    wraps: bool,
    kinds: &Kinds,
    teller: Teller<'_>,
    options: &Options,
) -> Result<Stable, GraphError> {
    let graph_options = GraphOptions {
        // No more than `MOST_CLASSES`, see `Kinds::new`.
        classes: kinds.len() as u8,
        wraps,
        min_px: GraphOptions::share_px(options.min_area_share, labels.width, labels.height),
    };
    let (graph, area_of_pixel) = Graph::with_pixels(labels, &graph_options)?;
    let moving: Vec<usize> = (0..labels.values.len())
        .filter(|pixel| kinds.is_dynamic(labels.values[*pixel]))
        .collect();
    let told = match teller {
        Teller::Ellipses(model) => {
            let ellipses = Ellipses::new(&graph, kinds, model, options.ellipse);
            let told = moving.iter().map(|pixel| {
                let area = area_of_pixel[*pixel].map(usize::from);
                ellipses.told(area, labels.values[*pixel], &place(*pixel, labels.width))
            });
            told.collect()
        }
        Teller::Forest(forest, block) => learnt(labels, wraps, kinds, &moving, forest, block),
    };
    let mut stable = Stable {
        labels: labels.values.to_vec(),
        certainty: labels
            .values
            .iter()
            .map(|label| if *label == VOID { 0 } else { 255 })
            .collect(),
        inferred: Vec::new(),
        unknown: 0,
    };
    let circle_px = graph.wraps.then_some(labels.width as f32);
    let mut tallies: BTreeMap<(Option<usize>, u8, u8), Tally> = BTreeMap::new();
    for (pixel, told) in moving.into_iter().zip(told) {
        let label = &mut stable.labels[pixel];
        let sure = told.filter(|(_, probability)| *probability >= options.min_probability);
        let Some((class, probability)) = sure else {
            (*label, stable.certainty[pixel]) = (VOID, 0);
            continue;
        };
        let area = area_of_pixel[pixel].map(usize::from);
        let at = place(pixel, labels.width);
        let certainty = (probability * 255.0).round().clamp(1.0, 255.0) as u8;
        let thing = (area, *label, class);
        let tally = tallies.entry(thing).or_insert_with(|| Tally::new(&at));
        tally.add(&at, certainty, circle_px);
        (*label, stable.certainty[pixel]) = (class, certainty);
    }
    let unknown = stable.labels.iter().filter(|label| **label == VOID);
    stable.unknown = unknown.count() as u64;
    stable.inferred = tallies
        .iter()
        .map(|((_, dynamic, class), tally)| tally.inferred(*dynamic, *class, circle_px))
        .collect();
    Ok(stable)
}

/// By the forest: of each pixel the most probable class, the first of equal ones.
fn learnt(
    labels: &Labels<'_>,
    wraps: bool,
    kinds: &Kinds,
    moving: &[usize],
    forest: &Forest,
    block: Option<u32>,
) -> Vec<Option<(u8, f64)>> {
    let values = surroundings::features(labels, wraps, kinds, moving);
    let mut scores = vec![0.0; AT_ONCE * forest.classes()];
    let mut told = Vec::with_capacity(moving.len());
    for values in values.chunks(AT_ONCE * surroundings::DIMENSIONS) {
        forest.predict(values, block, &mut scores);
        let pixels = values.len() / surroundings::DIMENSIONS;
        let of_pixels = scores.chunks_exact(forest.classes()).take(pixels);
        told.extend(of_pixels.map(|scores| {
            let best = scores.iter().copied().fold(0.0, f32::max);
            let class = scores.iter().position(|score| *score == best)?;
            (best > 0.0).then_some((class as u8, f64::from(best)))
        }));
    }
    told
}

/// Pixels whose scores are held at a time.
const AT_ONCE: usize = 4096;

/// What is around each area that moves, by the equations.
struct Ellipses<'a> {
    graph: &'a Graph,
    kinds: &'a Kinds,
    model: &'a Model,
    /// By area.
    neighbours: Vec<Vec<Gaussian>>,
}

impl<'a> Ellipses<'a> {
    fn new(graph: &'a Graph, kinds: &'a Kinds, model: &'a Model, ellipse: f64) -> Self {
        let mut neighbours: Vec<Vec<Gaussian>> =
            (0..graph.areas.len()).map(|_| Vec::new()).collect();
        for edge in &graph.edges {
            let (a, b) = (usize::from(edge.a), usize::from(edge.b));
            for (thing, beside) in [(a, b), (b, a)] {
                let (dynamic, class) = (graph.areas[thing].class, graph.areas[beside].class);
                let amplitude = model.probability(class, dynamic);
                if kinds.is_dynamic(dynamic) && kinds.is_static(class) && amplitude > 0.0 {
                    let gaussian = Gaussian::new(&graph.areas[beside], amplitude, ellipse);
                    neighbours[thing].push(gaussian);
                }
            }
        }
        Self {
            graph,
            kinds,
            model,
            neighbours,
        }
    }

    /// What is behind a pixel of a moving class.
    fn told(&self, area: Option<usize>, dynamic: u8, at: &Area) -> Option<(u8, f64)> {
        let around = area.map_or(&[][..], |area| &self.neighbours[area]);
        match area.map(|area| self.graph.areas[area].class) {
            // A speck that was given to what is around it.
            Some(class) if self.kinds.is_static(class) => Some((class, 1.0)),
            _ => largest(around, self.graph, at, self.kinds.len())
                .or_else(|| self.model.most_probable(dynamic)),
        }
    }
}

/// A pixel as an area that is only a place.
fn place(pixel: usize, width: u32) -> Area {
    Area {
        u: (pixel % width as usize) as f32,
        v: (pixel / width as usize) as f32,
        ..NOWHERE
    }
}

const NOWHERE: Area = Area {
    class: VOID,
    pixels: 0,
    u: 0.0,
    v: 0.0,
    major_px: 0.0,
    minor_px: 0.0,
    orientation_rad: 0.0,
    eccentricity: 0.0,
};

/// The class of the largest Gaussian, and its share of the largest ones of all classes; the first class of equal ones.
fn largest(around: &[Gaussian], graph: &Graph, at: &Area, classes: usize) -> Option<(u8, f64)> {
    let mut best = vec![f64::NEG_INFINITY; classes];
    for gaussian in around {
        let of_class = &mut best[usize::from(gaussian.area.class)];
        *of_class = of_class.max(gaussian.logarithm(graph, at));
    }
    let most = best.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let class = best.iter().position(|logarithm| *logarithm == most)?;
    if !most.is_finite() {
        return None;
    }
    let all: f64 = best.iter().map(|logarithm| (logarithm - most).exp()).sum();
    Some((class as u8, 1.0 / all))
}
