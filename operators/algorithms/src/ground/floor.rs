//! A floor that bends, as the vehicles that stood on it felt it.
//!
//! Each pose says where its four wheels stood, a height and a slope: a *footing*. The height of the floor at a place is
//! the mean of what the footings around it say, each continued along its slope to the place and weighted by how well it
//! can know:
//!
//! ```text
//! σ²(d) = σ_z² + (σ_θ d)² + (κ d² / 2)²
//! ```
//!
//! with d the distance. σ_z is the height of a pose; σ_θ its attitude, which suspension sways; κ how much a floor bends,
//! so that a slope is worth less the farther it is continued. This is Shepard's interpolation of planes (Franke and Nielson
//! 1980) with weights that are variances.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Vector3;
use rayon::prelude::*;
use rstar::RTree;
use rstar::primitives::GeomWithData;

use crate::geometry::pose::Pose;
use crate::ground::cells::{Cell, cell_of, middle};

/// Distance between two heights, metres: a floor bends over metres, and between two heights it is taken to be straight.
const STEP_M: f64 = 0.5;

/// What a pose's height is known to, metres: that of the metric map (BENCHMARKS.md, 0.5 cm) and of tyres.
const HEIGHT_SIGMA_M: f64 = 0.01;

/// What a pose's attitude to the floor is known to: a car's body rolls by some degrees per g, and a car park is driven at
/// a tenth of that.
const SLOPE_SIGMA: f64 = 0.005;

/// How much a floor bends (1/m): a ramp of 12 % that levels out over 6 m, half of it at either end.
const BEND: f64 = 0.02;

/// Heights that footings disagree about by more than this are of several storeys, metres: less than half of one.
const STOREY_M: f64 = 1.0;

/// Where a vehicle stood, and how the floor rises there.
#[derive(Debug, Clone, Copy, Default)]
struct Footing {
    /// Position, metres.
    at: Vector3<f64>,
    /// Rise along x and along y.
    slope: [f64; 2],
}

impl Footing {
    /// `None` where the vehicle lies on its side, or nowhere.
    fn of(map_from_vehicle: &Pose, plane_m: f64) -> Option<Self> {
        let normal = map_from_vehicle.rotate(&Vector3::z());
        let at = map_from_vehicle.transform(&(Vector3::z() * plane_m));
        let sound = normal.z > 0.5 && at.iter().all(|metres| metres.abs() < 1e9);
        sound.then(|| Self {
            at,
            slope: [-normal.x / normal.z, -normal.y / normal.z],
        })
    }

    /// The height of its plane at a place, and the weight of that.
    fn height(&self, [x, y]: [f64; 2]) -> (f64, f64) {
        let (east, north) = (x - self.at.x, y - self.at.y);
        let square = east * east + north * north;
        let bent = BEND * square / 2.0;
        let variance = HEIGHT_SIGMA_M.powi(2) + SLOPE_SIGMA.powi(2) * square + bent * bent;
        let height = self.at.z + self.slope[0] * east + self.slope[1] * north;
        (height, 1.0 / variance)
    }
}

/// The mean footing of each cell of [`STEP_M`] and storey: as many as the place is large, however often it was driven.
fn footings(poses: &[Pose], plane_m: f64) -> Vec<Footing> {
    let mut sums: BTreeMap<(Cell, i64), (Footing, f64)> = BTreeMap::new();
    for footing in poses.iter().filter_map(|pose| Footing::of(pose, plane_m)) {
        let Some(cell) = cell_of([footing.at.x, footing.at.y], STEP_M) else {
            continue;
        };
        let storey = (footing.at.z / STOREY_M).floor() as i64;
        let (sum, count) = sums.entry((cell, storey)).or_default();
        sum.at += footing.at;
        sum.slope = [0, 1].map(|k| sum.slope[k] + footing.slope[k]);
        *count += 1.0;
    }
    let mean = |(sum, count): (Footing, f64)| Footing {
        at: sum.at / count,
        slope: sum.slope.map(|slope| slope / count),
    };
    sums.into_values().map(mean).collect()
}

