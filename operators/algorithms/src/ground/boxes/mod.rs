//! Boxes on the ground that look alike: parking spaces, crossings, arrows. A person draws a few, the rest is found.
//!
//! | module | what it knows |
//! |---|---|
//! | [`picture`] | the overhead image by tiles, and which of them are to be described anew |
//! | [`overhead`] | the overhead image as gradients, brighter and darker floors alike |
//! | [`mosaic`] | gradients of any extent, by tiles |
//! | [`description`] | what is in a box: histograms of gradients by cell |
//! | [`box_index`] | which boxes are near one |
//! | [`scan`] | the places of an image where a description fits |
//! | `searched` | where boxes are searched for, and at which headings |
//! | `turned` | the image turned to a heading, and how well a description fits everywhere in it |
//! | `lesson` | what there is to learn from |
//! | [`template`] | where exactly a box lies |
//! | [`teaching`] | examples in, hypotheses with their probability and questions out |
//! | `headings` | how boxes lie to lanes |
//! | [`rows`] | parking spaces in rows, with numbers and lanes |
//! | [`occupancy`] | which spaces were taken during a drive |
//!
//! Source: *Integrating metric and semantic maps for vision-only automated parking*, section V-A2: linear
//! Gaussian-process classifier on histograms of gradients, non-maximum suppression, introspective questions.

pub mod box_index;
pub mod description;
mod headings;
mod lesson;
pub mod mosaic;
pub mod occupancy;
pub mod overhead;
pub mod picture;
pub mod rows;
pub mod scan;
mod searched;
pub mod teaching;
pub mod template;
mod turned;

#[cfg(test)]
mod tests;

/// A box on the ground.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GroundBox {
    /// Middle, in the map (m).
    pub centre: [f64; 2],
    /// Direction of its length from the map's x axis, anticlockwise (rad).
    pub yaw: f64,
    /// Side along `yaw` (m).
    pub length_m: f64,
    /// Side across it (m).
    pub width_m: f64,
}

impl GroundBox {
    /// The same box with its ends exchanged.
    pub fn turned(&self) -> Self {
        Self {
            yaw: self.yaw + std::f64::consts::PI,
            ..*self
        }
    }

    /// From points of the box's frame (x along its length, y to its left; m) to points of the map.
    pub fn to_map(&self) -> impl Fn([f64; 2]) -> [f64; 2] + use<> {
        let (sin, cos) = self.yaw.sin_cos();
        let [x, y] = self.centre;
        move |[along, left]| [x + cos * along - sin * left, y + sin * along + cos * left]
    }

    /// A point of the box's frame, in the map.
    pub fn point(&self, point: [f64; 2]) -> [f64; 2] {
        self.to_map()(point)
    }

    /// A point of the map in the box's frame.
    pub fn inside(&self, point: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = self.yaw.sin_cos();
        let [x, y] = [point[0] - self.centre[0], point[1] - self.centre[1]];
        [cos * x + sin * y, cos * y - sin * x]
    }

    /// Corners, anticlockwise, from the right rear one.
    pub fn corners(&self) -> [[f64; 2]; 4] {
        let (half_length, half_width) = (0.5 * self.length_m, 0.5 * self.width_m);
        let to_map = self.to_map();
        [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
            .map(|[x, y]| to_map([x * half_length, y * half_width]))
    }

    /// Area (m²).
    pub fn area_m2(&self) -> f64 {
        self.length_m * self.width_m
    }

    /// Intersection over union, 0 to 1.
    pub fn overlap(&self, other: &Self) -> f64 {
        let both = self.shared_m2(other);
        both / (self.area_m2() + other.area_m2() - both).max(f64::MIN_POSITIVE)
    }

    /// Part of the smaller one that the other covers, 0 to 1.
    pub fn cover(&self, other: &Self) -> f64 {
        let smaller = self.area_m2().min(other.area_m2());
        self.shared_m2(other) / smaller.max(f64::MIN_POSITIVE)
    }

    /// Area that lies in both (m²).
    fn shared_m2(&self, other: &Self) -> f64 {
        let apart = (self.centre[0] - other.centre[0]).hypot(self.centre[1] - other.centre[1]);
        let reach = |one: &Self| 0.5 * one.length_m.hypot(one.width_m);
        if apart >= reach(self) + reach(other) {
            return 0.0;
        }
        let mut polygon: Vec<[f64; 2]> =
            other.corners().iter().map(|at| self.inside(*at)).collect();
        for (axis, half) in [(0, 0.5 * self.length_m), (1, 0.5 * self.width_m)] {
            for sign in [1.0, -1.0] {
                polygon = clipped(&polygon, |point| half - sign * point[axis]);
            }
        }
        area(&polygon)
    }
}

/// The part of a convex polygon where `inside` is not negative (Sutherland & Hodgman 1974).
fn clipped(polygon: &[[f64; 2]], inside: impl Fn(&[f64; 2]) -> f64) -> Vec<[f64; 2]> {
    let mut kept = Vec::with_capacity(polygon.len() + 1);
    for (at, to) in polygon.iter().enumerate() {
        let from = &polygon[(at + polygon.len() - 1) % polygon.len()];
        let (a, b) = (inside(from), inside(to));
        if (a < 0.0) != (b < 0.0) {
            let share = a / (a - b);
            kept.push([0, 1].map(|axis| from[axis] + share * (to[axis] - from[axis])));
        }
        if b >= 0.0 {
            kept.push(*to);
        }
    }
    kept
}

/// The area that a polygon encloses: in m² where its corners are in metres.
pub fn area(polygon: &[[f64; 2]]) -> f64 {
    let next = polygon.iter().cycle().skip(1);
    let twice = polygon
        .iter()
        .zip(next)
        .map(|(a, b)| a[0] * b[1] - a[1] * b[0]);
    0.5 * twice.sum::<f64>().abs()
}
