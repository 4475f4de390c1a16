//! The field of an image, and mean-field inference in it.

#![allow(
    clippy::needless_range_loop,
    reason = "an index over lanes is what becomes one vector instruction"
)]

use super::softmax::{softmax, sum};
use super::tiles::Tiles;
use super::{ColourView, CrfError, Kernels, Marginals, Unary, fits};
use crate::learning::permutohedral::{BLOCK, Buffer, Eight, Lattice, Value};
use crate::processor::vectorised;

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
    /// The order of the lattices' positions.
    pub(super) tiles: Tiles,
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
        let appearance = || appearance(image, kernels, wraps);
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
            tiles: Tiles::of(image),
            appearance,
            smoothness,
        })
    }

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.tiles.pixels()
    }

    /// The distributions after a number of rounds of mean field; after none, those of the pixels by themselves.
    ///
    /// # Errors
    /// [`CrfError::Size`] for costs of another number of pixels.
    pub fn infer(&self, unary: &Unary, iterations: u32) -> Result<Marginals, CrfError> {
        fits(unary.classes * self.pixels(), unary.costs.len())?;
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

    /// With the classes padded to `K` times eight. One more follows from the others: all together are what the filter
    /// makes of ones.
    fn run<const K: usize>(&self, unary: &Unary, iterations: u32) -> Vec<f32> {
        let own = Own {
            classes: unary.classes,
            together: (unary.classes > 8 * K).then(|| self.of_ones()),
        };
        let mut values = self.tiles.gathered(&unary.costs, unary.classes);
        let mut block = Block::<K>::default();
        let mut beliefs = (
            Belief::<K, 6>::of(self.appearance.as_ref()),
            Belief::<K, 3>::of(self.smoothness.as_ref()),
        );
        for round in 0..=iterations {
            vectorised(
                #[inline(always)]
                || {
                    let ends = [round == 0, round == iterations];
                    self.pass(&own, &mut values, &mut beliefs, &mut block, ends);
                },
            );
        }
        self.tiles.lay_out(&mut values, unary.classes);
        values
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
    /// distributions, which are splatted for the next round, or, in the last one, take the place of the costs. In the
    /// first one the lattices hold nothing.
    #[inline(always)]
    fn pass<const K: usize>(
        &self,
        own: &Own,
        values: &mut [f32],
        (appearance, smoothness): &mut (Belief<'_, K, 6>, Belief<'_, K, 3>),
        block: &mut Block<K>,
        [first, last]: [bool; 2],
    ) {
        let padding = padding(own.classes);
        if !first {
            appearance.blur();
            smoothness.blur();
        }
        for index in 0..self.pixels().div_ceil(BLOCK) {
            let begin = index * BLOCK;
            let Block { lanes, spare } = block;
            let lanes = &mut lanes[..BLOCK.min(self.pixels() - begin)];
            lanes.fill(<[Eight; K]>::ZERO);
            if !first {
                appearance.add_to(index, lanes);
                smoothness.add_to(index, lanes);
            }
            let costs = &values[begin * own.classes..];
            match &own.together {
                None => spare.fill(NEVER),
                Some(together) => {
                    let pixels = together[begin..].iter().zip(&*lanes).enumerate();
                    for ((pixel, (together, lanes)), spare) in pixels.zip(&mut *spare) {
                        let told = if first { 0.0 } else { together - sum(lanes) };
                        *spare = told - costs[pixel * own.classes + 8 * K];
                    }
                }
            }
            for (pixel, lanes) in lanes.iter_mut().enumerate() {
                subtract(&costs[pixel * own.classes..], &padding, own.classes, lanes);
            }
            softmax(lanes, spare);
            if last {
                let out = values[begin * own.classes..].chunks_exact_mut(own.classes);
                for ((lanes, spare), out) in lanes.iter().zip(spare).zip(out) {
                    write(lanes, *spare, out);
                }
            } else {
                appearance.take(index, lanes);
                smoothness.take(index, lanes);
            }
        }
        appearance.advance();
        smoothness.advance();
    }
}

/// What pixels say by themselves, but for their costs.
struct Own {
    classes: usize,
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
    kernels: &Kernels,
    wraps: bool,
) -> Result<Kernel<6>, CrfError> {
    let (x, y, cells) = places(image, kernels.appearance_px, wraps);
    let deviation = kernels.appearance_colour as f32;
    let colour = |channel: usize| {
        let mut values = Vec::with_capacity(x.len());
        Tiles::of(image).visit(|pixels| {
            let of_row = &image.pixels()[pixels];
            values.extend(
                of_row
                    .iter()
                    .map(|pixel| f32::from(pixel[channel]) / deviation),
            );
        });
        values
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
    let tiles = Tiles::of(image);
    let pixels = tiles.pixels();
    let (mut x, mut y) = (Vec::with_capacity(pixels), Vec::with_capacity(pixels));
    tiles.visit(|pixels| {
        let (row, column) = (pixels.start / width, pixels.start % width);
        y.resize(y.len() + pixels.len(), of_row[row]);
        x.extend_from_slice(&of_column[column..column + pixels.len()]);
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
    lattice.normalise();
    Ok(Kernel {
        lattice,
        weight: weight as f32,
    })
}
