//! The field of an image, and mean-field inference in it.

use super::softmax::softmax;
use super::{ColourView, CrfError, Kernels, Marginals, Unary};
use crate::permutohedral::{Buffer, Eight, Lattice, Value};

/// Pixels that are worked on at once: their distributions stay in the first cache.
const BLOCK: usize = 64;

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
    pixels: usize,
    /// By place and colour.
    pub(super) appearance: Option<Kernel<6>>,
    /// By place.
    pub(super) smoothness: Option<Kernel<3>>,
}

impl RandomField {
    /// The field of an image. With `wraps`, its last column is next to its first one.
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
        Ok(Self {
            pixels: image.pixels().len(),
            appearance: appearance?,
            smoothness: smoothness?,
        })
    }

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.pixels
    }

    /// The distributions after a number of rounds of mean field; after none, those of the pixels by themselves.
    ///
    /// # Errors
    /// [`CrfError::Size`] for costs of another number of pixels.
    pub fn infer(&self, unary: &Unary, iterations: u32) -> Result<Marginals, CrfError> {
        self.fits(unary.classes * self.pixels, unary.costs.len())?;
        let probabilities = match unary.classes {
            ..=8 => self.run::<1>(unary, iterations),
            ..=16 => self.run::<2>(unary, iterations),
            ..=32 => self.run::<4>(unary, iterations),
            ..=64 => self.run::<8>(unary, iterations),
            ..=128 => self.run::<16>(unary, iterations),
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

    /// With the classes padded to `K` times eight.
    fn run<const K: usize>(&self, unary: &Unary, iterations: u32) -> Vec<f32> {
        let mut probabilities = vec![0.0; unary.costs.len()];
        let mut beliefs = (
            Belief::<K, 6>::of(self.appearance.as_ref()),
            Belief::<K, 3>::of(self.smoothness.as_ref()),
        );
        for round in 0..=iterations {
            let last = (round == iterations).then_some(&mut probabilities[..]);
            pulp::Arch::new().dispatch(
                #[inline(always)]
                || pass(unary, &mut beliefs, round > 0, last),
            );
        }
        probabilities
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
            kernel
                .lattice
                .blur(buffer, kernel.weight * kernel.lattice.constant());
        }
    }

    #[inline(always)]
    fn add_to(&self, first: usize, block: &mut [[Eight; K]]) {
        if let Some((kernel, buffer)) = &self.on {
            kernel.lattice.slice(first, buffer.values(), block);
        }
    }

    #[inline(always)]
    fn take(&mut self, first: usize, block: &[[Eight; K]]) {
        if let Some((kernel, buffer)) = &mut self.on {
            kernel.lattice.splat(first, block, buffer.next_mut());
        }
    }

    #[inline(always)]
    fn advance(&mut self) {
        if let Some((_, buffer)) = &mut self.on {
            buffer.advance();
        }
    }
}

/// One round: what the lattices hold is blurred and sliced into every pixel's logarithms, which become distributions,
/// which are splatted for the next round, or, in the last one, written out.
#[inline(always)]
fn pass<const K: usize>(
    unary: &Unary,
    (appearance, smoothness): &mut (Belief<'_, K, 6>, Belief<'_, K, 3>),
    informed: bool,
    mut last: Option<&mut [f32]>,
) {
    if informed {
        appearance.blur();
        smoothness.blur();
    }
    let mut block = [<[Eight; K]>::ZERO; BLOCK];
    for (index, costs) in unary.costs.chunks(BLOCK * unary.classes).enumerate() {
        let first = index * BLOCK;
        let block = &mut block[..costs.len() / unary.classes];
        for (lanes, costs) in block.iter_mut().zip(costs.chunks_exact(unary.classes)) {
            *lanes = logarithms(costs);
        }
        if informed {
            appearance.add_to(first, block);
            smoothness.add_to(first, block);
        }
        block.iter_mut().for_each(softmax);
        match &mut last {
            None => {
                appearance.take(first, block);
                smoothness.take(first, block);
            }
            Some(out) => write(block, unary.classes, &mut out[first * unary.classes..]),
        }
    }
    appearance.advance();
    smoothness.advance();
}

#[inline(always)]
fn logarithms<const K: usize>(costs: &[f32]) -> [Eight; K] {
    let mut lanes = [Eight([NEVER; 8]); K];
    for (eight, costs) in lanes.iter_mut().zip(costs.chunks(8)) {
        for (lane, cost) in eight.0.iter_mut().zip(costs) {
            *lane = -cost;
        }
    }
    lanes
}

#[inline(always)]
fn write<const K: usize>(block: &[[Eight; K]], classes: usize, out: &mut [f32]) {
    for (lanes, out) in block.iter().zip(out.chunks_exact_mut(classes)) {
        for (eight, out) in lanes.iter().zip(out.chunks_mut(8)) {
            out.copy_from_slice(&eight.0[..out.len()]);
        }
    }
}

fn appearance(
    image: &ColourView<'_>,
    kernels: &Kernels,
    wraps: bool,
) -> Result<Kernel<6>, CrfError> {
    let (x, y, cells) = places(image, kernels.appearance_px, wraps);
    let colour = |channel: usize| -> Vec<f32> {
        let deviation = kernels.appearance_colour as f32;
        let values = image.pixels().iter();
        values
            .map(|pixel| f32::from(pixel[channel]) / deviation)
            .collect()
    };
    let [red, green, blue] = [colour(0), colour(1), colour(2)];
    kernel(
        &[&x, &y, &red, &green, &blue],
        cells,
        kernels.appearance_weight,
    )
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
    let width = image.width() as f64;
    let cells = wraps.then(|| {
        (width / deviation_px / Lattice::<3>::period(1))
            .round()
            .max(1.0) as u32
    });
    let along_x = cells.map_or(deviation_px, |cells| width / Lattice::<3>::period(cells)) as f32;
    let along_y = deviation_px as f32;
    let (mut x, mut y) = (Vec::new(), Vec::new());
    for row in 0..image.height() {
        x.extend((0..image.width()).map(|column| column as f32 / along_x));
        y.extend((0..image.width()).map(|_| row as f32 / along_y));
    }
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
