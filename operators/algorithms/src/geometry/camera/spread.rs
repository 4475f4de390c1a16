//! How far apart the rays of an image are.

use nalgebra::Vector3;

use super::{BrownConrady, Camera, KannalaBrandt, Model, Pinhole};

/// How far apart the rays of neighbouring places of an image are where they are farthest, as areas.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Spread {
    /// In parts of what they are on the axis, by the focal lengths.
    pub(super) of_axis: f64,
    /// In parts of what they are without distortion.
    pub(super) of_straight: f64,
}

/// That of so many places along each side of the image; `None` for models whose focal length changes with their
/// polynomial, and where no places beside each other have rays.
pub(super) fn spread(camera: &Camera, places: u32) -> Option<Spread> {
    let (focal, straight) = match &camera.model {
        Model::Pinhole(lens) => {
            let none = BrownConrady {
                radial: [0.0; 6],
                tangential: [0.0; 2],
            };
            let straight = Pinhole::new(lens.focal(), lens.centre(), none);
            (lens.focal(), Model::Pinhole(straight))
        }
        Model::KannalaBrandt(lens) => {
            let straight = KannalaBrandt::new(lens.focal(), lens.centre(), [0.0; 4]);
            (lens.focal(), Model::KannalaBrandt(straight))
        }
        Model::Equirectangular(_) | Model::Ocam(_) => return None,
    };
    let straight = Camera::new(straight, camera.width, camera.height);
    let areas = areas(camera, places);
    let on_axis = cell(camera, places).iter().product::<f64>() / (focal[0] * focal[1]);
    let of_axis = areas.iter().flatten().map(|area| area / on_axis);
    let both = areas.iter().zip(self::areas(&straight, places));
    let of_straight = both.filter_map(|(area, straight)| Some((*area)? / straight?));
    Some(Spread {
        of_axis: of_axis.reduce(f64::max)?,
        of_straight: of_straight.reduce(f64::max)?,
    })
}

/// Width and height of what lies between places.
fn cell(camera: &Camera, places: u32) -> [f64; 2] {
    let between = f64::from(places - 1);
    [camera.width, camera.height].map(|size| f64::from(size - 1) / between)
}

/// What the rays of each place, the next one and the one below it have between them, row by row.
fn areas(camera: &Camera, places: u32) -> Vec<Option<f64>> {
    let [width, height] = cell(camera, places);
    let ray = |u: u32, v: u32| camera.unproject([f64::from(u) * width, f64::from(v) * height]);
    let area = |u: u32, v: u32| {
        let here: Vector3<f64> = ray(u, v)?;
        let (right, below) = (ray(u + 1, v)? - here, ray(u, v + 1)? - here);
        Some(right.cross(&below).norm())
    };
    let rows = 0..places - 1;
    rows.flat_map(|v| (0..places - 1).map(move |u| (u, v)))
        .map(|(u, v)| area(u, v))
        .collect()
}