/// Footings say nothing about the floor farther away than this, metres, whatever cameras see: at 64 m, one that bends may
/// be 40 m elsewhere.
const MOST_REACH_M: f64 = 64.0;

/// A floor that bends meets a line of sight within this of where a flat one does, metres.
const SIGHT_M: f64 = 8.0;
/// Steps towards it, and the last one's length, metres.
const MOST_STEPS: usize = 50;
const SAME_M: f64 = 1e-3;

/// Heights along a side of a block.
const BLOCK: i32 = 16;

/// Heights that one image asks for at most: a square of 256 m.
const MOST_HEIGHTS: usize = 1 << 18;

/// The height of the floor around where a vehicle drove.
#[derive(Debug, Clone, Default)]
pub struct Floor {
    /// Of the middles of cells of [`STEP_M`], metres, in blocks of [`BLOCK`] by [`BLOCK`], rows first; NaN where nobody
    /// knows.
    blocks: BTreeMap<Cell, Vec<f32>>,
}

impl Floor {
    /// The floor within `reach_m` of where a vehicle stood, 64 m at most; `plane_m` is its height in the vehicle frame.
    ///
    /// Where footings disagree by more than a metre, there are several storeys, and no height.
    pub fn under(map_from_vehicle: &[Pose], plane_m: f64, reach_m: f64) -> Self {
        let reach_m = reach_m.min(MOST_REACH_M);
        let footings = footings(map_from_vehicle, plane_m);
        let blocks: BTreeSet<Cell> = footings
            .iter()
            .filter_map(|footing| blocks(footing, reach_m))
            .flatten()
            .collect();
        let named = footings.into_iter().map(|footing| {
            let [x, y, _] = footing.at.into();
            GeomWithData::new([x, y], footing)
        });
        let index = RTree::bulk_load(named.collect());
        let blocks: Vec<Cell> = blocks.into_iter().collect();
        let filled = blocks.into_par_iter().map(|block| {
            let cells = (0..BLOCK * BLOCK)
                .map(|at| [0, 1].map(|k| block[k] * BLOCK + [at % BLOCK, at / BLOCK][k]));
            let heights = cells.map(|cell| height(&index, middle(cell, STEP_M), reach_m));
            (
                block,
                heights
                    .map(|height| height.unwrap_or(f64::NAN) as f32)
                    .collect(),
            )
        });
        Self {
            blocks: filled.collect(),
        }
    }

    /// The heights of a rectangle, `[west, south, east, north]`; `None` where it is too large.
    pub fn within(&self, [west, south, east, north]: [f64; 4]) -> Option<FloorPart> {
        let low = cell_of([west - STEP_M, south - STEP_M], STEP_M)?;
        let high = cell_of([east + STEP_M, north + STEP_M], STEP_M)?;
        let [columns, rows] = [0, 1].map(|k| high[k].abs_diff(low[k]) as usize + 1);
        if columns.saturating_mul(rows) > MOST_HEIGHTS {
            return None;
        }
        let cells =
            (low[1]..=high[1]).flat_map(|row| (low[0]..=high[0]).map(move |column| [column, row]));
        Some(FloorPart {
            low,
            columns,
            heights: cells.map(|cell| self.of(cell)).collect(),
        })
    }

    /// Where a line of sight from above, through a point, meets the floor, metres; `None` where it does not, or where nobody
    /// knows the floor around the point.
    ///
    /// Each step goes to where the sight has the height that the floor has here: it ends where floors rise less than sight
    /// falls.
    pub fn met_by(&self, eye: &Vector3<f64>, through: &Vector3<f64>) -> Option<Vector3<f64>> {
        let [x, y] = [through.x, through.y];
        let part = self.within([x - SIGHT_M, y - SIGHT_M, x + SIGHT_M, y + SIGHT_M])?;
        let sight = through - eye;
        let mut met = *through;
        for _ in 0..MOST_STEPS {
            let height = part.height([met.x, met.y])?;
            let next = eye + sight * ((height - eye.z) / sight.z);
            let falls = sight.z < 0.0 && height < eye.z;
            if !falls || !next.iter().all(|metres| metres.is_finite()) {
                return None;
            }
            let moved = (next - met).norm();
            met = next;
            if moved < SAME_M {
                return Some(met);
            }
        }
        None
    }

