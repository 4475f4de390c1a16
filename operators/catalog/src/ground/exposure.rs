#![doc = include_str!("exposure.md")]

use std::collections::BTreeMap;

use evermap_algorithms::geometry::camera::Camera;
use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::ground::danger::exposure::{
    ExposureParams, Looks, Shot, Standing, Surroundings,
};
use evermap_algorithms::ground::floor::Floor;
use evermap_contract::{Emit, Fault, Key, Operator, Port, Reach, Reason, Sides, Work};
use evermap_schemas::Stamp;
use evermap_schemas::layers::{BodyMask, Exposure, PosedImage, SurfacePoint};
use evermap_vision::Grey;
use rayon::prelude::*;

use crate::inputs::bodies::bodies;
use crate::inputs::rig::{self, OfVehicle, Rig, frame};

/// See the module's page.
pub struct ExposureOfGround;

impl Operator for ExposureOfGround {
    const NAME: &'static str = "exposure";
    const VERSION: u32 = 3;
    const PAGE: &'static str = include_str!("exposure.md");
    type Params = OfVehicle<ExposureParams>;
    type Output = Exposure;

    fn work() -> Work<Self::Params> {
        let images = Port::session::<PosedImage>("images");
        let mut sides = rig::ports(Reach::Session).to_vec();
        sides.push(Port::session::<BodyMask>("body_masks").optional());
        sides.push(Port::session::<SurfacePoint>("points").optional());
        Work::group(images, Key::SESSION, sides, exposure)
    }

    fn check(params: &Self::Params) -> Result<(), Fault> {
        let checked = params.options.check();
        checked.map_err(|error| Fault::user(error.to_string()))
    }
}

/// Images that are looked at side by side, before their looks are counted in order.
const BLOCK: usize = 256;

fn exposure(
    params: &OfVehicle<ExposureParams>,
    images: Vec<PosedImage>,
    sides: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let first = &images[0];
    let (site, session) = (first.site.clone(), first.session.clone());
    let bodies = bodies(&sides)?;
    let points: Vec<SurfacePoint> = sides.rows("points")?;
    let standing = Standing::new(points.iter().map(|point| [point.x, point.y, point.z]));
    let poses = images.iter().map(|image| image.map_from_vehicle.to_array());
    let poses: Vec<Pose> = poses
        .filter_map(|pose| Pose::from_array(pose).ok())
        .collect();
    let floor = Floor::under(&poses, 0.0, params.options.range_m);
    let rigs = rig::sessions(&sides)?;
    let mut cameras = Cameras::new(rigs.get(&session), params);
    let mut taken = Vec::with_capacity(images.len());
    for image in &images {
        let name = frame(&image.camera);
        let pose = Pose::from_array(image.map_from_vehicle.to_array());
        match (pose, cameras.at(name, image.stamp)) {
            (Ok(pose), Ok(camera)) => {
                let body = bodies.get(&(session.clone(), name.to_owned()));
                taken.push((image.stamp.0, pose, camera, body));
            }
            (_, Err(reason)) => emit.skip(reason, 1),
            (Err(_), Ok(_)) => emit.skip("pose is not a rigid transform", 1),
        }
    }
    let around = Surroundings {
        floor: &floor,
        standing: &standing,
    };
    let mut looks = Looks::default();
    for block in taken.chunks(BLOCK) {
        let shown = block.par_iter().map(|(_, pose, (camera, mounted), body)| {
            let shot = Shot {
                map_from_vehicle: pose,
                camera,
                vehicle_from_camera: mounted,
            };
            let body = |pixel: [f64; 2]| body.is_some_and(|mask| shows(mask, camera, pixel));
            shot.shows(&around, body, &params.options)
        });
        for ((stamp, ..), shown) in block.iter().zip(shown.collect::<Vec<_>>()) {
            match shown {
                Ok(shown) => looks.add(*stamp, &shown, &params.options),
                Err(reason) => emit.skip(reason, 1),
            }
        }
    }
    let row = |([column, row], looked): ([i32; 2], _)| {
        let looked: evermap_algorithms::ground::danger::exposure::Looked = looked;
        Exposure {
            site: site.clone(),
            session: session.clone(),
            column,
            row,
            cell_m: params.options.cell_m,
            look_s: params.options.look_s,
            looks: looked.looks,
            first_stamp: Stamp(looked.first_stamp),
        }
    };
    emit.rows(looks.into_cells().into_iter().map(row).collect())
}

/// Whether the mask has the vehicle itself at a pixel of the camera; masks of smaller images are stretched.
fn shows(mask: &Grey, camera: &Camera, [u, v]: [f64; 2]) -> bool {
    let at = |pixel: f64, size: u32, masked: u32| {
        let scaled = (pixel + 0.5) * f64::from(masked) / f64::from(size);
        (scaled.max(0.0) as u32).min(masked.saturating_sub(1)) as usize
    };
    let column = at(u, camera.width, mask.width);
    let row = at(v, camera.height, mask.height);
    let pixel = mask.data.get(row * mask.width as usize + column);
    pixel.is_some_and(|value| *value != 0)
}

/// Cameras of a session and where they are mounted, by name and by the stamp of the calibration that holds.
struct Cameras<'a> {
    rig: Option<&'a Rig>,
    vehicle: &'a str,
    known: BTreeMap<(String, Stamp), Result<(Camera, Pose), Reason>>,
}

impl<'a> Cameras<'a> {
    fn new(rig: Option<&'a Rig>, params: &'a OfVehicle<ExposureParams>) -> Self {
        Self {
            rig,
            vehicle: params.vehicle.name(),
            known: BTreeMap::new(),
        }
    }

    fn at(&mut self, name: &str, stamp: Stamp) -> Result<(Camera, Pose), Reason> {
        let rig = self.rig.ok_or_else(|| rig::uncalibrated(name))?;
        let calibration = rig.calibration(name, stamp)?;
        let made = || {
            let mounted = rig.vehicle_from_camera(self.vehicle, calibration)?;
            let size = [calibration.width, calibration.height];
            Ok((rig::camera(calibration, size)?, mounted))
        };
        let known = self.known.entry((name.to_owned(), calibration.stamp));
        known.or_insert_with(made).clone()
    }
}
