//! Which cells of the ground an image would show a person in, counted once a look.
//!
//! A person in a cell is found when feet and head are in the image, when neither the vehicle's own body nor something that
//! the map knows stands before the feet, and when they are near enough. An image has one line of sight for each
//! direction: `Horizon` keeps how far the ground is free there.

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use nalgebra::Vector3;
use rstar::RTree;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::presence::look;
use crate::geometry::camera::Camera;
use crate::geometry::pose::Pose;
use crate::ground::cells::{Cell, MOST_CELLS, between, middle};
use crate::ground::floor::{Floor, FloorPart};

/// How the ground and time are cut up, and how far people are found.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct ExposureParams {
    /// Side of a cell (m): a person is half a metre wide, and is placed that well.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub cell_m: f64,
    /// Length of a look (s): at 1.4 m/s whoever walks has left a cell of their own width after 0.7 s, so the next look is
    /// news.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub look_s: f64,
    /// How far from the camera people are found (m).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1000.0))]
    pub range_m: f64,
}

impl Default for ExposureParams {
    fn default() -> Self {
        Self {
            cell_m: 0.5,
            look_s: 0.7,
            range_m: 8.0,
        }
    }
}

/// More ground around a camera than has cells of this size.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error(
    "expected range_m of at most {most:.0} × cell_m, found {range_m} and {cell_m}",
    most = ExposureParams::most_cells_away(), range_m = .found.range_m, cell_m = .found.cell_m
)]
pub struct ExposureParamsError {
    /// The parameters given.
    pub found: ExposureParams,
}

impl ExposureParams {
    /// Whether the ground around a camera has no more than [`MOST_CELLS`].
    ///
    /// # Errors
    /// [`ExposureParamsError`] where it has.
    pub fn check(&self) -> Result<(), ExposureParamsError> {
        match self.range_m <= Self::most_cells_away() * self.cell_m {
            true => Ok(()),
            false => Err(ExposureParamsError { found: *self }),
        }
    }

    /// How many cells the range has at most: half a side of the square around a camera, without its rim.
    fn most_cells_away() -> f64 {
        ((MOST_CELLS as f64).sqrt() - 2.0) / 2.0
    }

    /// Length of a look, ns.
    pub fn look_ns(&self) -> i64 {
        look_ns(self.look_s)
    }
}

/// Seconds as nanoseconds, at least one.
pub fn look_ns(look_s: f64) -> i64 {
    ((look_s * 1e9).round() as i64).max(1)
}

/// Height of a person, m.
const PERSON_M: f64 = 1.7;

/// Points at these heights above the ground hide a person's legs and body; lower ones do not, higher ones are the ceiling.
const HIDING_M: (f64, f64) = (0.4, 1.7);

/// As many points in one direction as it takes to hide what is behind them: one alone may be wrong.
const HIDE: usize = 2;

/// Directions of a horizon: half a person's width at 8 m.
const DIRECTIONS: usize = 200;

/// What stands behind the surface that points are on, m: a person there may still be before it.
const BEHIND_M: f64 = 0.5;

/// Points that may stand before people, from above, each with its height.
#[derive(Debug, Clone, Default)]
pub struct Standing(RTree<[f64; 3]>);

impl Standing {
    /// Of points in the map, m; those that are not finite are left out.
    pub fn new(points: impl IntoIterator<Item = [f64; 3]>) -> Self {
        let finite = |point: &[f64; 3]| point.iter().all(|value| value.is_finite());
        let points = points.into_iter().filter(finite).collect();
        Self(RTree::bulk_load(points))
    }
}

/// How far one sees along the ground in each direction.
struct Horizon([f64; DIRECTIONS]);

impl Horizon {
    fn new(eye: Vector3<f64>, ground: &Ground, standing: &Standing, range_m: f64) -> Self {
        let mut nearest = vec![[f64::INFINITY; HIDE]; DIRECTIONS];
        let within = range_m * range_m + PERSON_M * PERSON_M;
        for point in standing.0.locate_within_distance(eye.into(), within) {
            let [dx, dy] = [point[0] - eye.x, point[1] - eye.y];
            let height = point[2] - ground.height([point[0], point[1]]);
            if (HIDING_M.0..=HIDING_M.1).contains(&height) {
                let mut distance = dx.hypot(dy);
                for known in &mut nearest[direction(dx, dy)] {
                    if distance < *known {
                        std::mem::swap(known, &mut distance);
                    }
                }
            }
        }
        let mut free = [f64::INFINITY; DIRECTIONS];
        for (free, nearest) in free.iter_mut().zip(nearest) {
            *free = nearest[HIDE - 1] + BEHIND_M;
        }
        Self(free)
    }
}

fn direction(dx: f64, dy: f64) -> usize {
    let turn = dy.atan2(dx) / TAU + 0.5;
    (turn * DIRECTIONS as f64) as usize % DIRECTIONS
}