    fn of(&self, cell: Cell) -> f32 {
        let block = cell.map(|number| number.div_euclid(BLOCK));
        let [column, row] = cell.map(|number| number.rem_euclid(BLOCK) as usize);
        let heights = self.blocks.get(&block);
        heights.map_or(f32::NAN, |heights| heights[row * BLOCK as usize + column])
    }
}

/// The blocks that a footing has something to say about; `None` where it is too far from everything.
fn blocks(footing: &Footing, reach_m: f64) -> Option<impl Iterator<Item = Cell> + use<>> {
    let side_m = STEP_M * f64::from(BLOCK);
    let [low, high] =
        [-reach_m, reach_m].map(|away| cell_of([footing.at.x + away, footing.at.y + away], side_m));
    let (low, high) = (low?, high?);
    Some(
        (low[0]..=high[0]).flat_map(move |column| (low[1]..=high[1]).map(move |row| [column, row])),
    )
}

/// The height at a place; `None` where no footing is within reach, or where there are several storeys.
fn height(
    index: &RTree<GeomWithData<[f64; 2], Footing>>,
    place: [f64; 2],
    reach_m: f64,
) -> Option<f64> {
    let (mut sum, mut squares, mut weights) = (0.0, 0.0, 0.0);
    let mut origin = None;
    for near in index.locate_within_distance(place, reach_m * reach_m) {
        let (height, weight) = near.data.height(place);
        // Squares of differences, not of heights above the sea.
        let height = height - *origin.get_or_insert(height);
        sum += weight * height;
        squares += weight * height * height;
        weights += weight;
    }
    let mean = sum / weights;
    let spread = squares / weights - mean * mean;
    origin
        .filter(|_| spread <= STOREY_M * STOREY_M)
        .map(|origin| origin + mean)
}

/// The floor around one image.
#[derive(Debug, Clone)]
pub struct FloorPart {
    low: Cell,
    columns: usize,
    heights: Vec<f32>,
}

