//! Grey pictures with mip levels, made to be looked up very often.

/// A texture: level 0 and successively halved copies.
///
/// Texel `(c, r)` covers `[c, c+1) × [r, r+1)`; its centre is at `+0.5`.
#[derive(Debug, Clone)]
pub struct Texture {
    levels: Vec<Level>,
}

#[derive(Debug, Clone)]
struct Level {
    width: i32,
    height: i32,
    grey: Vec<u8>,
}

impl Texture {
    /// From rows of grey values, at least 2 × 2 of them.
    pub fn new(width: usize, height: usize, grey: Vec<u8>) -> Self {
        let (width, height) = (width as i32, height as i32);
        let mut levels = vec![Level {
            width,
            height,
            grey,
        }];
        while let Some(next) = levels.last().and_then(Level::halved) {
            levels.push(next);
        }
        Self { levels }
    }

    /// One grey value everywhere.
    pub fn plain(grey: u8) -> Self {
        Self::new(2, 2, vec![grey; 4])
    }

    /// The grey value at `(u, v)`, given in 1/256 texels of level 0, between the two levels around
    /// `level`.
    #[inline(always)]
    pub fn blend(&self, u: i32, v: i32, level: f32) -> f32 {
        if level <= 0.0 {
            return self.sample(u, v, 0);
        }
        let below = level as i32;
        let (fine, coarse) = (self.sample(u, v, below), self.sample(u, v, below + 1));
        fine + (level - below as f32) * (coarse - fine)
    }

    /// The grey value at `(u, v)`, given in 1/256 texels of level 0, looked up in `level` with
    /// bilinear interpolation. Outside, the edge continues.
    #[inline(always)]
    pub fn sample(&self, u: i32, v: i32, level: i32) -> f32 {
        let index = (level.max(0) as usize).min(self.levels.len() - 1);
        let texels = &self.levels[index];
        let (u, v) = ((u >> index) - 128, (v >> index) - 128);
        let (column, row) = (
            (u >> 8).max(0).min(texels.width - 2),
            (v >> 8).max(0).min(texels.height - 2),
        );
        let (fu, fv) = (u & 255, v & 255);
        let start = (row * texels.width + column) as usize;
        let end = start + texels.width as usize;
        let (Some(top), Some(bottom)) = (
            texels.grey.get(start..start + 2),
            texels.grey.get(end..end + 2),
        ) else {
            return 0.0;
        };
        let mix = |pair: &[u8]| i32::from(pair[0]) * (256 - fu) + i32::from(pair[1]) * fu;
        let value = mix(top) * (256 - fv) + mix(bottom) * fv;
        value as f32 * (1.0 / 65536.0)
    }
}

impl Level {
    /// Means of 2 × 2 texels; `None` when that would leave less than 2 × 2.
    fn halved(&self) -> Option<Self> {
        let (w, h) = (self.width as usize / 2, self.height as usize / 2);
        if w < 2 || h < 2 {
            return None;
        }
        let mut grey = Vec::with_capacity(w * h);
        for rows in self.grey.chunks_exact(2 * self.width as usize).take(h) {
            let (top, bottom) = rows.split_at(self.width as usize);
            let pairs = top.chunks_exact(2).zip(bottom.chunks_exact(2)).take(w);
            grey.extend(pairs.map(|(a, b)| {
                let sum = u16::from(a[0]) + u16::from(a[1]) + u16::from(b[0]) + u16::from(b[1]);
                ((sum + 2) / 4) as u8
            }));
        }
        Some(Self {
            width: w as i32,
            height: h as i32,
            grey,
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;

    #[test]
    fn a_ramp_is_interpolated_at_every_level() {
        let (w, h) = (64, 32);
        let grey = (0..w * h).map(|i| (3 * (i % w) + i / w) as u8).collect();
        let ramp = Texture::new(w, h, grey);
        for level in 0..3 {
            for (u, v) in [(20.0, 15.5), (31.25, 9.0), (40.0, 20.75)] {
                let found = ramp.sample((u * 256.0) as i32, (v * 256.0) as i32, level);
                let expected = 3.0 * (u - 0.5) + (v - 0.5);
                assert!((found - expected as f32).abs() < 0.6, "{found} {expected}");
            }
        }
    }

    #[test]
    fn odd_sizes_and_far_outside_are_safe() {
        for (w, h) in [(2, 2), (2, 7), (3, 2), (17, 5)] {
            let texture = Texture::new(w, h, vec![9; w * h]);
            for level in -2..9 {
                for at in [i32::MIN + 200, -1, 0, 5000, i32::MAX] {
                    let _ = texture.sample(at, at, level);
                }
            }
        }
    }
}
