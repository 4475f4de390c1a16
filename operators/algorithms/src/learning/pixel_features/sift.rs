//! SIFT descriptors around every pixel (Lowe 2004; the flat-window form of VLFeat's `vl_dsift`).
//!
//! The gradient is shared out over eight directions, and each direction's energy summed in a tent as wide as a bin. A
//! descriptor then reads its 4 × 4 bins from those sums: 16 places of eight neighbouring values.

use super::smooth::{Edge, tent};

/// Values of one descriptor: 4 × 4 bins of eight directions.
pub(super) const DIMENSIONS: usize = BINS * BINS * DIRECTIONS;
const BINS: usize = 4;
const DIRECTIONS: usize = 8;
/// Lowe's limit, against lights that saturate.
const MOST: f32 = 0.2;
/// VLFeat's smoothing: bins are this many standard deviations wide.
const BIN_SIGMAS: f32 = 3.0;
/// A gradient (grey values per pixel) below which there is only noise: what is added to the norm of a descriptor.
const NOISE: f32 = 1.0;

/// What the descriptors of one scale are read from.
pub(super) struct DenseSift {
    width: usize,
    height: usize,
    edge: Edge,
    bin_px: usize,
    /// Energy of each direction about each pixel, in 1/16 of a grey value per pixel.
    energy: Vec<[u16; DIRECTIONS]>,
}

impl DenseSift {
    /// `luma` in 1/16 of a grey value; `bin_px` at least 1.
    pub(super) fn new(
        luma: &[u32],
        [width, height]: [usize; 2],
        bin_px: usize,
        edge: Edge,
    ) -> Self {
        let (smooth, unit) = smoothed(luma, [width, height], bin_px, edge);
        let mut energy = directions(&smooth, [width, height], unit, edge);
        tent(&mut energy, [width, height], bin_px, edge);
        let weight = (bin_px * bin_px) as u64 * (bin_px * bin_px) as u64;
        let mean = |sum: u32| u64::from(sum).div_ceil(weight).min(u64::from(u16::MAX)) as u16;
        Self {
            width,
            height,
            edge,
            bin_px,
            energy: energy.iter().map(|sums| sums.map(mean)).collect(),
        }
    }

    /// The descriptor of pixel (u, v), quantised so that 512 would be 1.
    pub(super) fn write(&self, u: usize, v: usize, out: &mut [u8]) {
        let mut values = [[0.0_f32; DIRECTIONS]; BINS * BINS];
        for (j, row) in values.chunks_exact_mut(BINS).enumerate() {
            let v = Edge::Repeat.index(self.shifted(v, j), self.height);
            for (i, bin) in row.iter_mut().enumerate() {
                let u = self.edge.index(self.shifted(u, i), self.width);
                let weight = WINDOW[i] * WINDOW[j];
                for (value, energy) in bin.iter_mut().zip(&self.energy[v * self.width + u]) {
                    *value = weight * f32::from(*energy);
                }
            }
        }
        normalise(&mut values);
        for (out, value) in out.iter_mut().zip(values.as_flattened()) {
            *out = (512.0 * value + 0.5) as u8;
        }
    }

    /// The centre of a bin: one half and one and a half bins to either side.
    fn shifted(&self, at: usize, bin: usize) -> isize {
        at as isize + (2 * bin as isize - 3) * self.bin_px as isize / 2
    }
}

/// Lowe's Gaussian window, half the descriptor wide, at the centres of the bins.
const WINDOW: [f32; BINS] = [0.754_84, 0.969_23, 0.969_23, 0.754_84];

/// To length 1, with no value above 0.2, and again to length 1.
fn normalise(values: &mut [[f32; DIRECTIONS]; BINS * BINS]) {
    let floor = (16.0 * NOISE) * (16.0 * NOISE);
    let scale = (squares(values) + floor).sqrt().recip();
    for value in values.as_flattened_mut() {
        *value = (*value * scale).min(MOST);
    }
    let scale = squares(values).max(0.04).sqrt().recip();
    for value in values.as_flattened_mut() {
        *value *= scale;
    }
}

fn squares(values: &[[f32; DIRECTIONS]; BINS * BINS]) -> f32 {
    let mut sums = [0.0_f32; DIRECTIONS];
    for bin in values {
        for (sum, value) in sums.iter_mut().zip(bin) {
            *sum += value * value;
        }
    }
    sums.iter().sum()
}

/// The image smoothed for this bin size, and what a grey value is in it.
fn smoothed(luma: &[u32], size: [usize; 2], bin_px: usize, edge: Edge) -> (Vec<[u32; 1]>, f32) {
    let sigma = bin_px as f32 / BIN_SIGMAS;
    // Two boxes of width w have the variance (w² - 1) / 6; a pixel is a box itself.
    let wanted = (6.0 * (sigma * sigma - 0.25).max(0.0) + 1.0).sqrt();
    let box_px = (((wanted - 1.0) / 2.0).round() as usize * 2 + 1).min(15);
    let mut plane: Vec<[u32; 1]> = luma.iter().map(|value| [*value]).collect();
    tent(&mut plane, size, box_px, edge);
    (plane, 16.0 * (box_px as f32).powi(4))
}

/// The gradient of each pixel, shared between the two nearest of eight directions, in 1/16 of a grey value per pixel.
fn directions(
    plane: &[[u32; 1]],
    [width, height]: [usize; 2],
    unit: f32,
    edge: Edge,
) -> Vec<[u32; DIRECTIONS]> {
    let mut result = Vec::with_capacity(plane.len());
    let scale = 16.0 / (2.0 * unit);
    for v in 0..height {
        let rows = [-1, 1].map(|step| Edge::Repeat.index(v as isize + step, height) * width);
        for u in 0..width {
            let columns = [-1, 1].map(|step| edge.index(u as isize + step, width));
            let at = |index: usize| plane[index][0] as f32;
            let gx = (at(v * width + columns[1]) - at(v * width + columns[0])) * scale;
            let gy = (at(rows[1] + u) - at(rows[0] + u)) * scale;
            result.push(shared_out(gx, gy));
        }
    }
    result
}

fn shared_out(gx: f32, gy: f32) -> [u32; DIRECTIONS] {
    let mut shares = [0; DIRECTIONS];
    let length = gx.hypot(gy);
    let direction = gy.atan2(gx) * (DIRECTIONS as f32 / std::f32::consts::TAU);
    let first = direction.floor();
    let bin = (first as i32).rem_euclid(DIRECTIONS as i32) as usize;
    let second = length * (direction - first);
    shares[bin] = (length - second).round() as u32;
    shares[(bin + 1) % DIRECTIONS] = second.round() as u32;
    shares
}