/// The ground around an image, in the map: the floor where somebody drove near, else the plane that the vehicle's wheels
/// stand on.
struct Ground {
    floor: Option<FloorPart>,
    origin: Vector3<f64>,
    normal: Vector3<f64>,
}

impl Ground {
    /// `None` for a vehicle that lies on its side.
    fn below(map_from_vehicle: &Pose, floor: Option<FloorPart>) -> Option<Self> {
        let normal = map_from_vehicle.rotate(&Vector3::z());
        (normal.z > 0.1).then_some(Self {
            floor,
            origin: map_from_vehicle.translation,
            normal,
        })
    }

    fn height(&self, [x, y]: [f64; 2]) -> f64 {
        let of_floor = self.floor.as_ref().and_then(|floor| floor.height([x, y]));
        of_floor.unwrap_or_else(|| {
            let (dx, dy) = (x - self.origin.x, y - self.origin.y);
            self.origin.z - (self.normal.x * dx + self.normal.y * dy) / self.normal.z
        })
    }
}

/// An image of the ground.
pub struct Shot<'a> {
    /// The vehicle.
    pub map_from_vehicle: &'a Pose,
    /// The camera.
    pub camera: &'a Camera,
    /// Where it is mounted.
    pub vehicle_from_camera: &'a Pose,
}

/// What stands where: the floor, and the points that may stand before people.
pub struct Surroundings<'a> {
    /// The ground where somebody drove near.
    pub floor: &'a Floor,
    /// The points.
    pub standing: &'a Standing,
}

/// Looks at cells in one session, while its images come in the order of their stamps.
#[derive(Debug, Default)]
pub struct Looks(BTreeMap<Cell, Looked>);

/// Looks at one cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Looked {
    /// The number of looks.
    pub looks: u32,
    /// Stamp of the first image, ns.
    pub first_stamp: i64,
    last: i64,
}

impl Shot<'_> {
    /// The cells in which it would show a person. `body` says whether a pixel shows the vehicle itself.
    ///
    /// # Errors
    /// In words, where there is no ground or there are no cells around the vehicle.
    pub fn shows(
        &self,
        around: &Surroundings<'_>,
        body: impl Fn([f64; 2]) -> bool,
        params: &ExposureParams,
    ) -> Result<Vec<Cell>, &'static str> {
        let mut shown = Vec::new();
        let camera = self.camera;
        let map_from_camera = self.map_from_vehicle.compose(self.vehicle_from_camera);
        let eye = map_from_camera.translation;
        let range_m = params.range_m;
        let low = [eye.x - range_m, eye.y - range_m];
        let high = [eye.x + range_m, eye.y + range_m];
        let floor = around.floor.within([low[0], low[1], high[0], high[1]]);
        let ground = Ground::below(self.map_from_vehicle, floor);
        let ground = ground.ok_or("image of a vehicle that lies on its side")?;
        let cells = between(low, high, params.cell_m);
        let [columns, rows] = cells.ok_or("image too far from the map's origin to count cells")?;
        let horizon = Horizon::new(eye, &ground, around.standing, range_m);
        let camera_from_map = map_from_camera.inverse();
        let pixel = |x: f64, y: f64, z: f64| {
            let pixel = camera.project(&camera_from_map.transform(&Vector3::new(x, y, z)));
            pixel.filter(|pixel| camera.contains(*pixel))
        };
        for column in columns {
            for row in rows.clone() {
                let [x, y] = middle([column, row], params.cell_m);
                let (dx, dy) = (x - eye.x, y - eye.y);
                let away = dx.hypot(dy);
                if away > range_m || away > horizon.0[direction(dx, dy)] {
                    continue;
                }
                let z = ground.height([x, y]);
                let feet = pixel(x, y, z).filter(|pixel| !body(*pixel));
                if feet.is_some() && pixel(x, y, z + PERSON_M).is_some() {
                    shown.push([column, row]);
                }
            }
        }
        Ok(shown)
    }
}

impl Looks {
    /// An image, by the cells that it [shows](Shot::shows).
    pub fn add(&mut self, stamp: i64, shown: &[Cell], params: &ExposureParams) {
        let look = look(stamp, params.look_ns());
        for cell in shown {
            self.count(*cell, look, stamp);
        }
    }

    fn count(&mut self, cell: Cell, look: i64, stamp: i64) {
        let of_cell = self.0.entry(cell).or_insert(Looked {
            looks: 0,
            first_stamp: stamp,
            last: look,
        });
        if of_cell.looks == 0 || of_cell.last != look {
            of_cell.looks += 1;
            of_cell.last = look;
        }
    }

    /// By cell, in order.
    pub fn into_cells(self) -> BTreeMap<Cell, Looked> {
        self.0
    }
}
