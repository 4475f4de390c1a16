//! Rays of a camera, tile by tile, and which part of the surroundings a tile can see.

use super::cast::Eye;
use evermap_algorithms::geometry::camera::Camera;
use evermap_algorithms::geometry::pose::Pose;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use std::f32::consts::{FRAC_PI_2, PI};

/// Pixels along the side of a tile.
pub const TILE: usize = 16;
/// Pixels of a tile.
pub const PIXELS: usize = TILE * TILE;

/// One number for each pixel of a tile.
pub type Lanes = [f32; PIXELS];

/// Rays and vignetting of one camera.
pub struct Lens {
    /// Image width, pixels.
    pub width: usize,
    /// Image height, pixels.
    pub height: usize,
    /// Tiles in a row.
    pub columns: usize,
    /// Where the camera sits.
    pub vehicle_from_camera: Pose,
    /// Tiles, row by row.
    pub tiles: Vec<LensTile>,
    /// Solid angle of a pixel, steradian.
    pub omega: f32,
}

/// One tile of an image.
pub struct LensTile {
    /// Unit rays in the vehicle's frame.
    pub rays: Box<[Lanes; 3]>,
    /// Angle from the lens axis, radians; infinite where the image has no pixel or the pixel no ray.
    pub theta: Box<Lanes>,
    /// Around the rays; `None` when no pixel sees anything.
    pub cone: Option<Cone>,
}

/// A cone of rays.
#[derive(Debug, Clone, Copy)]
pub struct Cone {
    axis: Vector3<f32>,
    half: f32,
}

impl Cone {
    /// The cone around unit rays; `None` for no rays.
    fn around(rays: &[Vector3<f32>]) -> Option<Self> {
        let axis = rays.iter().sum::<Vector3<f32>>().try_normalize(1e-6)?;
        let least = rays.iter().map(|ray| ray.dot(&axis)).fold(1.0, f32::min);
        Some(Self {
            axis,
            half: least.clamp(-1.0, 1.0).acos() + 2e-3,
        })
    }
}

/// A part of the surroundings, as directions from the eye.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Window {
    /// Middle of the azimuth interval, radians.
    pub azimuth: f32,
    /// Half the azimuth interval, radians; π is everywhere.
    pub half_azimuth: f32,
    /// Lowest and highest elevation above the horizon, radians.
    pub elevation: [f32; 2],
}

impl Window {
    /// Contains a cone of the vehicle's frame.
    pub fn of(cone: &Cone, eye: &Eye) -> Self {
        let axis = eye.turned(cone.axis.into());
        let elevation = axis[2].clamp(-1.0, 1.0).asin();
        let half_azimuth = if elevation.abs() + cone.half >= FRAC_PI_2 - 1e-3 {
            PI
        } else {
            (cone.half.sin() / elevation.cos()).min(1.0).asin() + 1e-3
        };
        Self {
            azimuth: axis[1].atan2(axis[0]),
            half_azimuth,
            elevation: [elevation - cone.half, elevation + cone.half],
        }
    }

    /// Whether something that lies in another window may show in this one.
    pub fn meets(&self, other: &Self) -> bool {
        if self.elevation[0] > other.elevation[1] + 2e-3
            || self.elevation[1] < other.elevation[0] - 2e-3
        {
            return false;
        }
        let mut turn = (self.azimuth - other.azimuth).abs();
        while turn > PI {
            turn = (turn - 2.0 * PI).abs();
        }
        turn <= self.half_azimuth + other.half_azimuth + 2e-3
    }
}

impl Lens {
    /// Prepares a camera that sees what is at most `reach_rad` from its axis; `focal` is in pixels per radian in
    /// the middle of the image.
    pub fn new(
        camera: &Camera,
        vehicle_from_camera: &Pose,
        focal: [f64; 2],
        reach_rad: f64,
    ) -> Self {
        let (width, height) = (camera.width as usize, camera.height as usize);
        let (columns, rows) = (width.div_ceil(TILE), height.div_ceil(TILE));
        let tiles = (0..columns * rows).map(|index| {
            let corner = [index % columns * TILE, index / columns * TILE];
            LensTile::new(camera, vehicle_from_camera, reach_rad as f32, corner)
        });
        Self {
            width,
            height,
            columns,
            vehicle_from_camera: *vehicle_from_camera,
            tiles: tiles.collect(),
            omega: (1.0 / (focal[0] * focal[1])) as f32,
        }
    }

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.width * self.height
    }

    /// The ray of a pixel (counted row by row) in the vehicle's frame.
    pub fn ray(&self, pixel: usize) -> [f32; 3] {
        let (column, row) = (pixel % self.width, pixel / self.width);
        let tile = &self.tiles[row / TILE * self.columns + column / TILE];
        let i = row % TILE * TILE + column % TILE;
        tile.rays.each_ref().map(|parts| parts[i])
    }

    /// Writes the values of a tile's pixels into an image.
    pub fn put<T: Copy>(&self, tile: usize, values: &[T; PIXELS], image: &mut [T]) {
        let (left, top) = (tile % self.columns * TILE, tile / self.columns * TILE);
        let columns = TILE.min(self.width - left);
        let rows = values.chunks_exact(TILE).take(self.height - top);
        for (row, values) in rows.enumerate() {
            let start = (top + row) * self.width + left;
            if let Some(target) = image.get_mut(start..start + columns) {
                target.copy_from_slice(&values[..columns]);
            }
        }
    }
}

impl LensTile {
    fn new(
        camera: &Camera,
        vehicle_from_camera: &Pose,
        reach_rad: f32,
        [left, top]: [usize; 2],
    ) -> Self {
        let mut rays = Box::new([[0.0; PIXELS]; 3]);
        let mut theta = Box::new([f32::INFINITY; PIXELS]);
        let (width, height) = (camera.width as usize, camera.height as usize);
        for i in 0..PIXELS {
            let (column, row) = (left + i % TILE, top + i / TILE);
            // Pixels that see nothing get some ray, so that no arithmetic goes astray.
            let mut own = Vector3::new(0.6, 0.48, -0.64);
            let inside = column < width && row < height;
            let ray = inside.then(|| camera.unproject([column as f64, row as f64]));
            if let Some(ray) = ray.flatten() {
                own = vehicle_from_camera.rotate(&ray);
                theta[i] = ray.x.hypot(ray.y).atan2(ray.z) as f32;
            }
            for axis in 0..3 {
                rays[axis][i] = own[axis] as f32;
            }
        }
        let seeing = (0..PIXELS).filter(|i| theta[*i] < reach_rad);
        let seeing: Vec<_> = seeing
            .map(|i| Vector3::from(rays.each_ref().map(|parts| parts[i])))
            .collect();
        Self {
            cone: Cone::around(&seeing),
            rays,
            theta,
        }
    }
}

/// `vehicle_from_camera` of a camera looking along `yaw`, `tilt` below the horizon.
pub fn looking(yaw: f64, tilt: f64) -> UnitQuaternion<f64> {
    let forward = Vector3::new(yaw.cos() * tilt.cos(), yaw.sin() * tilt.cos(), -tilt.sin());
    let right = Vector3::new(yaw.sin(), -yaw.cos(), 0.0);
    let down = forward.cross(&right);
    let matrix = Matrix3::from_columns(&[right, down, forward]);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix))
}
