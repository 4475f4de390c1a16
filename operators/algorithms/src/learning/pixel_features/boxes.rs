//! Means over boxes from integral images, several channels side by side.

use super::smooth::Edge;

/// Sums of `N` channels over everything above and to the left of each pixel. Sums wrap at 2³²: those of a box are exact
/// all the same as long as they fit.
pub(super) struct Integrals<const N: usize> {
    width: usize,
    height: usize,
    edge: Edge,
    sums: Vec<[u32; N]>,
}

impl<const N: usize> Integrals<N> {
    /// From the channels of each pixel, row by row.
    pub(super) fn new(
        pixels: impl Iterator<Item = [u32; N]>,
        [width, height]: [usize; 2],
        edge: Edge,
    ) -> Self {
        let mut sums = Vec::with_capacity((width + 1) * (height + 1));
        sums.resize(width + 1, [0_u32; N]);
        let mut row = [0_u32; N];
        for (index, pixel) in pixels.take(width * height).enumerate() {
            if index % width == 0 {
                row = [0; N];
                sums.push(row);
            }
            for (row, value) in row.iter_mut().zip(pixel) {
                *row = row.wrapping_add(value);
            }
            let above = sums[sums.len() - width - 1];
            sums.push(std::array::from_fn(|n| above[n].wrapping_add(row[n])));
        }
        Self {
            width,
            height,
            edge,
            sums,
        }
    }

    /// Sums over the square of `2 half + 1` pixels about (u, v), and of how many pixels. What lies outside the image
    /// does not count; of a box that is outside as a whole, the nearest pixels of the image are taken.
    pub(super) fn around(&self, u: isize, v: isize, half: usize) -> ([u32; N], u32) {
        let half = half as isize;
        let v = v.clamp(0, self.height as isize - 1);
        let (top, bottom) = (
            (v - half).max(0) as usize,
            (v + half + 1).min(self.height as isize) as usize,
        );
        let (left, right) = match self.edge {
            Edge::Repeat => {
                let u = u.clamp(0, self.width as isize - 1);
                (u - half, u + half + 1)
            }
            Edge::Wrap => {
                let u = u.rem_euclid(self.width as isize);
                let half = half.min((self.width as isize - 1) / 2);
                (u - half, u + half + 1)
            }
        };
        let width = self.width as isize;
        let [from, to] = [left, right].map(|u| u.clamp(0, width) as usize);
        let mut sums = self.sum([from, to], [top, bottom]);
        let mut columns = to - from;
        if self.edge == Edge::Wrap {
            // At most one of the two is beyond the seam.
            let beyond = [(left + width).min(width), (right - width).max(0)];
            let (from, to) = if left < 0 {
                (beyond[0] as usize, self.width)
            } else {
                (0, beyond[1] as usize)
            };
            let rest = self.sum([from, to], [top, bottom]);
            sums = std::array::from_fn(|n| sums[n].wrapping_add(rest[n]));
            columns += to - from;
        }
        (sums, (columns * (bottom - top)) as u32)
    }

    fn sum(&self, [left, right]: [usize; 2], [top, bottom]: [usize; 2]) -> [u32; N] {
        let at = |u: usize, v: usize| &self.sums[v * (self.width + 1) + u];
        let (a, b, c, d) = (
            at(left, top),
            at(right, top),
            at(left, bottom),
            at(right, bottom),
        );
        std::array::from_fn(|n| {
            d[n].wrapping_sub(b[n])
                .wrapping_sub(c[n])
                .wrapping_add(a[n])
        })
    }
}
