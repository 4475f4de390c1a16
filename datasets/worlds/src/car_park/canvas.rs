//! Painting in metres: noise, lines, discs, stripes and letters on a grey picture.

use super::glyphs::glyph;
use super::texture::Texture;
use crate::plane::Pose2;
use crate::random::{lattice, noise2, smooth};
use rayon::prelude::*;

/// A picture being painted. `x` runs along the columns, `y` along the rows, both in metres.
#[derive(Debug, Clone)]
pub struct Canvas {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Texels per metre.
    pub scale: f64,
    /// Rows of grey values, 0 to 255; row 0 is at `y` = 0.
    pub grey: Vec<u8>,
}

/// Distance between places that light is asked for, metres.
const LIGHT_CELL_M: f64 = 0.25;

/// One octave of noise: wavelength (m) and amplitude (grey values).
pub type Octave = (f64, f64);

impl Canvas {
    /// A picture of `width_m` × `height_m` metres in one grey.
    pub fn new(width_m: f64, height_m: f64, scale: f64, grey: u8) -> Self {
        let width = (width_m * scale).round().max(2.0) as usize;
        let height = (height_m * scale).round().max(2.0) as usize;
        Self {
            width,
            height,
            scale,
            grey: vec![grey; width * height],
        }
    }

    /// Adds value noise: for each octave, random values on a lattice, smoothly interpolated.
    pub fn add_noise(&mut self, seed: u64, octaves: &[Octave]) {
        let (width, scale) = (self.width, self.scale);
        self.grey
            .par_chunks_mut(width)
            .enumerate()
            .for_each(|(row, texels)| {
                let y = (row as f64 + 0.5) / scale;
                let mut sum = vec![0.0_f32; width];
                for (index, octave) in octaves.iter().enumerate() {
                    add_octave(&mut sum, seed.wrapping_add(index as u64), *octave, y, scale);
                }
                for (texel, sum) in texels.iter_mut().zip(sum) {
                    *texel = (f32::from(*texel) + sum).clamp(0.0, 255.0) as u8;
                }
            });
    }

    /// Dims the picture by a light that changes slowly: it is asked for every [`LIGHT_CELL_M`], and linear between.
    pub fn dim(&mut self, light: impl Fn(f64, f64) -> f64 + Sync) {
        let cells = |side: usize| (side as f64 / self.scale / LIGHT_CELL_M) as usize + 2;
        let (columns, rows) = (cells(self.width), cells(self.height));
        let nodes = (0..rows * columns).into_par_iter();
        let node = |i: usize| [i % columns, i / columns].map(|k| k as f64 * LIGHT_CELL_M);
        let grid: Vec<f32> = nodes
            .map(|i| {
                let [x, y] = node(i);
                light(x, y) as f32
            })
            .collect();
        let step = (1.0 / (self.scale * LIGHT_CELL_M)) as f32;
        let mix = |a: f32, b: f32, f: f32| a + (b - a) * f;
        let lines = self.grey.par_chunks_mut(self.width).enumerate();
        lines.for_each(|(row, texels)| {
            let y = (row as f32 + 0.5) * step;
            let (below, above) = grid[y as usize * columns..].split_at(columns);
            let pairs = below.iter().zip(above);
            let edge: Vec<f32> = pairs.map(|(a, b)| mix(*a, *b, y.fract())).collect();
            for (column, texel) in texels.iter_mut().enumerate() {
                let x = (column as f32 + 0.5) * step;
                let light = mix(edge[x as usize], edge[x as usize + 1], x.fract());
                *texel = (f32::from(*texel) * light).clamp(0.0, 255.0) as u8;
            }
        });
    }

    /// Repaints every texel of a region (`[x0, y0, x1, y1]`, metres): `paint(x, y, old)`.
    pub fn repaint(&mut self, region: [f64; 4], mut paint: impl FnMut(f64, f64, f64) -> f64) {
        let texel = |m: f64| (m * self.scale).max(0.0) as usize;
        let [x0, y0, x1, y1] = region;
        let beyond = |m: f64, size: usize| texel(m + 1.0 / self.scale).min(size);
        let (columns, rows) = (beyond(x1, self.width), beyond(y1, self.height));
        for row in texel(y0)..rows {
            let y = (row as f64 + 0.5) / self.scale;
            for column in texel(x0)..columns {
                let x = (column as f64 + 0.5) / self.scale;
                let texel = &mut self.grey[row * self.width + column];
                *texel = paint(x, y, f64::from(*texel)).clamp(0.0, 255.0) as u8;
            }
        }
    }

    /// Paints where a signed distance (m, negative inside) is below zero, with soft edges.
    /// `region` must contain the shape.
    pub fn shape(
        &mut self,
        region: [f64; 4],
        grey: f64,
        alpha: f64,
        distance: impl Fn(f64, f64) -> f64,
    ) {
        let scale = self.scale;
        self.repaint(region, |x, y, old| {
            let cover = (0.5 - distance(x, y) * scale).clamp(0.0, 1.0);
            old + (grey - old) * cover * alpha
        });
    }

