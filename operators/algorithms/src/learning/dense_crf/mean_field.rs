//! The field of an image, and mean-field inference in it.

#![allow(
    clippy::needless_range_loop,
    reason = "an index over lanes is what becomes one vector instruction"
)]

use std::ops::Range;

use super::softmax::{softmax, sum};
use super::{ColourView, CrfError, Kernels, Marginals, Unary};
use crate::learning::permutohedral::{BLOCK, Buffer, Eight, Lattice, Value};
use crate::processor::vectorised;

/// Side of the tiles in which pixels are worked on: a block of the lattices, whose distributions stay in the first
/// cache.
const TILE_PX: usize = 16;

/// What classes that do not exist weigh.
const NEVER: f32 = -1e30;

/// A kernel's lattice, weighted so that the filter is normalised.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Kernel<const V: usize> {
    pub(super) lattice: Lattice<V>,
    pub(super) weight: f32,
}

/// How the pixels of an image are joined. Everything that depends on the image alone is computed once.
#[derive(Debug, Clone, PartialEq)]
pub struct RandomField {
    /// The pixels in the order of the lattices' positions: tile by tile.
    pub(super) order: Vec<u32>,
    /// By place and colour.
    pub(super) appearance: Option<Kernel<6>>,
    /// By place.
    pub(super) smoothness: Option<Kernel<3>>,
}

impl RandomField {
    /// The field of an image. With `wraps`, its last column is next to its first one, as in a full panorama: the deviation
    /// along the rows is then rounded, so that the panorama is a whole number of lattice cells wide, 84 for 80 px at a width
    /// of 1024.
    ///
    /// # Errors
    /// [`CrfError`] for kernels that cannot be used, or that are too small for so large an image.
    pub fn new(image: &ColourView<'_>, kernels: &Kernels, wraps: bool) -> Result<Self, CrfError> {
        kernels.check()?;
        let (width, height) = (image.width(), image.height());
        let mut order = Vec::with_capacity(width * height);
        tiled(width, height, |row, columns| {
            order.extend(columns.map(|column| (row * width + column) as u32));
        });
        let appearance = || appearance(image, &order, kernels, wraps);
        let smoothness = || smoothness(image, kernels, wraps);
        let (appearance, smoothness) = rayon::join(
            || {
                (kernels.appearance_weight > 0.0)
                    .then(appearance)
                    .transpose()
            },
            || {
                (kernels.smoothness_weight > 0.0)
                    .then(smoothness)
                    .transpose()
            },
        );
        let (appearance, smoothness) = (appearance?, smoothness?);
        Ok(Self {
            order,
            appearance,
            smoothness,
        })
    }

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.order.len()
    }

    /// The distributions after a number of rounds of mean field; after none, those of the pixels by themselves.
    ///
    /// # Errors
    /// [`CrfError::Size`] for costs of another number of pixels.
    pub fn infer(&self, unary: &Unary, iterations: u32) -> Result<Marginals, CrfError> {
        self.fits(unary.classes * self.pixels(), unary.costs.len())?;
        let probabilities = match unary.classes {
            0..=9 => self.run::<1>(unary, iterations),
            10..=17 => self.run::<2>(unary, iterations),
            18..=33 => self.run::<4>(unary, iterations),
            34..=65 => self.run::<8>(unary, iterations),
            66..=129 => self.run::<16>(unary, iterations),
            _ => self.run::<32>(unary, iterations),
        };
        Ok(Marginals {
            classes: unary.classes,
            probabilities,
        })
    }

    pub(super) fn fits(&self, expected: usize, found: usize) -> Result<(), CrfError> {
        if expected != found {
            return Err(CrfError::Size { expected, found });
        }
        Ok(())
    }

    /// With the classes padded to `K` times eight. One more follows from the others: all together are what the filter
    /// makes of ones.
    fn run<const K: usize>(&self, unary: &Unary, iterations: u32) -> Vec<f32> {
        let mut probabilities = vec![0.0; unary.costs.len()];
        let own = Own {
            classes: unary.classes,
            costs: self.ordered(unary),
            together: (unary.classes > 8 * K).then(|| self.of_ones()),
        };
        let mut block = Block::<K>::default();
        let mut beliefs = (
            Belief::<K, 6>::of(self.appearance.as_ref()),
            Belief::<K, 3>::of(self.smoothness.as_ref()),
        );
        for round in 0..=iterations {
            let last = (round == iterations).then_some(&mut probabilities[..]);
            vectorised(
                #[inline(always)]
                || self.pass(&own, &mut beliefs, &mut block, round > 0, last),
            );
        }
        probabilities
    }

    /// The pixels' costs in the order of the lattices' positions: they are read in every round.
    fn ordered(&self, unary: &Unary) -> Vec<f32> {
        let mut costs = Vec::with_capacity(unary.costs.len());
        for pixel in &self.order {
            let first = *pixel as usize * unary.classes;
            costs.extend_from_slice(&unary.costs[first..first + unary.classes]);
        }
        costs
    }

    /// What the kernels make of ones, pixel by pixel in the order of the lattices' positions.
    fn of_ones(&self) -> Vec<f32> {
        let mut sums = vec![0.0; self.pixels()];
        let mut add = |weight: f32, filtered: Vec<f32>| {
            for (sum, value) in sums.iter_mut().zip(filtered) {
                *sum += weight * value;
            }
        };
        let ones = vec![1.0; self.pixels()];
        if let Some(kernel) = &self.appearance {
            add(kernel.weight, kernel.lattice.filter(&ones));
        }
        if let Some(kernel) = &self.smoothness {
            add(kernel.weight, kernel.lattice.filter(&ones));
        }
        sums
    }

    /// One round: what the lattices hold is blurred and sliced into every pixel's logarithms, which become
    /// distributions, which are splatted for the next round, or, in the last one, written out.
    #[inline(always)]
    fn pass<const K: usize>(
        &self,
        own: &Own,
        (appearance, smoothness): &mut (Belief<'_, K, 6>, Belief<'_, K, 3>),
        block: &mut Block<K>,
        informed: bool,
        mut last: Option<&mut [f32]>,
    ) {
        let padding = padding(own.classes);
        if informed {
            appearance.blur();
            smoothness.blur();
        }
        for (index, pixels) in self.order.chunks(BLOCK).enumerate() {
            let Block { lanes, spare } = block;
            let lanes = &mut lanes[..pixels.len()];
            lanes.fill(<[Eight; K]>::ZERO);
            if informed {
                appearance.add_to(index, lanes);
                smoothness.add_to(index, lanes);
            }
            let costs = &own.costs[index * BLOCK * own.classes..];
            match &own.together {
                None => spare.fill(NEVER),
                Some(together) => {
                    let pixels = together[index * BLOCK..].iter().zip(&*lanes).enumerate();
                    for ((pixel, (together, lanes)), spare) in pixels.zip(&mut *spare) {
                        let told = if informed { together - sum(lanes) } else { 0.0 };
                        *spare = told - costs[pixel * own.classes + 8 * K];
                    }
                }
            }
            for (pixel, lanes) in lanes.iter_mut().enumerate() {
                subtract(&costs[pixel * own.classes..], &padding, own.classes, lanes);
            }
            softmax(lanes, spare);
            match &mut last {
                None => {
                    appearance.take(index, lanes);
                    smoothness.take(index, lanes);
                }
                Some(out) => {
                    for ((lanes, spare), pixel) in lanes.iter().zip(spare).zip(pixels) {
                        let first = *pixel as usize * own.classes;
                        write(lanes, *spare, &mut out[first..first + own.classes]);
                    }
                }
            }
        }
        appearance.advance();
        smoothness.advance();
    }
}