impl FloorPart {
    /// Height at a place, metres; between heights by bilinear interpolation. `None` where nobody knows.
    pub fn height(&self, place: [f64; 2]) -> Option<f64> {
        let [east, north] = [0, 1].map(|k| place[k] / STEP_M - 0.5 - f64::from(self.low[k]));
        if !(east >= 0.0 && north >= 0.0) {
            return None;
        }
        let (column, row) = (east as usize, north as usize);
        if column + 1 >= self.columns {
            return None;
        }
        let at = row * self.columns + column;
        let [sw, se] = *self.heights.get(at..at + 2)? else {
            return None;
        };
        let at = at + self.columns;
        let [nw, ne] = *self.heights.get(at..at + 2)? else {
            return None;
        };
        let (east, north) = (east.fract(), north.fract());
        let along = |west: f32, to: f32| f64::from(west) + f64::from(to - west) * east;
        let (south, far) = (along(sw, se), along(nw, ne));
        let height = south + (far - south) * north;
        (!height.is_nan()).then_some(height)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use nalgebra::UnitQuaternion;
    use proptest::prelude::*;

    use super::*;

    /// A vehicle on the plane z = 0.1 x.
    fn on_a_slope(x: f64, y: f64, yaw: f64) -> Pose {
        let slope = UnitQuaternion::from_euler_angles(0.0, -(0.1_f64.atan()), 0.0);
        let turned = slope * UnitQuaternion::from_euler_angles(0.0, 0.0, yaw);
        Pose::new(Vector3::new(x, y, 0.1 * x), turned)
    }

    proptest! {
        #[test]
        fn a_plane_stays_a_plane(
            x in -900.0..900.0_f64, y in -900.0..900.0_f64, yaw in -3.0..3.0_f64,
            east in -5.0..5.0_f64, north in -5.0..5.0_f64,
        ) {
            let poses: Vec<_> = (0..20).map(|at| on_a_slope(x + 0.3 * f64::from(at), y, yaw)).collect();
            let floor = Floor::under(&poses, 0.0, 8.0);
            let place = [x + east, y + north];
            let part = floor.within([place[0], place[1], place[0], place[1]]);
            let height = part.and_then(|part| part.height(place));
            prop_assert!(height.is_some_and(|height| (height - 0.1 * place[0]).abs() < 1e-4), "{height:?}");
        }
    }

    fn floor(poses: &[Pose]) -> FloorPart {
        let floor = Floor::under(poses, 0.0, 12.0);
        floor
            .within([-20.0, -20.0, 20.0, 20.0])
            .unwrap_or_else(|| unreachable!())
    }

    #[test]
    fn a_hinge_stays_sharp() {
        // A drain along y: the floor rises by 3 % to both sides, and both sides were driven along.
        let side = |x: f64| {
            let roll = UnitQuaternion::from_euler_angles(0.0, -(0.03 * x.signum()).atan(), 0.0);
            (-40..40)
                .map(move |y| Pose::new(Vector3::new(x, 0.2 * f64::from(y), 0.03 * x.abs()), roll))
        };
        let poses: Vec<_> = [-3.0, 3.0].into_iter().flat_map(side).collect();
        let floor = floor(&poses);
        for x in [-6.0, -3.0, -1.5, 1.5, 3.0, 6.0_f64] {
            let off = floor.height([x, 0.0]).map(|height| height - 0.03 * x.abs());
            assert!(off.is_some_and(|off| off.abs() < 0.012), "{x}: {off:?}");
        }
    }

    #[test]
    fn sway_is_averaged() {
        let sway = |at: i32| {
            UnitQuaternion::from_euler_angles(0.01 * f64::from(at.rem_euclid(3) - 1), 0.0, 0.0)
        };
        let pose = |at: i32| Pose::new(Vector3::new(0.2 * f64::from(at), 0.0, 0.0), sway(at));
        let poses: Vec<_> = (-30..30).map(pose).collect();
        let height = floor(&poses).height([0.0, 4.0]);
        assert!(
            height.is_some_and(|height| height.abs() < 0.006),
            "{height:?}"
        );
    }

    #[test]
    fn storeys_and_what_was_never_driven_have_no_height() {
        let level = |z: f64| Pose::new(Vector3::new(0.0, 0.0, z), UnitQuaternion::identity());
        let both = floor(&[level(0.0), level(3.0)]);
        assert_eq!(both.height([0.0, 0.0]), None);
        let one = floor(&[level(3.0)]);
        assert_eq!(one.height([5.0, 5.0]), Some(3.0));
        assert_eq!(one.height([15.0, 0.0]), None);
        assert_eq!(floor(&[]).height([0.0, 0.0]), None);
    }

    #[test]
    fn sight_meets_a_slope_where_it_is() {
        let poses: Vec<_> = (0..40)
            .map(|at| on_a_slope(0.3 * f64::from(at), 0.0, 0.0))
            .collect();
        let floor = Floor::under(&poses, 0.0, 16.0);
        // 1.4 m above the floor at x = 5 m, and looking ahead: flat, it would end 8 m on.
        let (eye, flat) = (Vector3::new(5.0, 0.5, 1.9), Vector3::new(13.0, 0.5, 0.5));
        let met = floor.met_by(&eye, &flat).unwrap();
        // 1.9 - 0.175 d = 0.5 + 0.1 d.
        let ahead = 1.4 / 0.275;
        assert!(
            (met.x - 5.0 - ahead).abs() < 0.01 && (met.z - 0.5 - 0.1 * ahead).abs() < 0.01,
            "{met:?}"
        );
        let up = Vector3::new(13.0, 0.5, 2.5);
        assert_eq!(floor.met_by(&eye, &up), None);
        let elsewhere = Vector3::new(500.0, 0.5, 0.5);
        assert_eq!(floor.met_by(&eye, &elsewhere), None);
        let nowhere = Vector3::repeat(f64::NAN);
        assert_eq!(floor.met_by(&eye, &nowhere), None);
    }
}