    /// A filled rectangle `[x0, y0, x1, y1]`.
    pub fn fill(&mut self, rect: [f64; 4], grey: f64, alpha: f64) {
        let [x0, y0, x1, y1] = rect;
        let region = around(&[[x0, y0], [x1, y1]], 1.0 / self.scale);
        self.shape(region, grey, alpha, |x, y| {
            (x0 - x).max(x - x1).max(y0 - y).max(y - y1)
        });
    }

    /// A straight line with flat ends.
    pub fn line(&mut self, from: [f64; 2], to: [f64; 2], width: f64, grey: f64, alpha: f64) {
        let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
        let length = dx.hypot(dy).max(1e-9);
        let (ux, uy) = (dx / length, dy / length);
        let region = around(&[from, to], 0.5 * width + 1.0 / self.scale);
        self.shape(region, grey, alpha, |x, y| {
            let (px, py) = (x - from[0], y - from[1]);
            let (along, across) = (px * ux + py * uy, px * uy - py * ux);
            (-along).max(along - length).max(across.abs() - 0.5 * width)
        });
    }

    /// A disc.
    pub fn disc(&mut self, centre: [f64; 2], radius: f64, grey: f64, alpha: f64) {
        let region = around(&[centre], radius + 1.0 / self.scale);
        self.shape(region, grey, alpha, |x, y| {
            (x - centre[0]).hypot(y - centre[1]) - radius
        });
    }

    /// A convex polygon, corners anticlockwise.
    pub fn polygon(&mut self, corners: &[[f64; 2]], grey: f64, alpha: f64) {
        let region = around(corners, 0.0);
        let sides: Vec<[f64; 3]> = (0..corners.len())
            .map(|k| {
                let (a, b) = (corners[k], corners[(k + 1) % corners.len()]);
                let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
                let length = dx.hypot(dy).max(1e-9);
                let (nx, ny) = (dy / length, -dx / length);
                [nx, ny, nx * a[0] + ny * a[1]]
            })
            .collect();
        self.shape(region, grey, alpha, |x, y| {
            let outside = sides.iter().map(|[nx, ny, d]| nx * x + ny * y - d);
            outside.fold(f64::MIN, f64::max)
        });
    }

    /// Letters `height` metres tall, the placement at their lower left corner.
    pub fn text(&mut self, text: &str, at: Pose2, height: f64, grey: f64, alpha: f64) {
        let cell = height / 7.0;
        for (index, letter) in text.chars().enumerate() {
            let bits = glyph(letter);
            for (row, line) in bits.iter().enumerate() {
                for column in 0..5 {
                    if line >> (4 - column) & 1 == 0 {
                        continue;
                    }
                    let x = (index as f64 * 6.0 + f64::from(column)) * cell;
                    let y = (6 - row) as f64 * cell;
                    let e = 1.04 * cell;
                    let corners = [[x, y], [x + e, y], [x + e, y + e], [x, y + e]];
                    self.polygon(&corners.map(|corner| at.point(corner)), grey, alpha);
                }
            }
        }
    }

    /// The finished texture.
    pub fn into_texture(self) -> Texture {
        Texture::new(self.width, self.height, self.grey)
    }
}

/// The rectangle around some points, with a margin, metres.
pub fn around(points: &[[f64; 2]], margin: f64) -> [f64; 4] {
    let of = |axis: usize| points.iter().map(move |point| point[axis]);
    let low = [0, 1].map(|axis| of(axis).fold(f64::MAX, f64::min) - margin);
    let high = [0, 1].map(|axis| of(axis).fold(f64::MIN, f64::max) + margin);
    [low[0], low[1], high[0], high[1]]
}

fn add_octave(sum: &mut [f32], seed: u64, (wavelength, amplitude): Octave, y: f64, scale: f64) {
    let step = 1.0 / (wavelength * scale);
    let row = y / wavelength;
    let (iy, fy) = (row.floor(), smooth((row - row.floor()) as f32));
    let nodes = (sum.len() as f64 * step) as usize + 2;
    let values: Vec<f32> = (0..nodes as i64)
        .map(|j| {
            let (a, b) = (lattice(seed, j, iy as i64), lattice(seed, j, iy as i64 + 1));
            2.0 * (a + (b - a) * fy) - 1.0
        })
        .collect();
    let (step, amplitude) = (step as f32, amplitude as f32);
    for (column, sum) in sum.iter_mut().enumerate() {
        let at = (column as f32 + 0.5) * step;
        let j = at as usize;
        let f = smooth(at - j as f32);
        if let Some([a, b]) = values.get(j..j + 2) {
            *sum += amplitude * (a + (b - a) * f);
        }
    }
}

/// Smooth noise at one place, -1 to 1; for wear and blotches that need no whole picture.
pub fn noise_at(seed: u64, x: f64, y: f64, wavelength: f64) -> f64 {
    f64::from(2.0 * noise2(seed, [x / wavelength, y / wavelength]) - 1.0)
}
