//! From metres in the map to pixels of the picture.

/// `[west, south, east, north]`, m.
pub type Bounds = [f64; 4];

/// The smallest bounds around both.
pub fn union(a: Option<Bounds>, b: Option<Bounds>) -> Option<Bounds> {
    match (a, b) {
        (Some(a), Some(b)) => Some([
            a[0].min(b[0]),
            a[1].min(b[1]),
            a[2].max(b[2]),
            a[3].max(b[3]),
        ]),
        (a, b) => a.or(b),
    }
}

/// The bounds of points, those that are not finite left out.
pub fn bounds_of(points: impl IntoIterator<Item = [f64; 2]>) -> Option<Bounds> {
    let finite = points
        .into_iter()
        .filter(|[x, y]| x.is_finite() && y.is_finite());
    finite.fold(None, |bounds, [x, y]| union(bounds, Some([x, y, x, y])))
}

/// What of the map is shown, and how large.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Viewport {
    /// Western edge, m.
    pub west: f64,
    /// Northern edge, m.
    pub north: f64,
    /// Pixels per metre.
    pub scale: f64,
    /// Width of the picture, pixels.
    pub width_px: f64,
    /// Height of the picture, pixels.
    pub height_px: f64,
}

impl Viewport {
    /// A viewport on these bounds with a margin around them, neither flatter than 1:3 nor taller than 3:2.
    pub fn of(bounds: Bounds, width_px: u32) -> Self {
        let [west, south, east, north] = bounds;
        let margin = (0.04 * (east - west).max(north - south)).max(2.0);
        let width_px = f64::from(width_px);
        let (wide_m, high_m) = (east - west + 2.0 * margin, north - south + 2.0 * margin);
        let height_m = high_m.max(wide_m / 3.0);
        let width_m = wide_m.max(height_m / 1.5);
        let scale = width_px / width_m;
        Self {
            west: (west + east - width_m) / 2.0,
            north: (south + north + height_m) / 2.0,
            scale,
            width_px,
            height_px: (height_m * scale).ceil(),
        }
    }

    /// The pixel of a place.
    pub fn at(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [(x - self.west) * self.scale, (self.north - y) * self.scale]
    }

    /// The pixels of a line, those that are not finite left out.
    pub fn line(&self, points: impl IntoIterator<Item = [f64; 2]>) -> Vec<[f64; 2]> {
        let finite = points
            .into_iter()
            .filter(|[x, y]| x.is_finite() && y.is_finite());
        finite.map(|point| self.at(point)).collect()
    }

    /// Path data of grid lines at round metres, some ten across the picture.
    pub fn grid(&self) -> String {
        let step = round_length(self.width_px / self.scale / 8.0);
        let east = self.west + self.width_px / self.scale;
        let south = self.north - self.height_px / self.scale;
        let columns = multiples(self.west, east, step).map(|x| {
            let [x, _] = self.at([x, 0.0]);
            format!("M{x:.1} 0V{:.1}", self.height_px)
        });
        let rows = multiples(south, self.north, step).map(|y| {
            let [_, y] = self.at([0.0, y]);
            format!("M0 {y:.1}H{:.1}", self.width_px)
        });
        columns.chain(rows).collect()
    }
}

fn multiples(from: f64, to: f64, step: f64) -> impl Iterator<Item = f64> {
    let (first, last) = ((from / step).ceil() as i64, (to / step).floor() as i64);
    (first..=last).take(100).map(move |k| k as f64 * step)
}

/// A length of 1, 2 or 5 times a power of ten, at most `most`.
pub fn round_length(most: f64) -> f64 {
    let power = 10_f64.powf(most.log10().floor());
    let steps = [5.0, 2.0, 1.0].map(|step| step * power);
    steps
        .into_iter()
        .find(|step| *step <= most * 1.000_001)
        .unwrap_or(power)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_of_the_bounds_is_the_middle_of_the_picture() {
        for bounds in [
            [0.0, 0.0, 40.0, 25.0],
            [0.0, 0.0, 0.0, 0.0],
            [-5.0, 0.0, 5.0, 900.0],
            [0.0, 3.0, 900.0, 4.0],
        ] {
            let view = Viewport::of(bounds, 1000);
            let [x, y] = view.at([(bounds[0] + bounds[2]) / 2.0, (bounds[1] + bounds[3]) / 2.0]);
            assert!(
                (x - 500.0).abs() < 1e-6 && (y - view.height_px / 2.0).abs() <= 0.5,
                "{bounds:?}: {x} {y}"
            );
            for corner in [[bounds[0], bounds[1]], [bounds[2], bounds[3]]] {
                let [x, y] = view.at(corner);
                assert!(
                    x > 0.0 && x < 1000.0 && y > 0.0 && y < view.height_px,
                    "{bounds:?}"
                );
            }
            assert!(
                view.height_px <= 1501.0 && view.height_px >= 333.0,
                "{bounds:?}: {}",
                view.height_px
            );
        }
    }

    #[test]
    fn lengths_are_round() {
        assert_eq!(
            [0.7, 1.0, 9.9, 25.0, 49.0, 5000.0].map(round_length),
            [0.5, 1.0, 5.0, 20.0, 20.0, 5000.0]
        );
    }

    #[test]
    fn points_that_are_nowhere_are_left_out() {
        assert_eq!(bounds_of([[f64::NAN, 0.0], [f64::INFINITY, 1.0]]), None);
        assert_eq!(
            bounds_of([[1.0, 2.0], [f64::NAN, 0.0], [-1.0, 5.0]]),
            Some([-1.0, 2.0, 1.0, 5.0])
        );
    }
}