/// What pixels say by themselves, in the order of the lattices' positions.
struct Own {
    classes: usize,
    costs: Vec<f32>,
    /// Where one class follows from the others: what the kernels say of all together.
    together: Option<Vec<f32>>,
}

/// Logarithms and probabilities of the pixels that are worked on.
struct Block<const K: usize> {
    lanes: Vec<[Eight; K]>,
    /// Of the class that has no lane.
    spare: [f32; BLOCK],
}

impl<const K: usize> Default for Block<K> {
    fn default() -> Self {
        Self {
            lanes: vec![Value::ZERO; BLOCK],
            spare: [0.0; BLOCK],
        }
    }
}

/// Visits the pixels of an image tile by tile: a row, and the columns that a tile has there.
fn tiled(width: usize, height: usize, mut visit: impl FnMut(usize, Range<usize>)) {
    for top in (0..height).step_by(TILE_PX) {
        for left in (0..width).step_by(TILE_PX) {
            for row in top..(top + TILE_PX).min(height) {
                visit(row, left..(left + TILE_PX).min(width));
            }
        }
    }
}

/// Beliefs on a kernel's lattice.
struct Belief<'a, const K: usize, const V: usize> {
    on: Option<(&'a Kernel<V>, Buffer<[Eight; K]>)>,
}

impl<'a, const K: usize, const V: usize> Belief<'a, K, V> {
    fn of(kernel: Option<&'a Kernel<V>>) -> Self {
        Self {
            on: kernel.map(|kernel| (kernel, kernel.lattice.buffer())),
        }
    }

    #[inline(always)]
    fn blur(&mut self) {
        if let Some((kernel, buffer)) = &mut self.on {
            let factor = kernel.weight * kernel.lattice.constant();
            kernel.lattice.blur(buffer, factor);
        }
    }

    #[inline(always)]
    fn add_to(&self, block: usize, logarithms: &mut [[Eight; K]]) {
        if let Some((kernel, buffer)) = &self.on {
            kernel.lattice.slice(block, buffer.values(), logarithms);
        }
    }

    #[inline(always)]
    fn take(&mut self, block: usize, probabilities: &[[Eight; K]]) {
        if let Some((kernel, buffer)) = &mut self.on {
            kernel
                .lattice
                .splat(block, probabilities, buffer.next_mut());
        }
    }

    #[inline(always)]
    fn advance(&mut self) {
        if let Some((_, buffer)) = &mut self.on {
            buffer.advance();
        }
    }
}

/// Zero for the lanes of classes, and next to no chance for the others.
#[inline(always)]
fn padding<const K: usize>(classes: usize) -> [Eight; K] {
    let mut lanes = [Eight([NEVER; 8]); K];
    for class in 0..classes.min(8 * K) {
        lanes[class / 8].0[class % 8] = 0.0;
    }
    lanes
}

/// The costs that begin here; whole vectors are loaded, with those of the next pixel, which the padding outweighs.
#[inline(always)]
fn subtract<const K: usize>(
    costs: &[f32],
    padding: &[Eight; K],
    classes: usize,
    lanes: &mut [Eight; K],
) {
    match costs.as_chunks::<8>().0.get(..K) {
        Some(whole) => {
            for i in 0..K {
                // By value, so that the compiler knows that nothing overlaps.
                let (own, costs) = (padding[i], whole[i]);
                for lane in 0..8 {
                    lanes[i].0[lane] += own.0[lane] - costs[lane];
                }
            }
        }
        None => {
            for (class, cost) in costs.iter().take(classes).enumerate() {
                lanes[class / 8].0[class % 8] -= cost;
            }
            for i in 0..K {
                for lane in 0..8 {
                    lanes[i].0[lane] += padding[i].0[lane];
                }
            }
        }
    }
}

#[inline(always)]
fn write<const K: usize>(lanes: &[Eight; K], spare: f32, out: &mut [f32]) {
    let mut out = out.iter_mut();
    for eight in lanes {
        for (out, value) in out.by_ref().take(8).zip(&eight.0) {
            *out = *value;
        }
    }
    if let Some(out) = out.next() {
        *out = spare;
    }
}

fn appearance(
    image: &ColourView<'_>,
    order: &[u32],
    kernels: &Kernels,
    wraps: bool,
) -> Result<Kernel<6>, CrfError> {
    let (x, y, cells) = places(image, kernels.appearance_px, wraps);
    let colour = |channel: usize| -> Vec<f32> {
        let deviation = kernels.appearance_colour as f32;
        let value = |pixel: &u32| f32::from(image.pixels()[*pixel as usize][channel]) / deviation;
        order.iter().map(value).collect()
    };
    let [red, green, blue] = [colour(0), colour(1), colour(2)];
    let coordinates: [&[f32]; 5] = [&x, &y, &red, &green, &blue];
    kernel(&coordinates, cells, kernels.appearance_weight)
}

fn smoothness(
    image: &ColourView<'_>,
    kernels: &Kernels,
    wraps: bool,
) -> Result<Kernel<3>, CrfError> {
    let (x, y, cells) = places(image, kernels.smoothness_px, wraps);
    kernel(&[&x, &y], cells, kernels.smoothness_weight)
}

/// Every pixel's column and row in units of a deviation; and, for a panorama, how many lattice cells it is around.
fn places(
    image: &ColourView<'_>,
    deviation_px: f64,
    wraps: bool,
) -> (Vec<f32>, Vec<f32>, Option<u32>) {
    let width = image.width();
    let around = width as f64 / deviation_px / Lattice::<3>::period(1);
    let cells = wraps.then(|| around.round().max(1.0) as u32);
    let along_x = cells.map_or(deviation_px, |cells| {
        width as f64 / Lattice::<3>::period(cells)
    });
    let scaled = |size: usize, deviation: f64| -> Vec<f32> {
        (0..size)
            .map(|index| index as f32 / deviation as f32)
            .collect()
    };
    let (of_column, of_row) = (scaled(width, along_x), scaled(image.height(), deviation_px));
    let (mut x, mut y) = (Vec::new(), Vec::new());
    tiled(width, image.height(), |row, columns| {
        y.resize(y.len() + columns.len(), of_row[row]);
        x.extend_from_slice(&of_column[columns]);
    });
    (x, y, cells)
}

/// Normalised symmetrically: by the square root of what the filter makes of ones, on both sides.
fn kernel<const V: usize>(
    coordinates: &[&[f32]],
    cells: Option<u32>,
    weight: f64,
) -> Result<Kernel<V>, CrfError> {
    let mut lattice = match cells {
        Some(cells) => Lattice::periodic(coordinates, cells)?,
        None => Lattice::new(coordinates)?,
    };
    let sums = lattice.filter(&vec![1.0; lattice.len()]);
    let factors: Vec<f32> = sums.iter().map(|sum| 1.0 / (sum + 1e-20).sqrt()).collect();
    lattice.scale(&factors);
    Ok(Kernel {
        lattice,
        weight: weight as f32,
    })
}
