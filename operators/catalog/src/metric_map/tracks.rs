#![doc = include_str!("tracks.md")]

use evermap_algorithms::metric_map::tracking::{CameraFrame, TrackParams, tracks};
use evermap_contract::{Emit, Fault, Key, Operator, Port, Reach, Sides, Work};
use evermap_schemas::layers::{Features, Keyframe, Track, TrackPoint};

use crate::inputs::drive::{FeaturedDrive, drives, is_recalibrated};
use crate::inputs::rig::{self, OfVehicle};

/// See the module's page.
pub struct Tracks;

impl Operator for Tracks {
    const NAME: &'static str = "tracks";
    const VERSION: u32 = 6;
    const PAGE: &'static str = include_str!("tracks.md");
    type Params = OfVehicle<TrackParams>;
    type Output = Track;

    fn work() -> Work<Self::Params> {
        let features = Port::session::<Features>("features");
        let mut sides = vec![Port::session::<Keyframe>("keyframes")];
        sides.extend(rig::ports(Reach::Session));
        Work::group(features, Key::CAMERA, sides, follow)
    }
}

fn follow(
    params: &OfVehicle<TrackParams>,
    features: Vec<Features>,
    sides: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let first = &features[0];
    let (site, session, camera) = (
        first.site.clone(),
        first.session.clone(),
        first.camera.clone(),
    );
    let images = features.len();
    if is_recalibrated(&features, &sides)? {
        let name = rig::shown(rig::frame(&camera));
        let reason =
            format!("calibration of camera `{name}` changes within a session; the first is used");
        emit.skip(reason, 1);
    }
    let keyframes = sides.rows("keyframes")?;
    let mut drives = drives(keyframes, features, &sides, &params.vehicle, emit)?;
    let Some(drive) = drives.remove(&session) else {
        emit.skip("image belongs to no keyframe", images as u64);
        return Ok(());
    };
    let found = of_drive(&drive, &params.options).into_iter().zip(0..);
    let rows = found.map(|(points, track)| Track {
        site: site.clone(),
        session: session.clone(),
        camera: camera.clone(),
        track,
        points,
    });
    emit.rows(rows.collect())
}

/// Tracks of the drive's only camera; none where it cannot be used.
fn of_drive(drive: &FeaturedDrive, params: &TrackParams) -> Vec<Vec<TrackPoint>> {
    let Some(mounted) = drive.rig.cameras.first() else {
        return Vec::new();
    };
    let views: Vec<CameraFrame<'_>> = drive
        .keyframes
        .iter()
        .filter_map(|keyframe| {
            Some(CameraFrame {
                stretch: keyframe.stretch,
                odom_from_camera: keyframe
                    .odom_from_vehicle
                    .compose(&mounted.vehicle_from_camera),
                features: keyframe.features.images.first()?,
            })
        })
        .collect();
    let point = |view: u32, feature: u32| {
        let keyframe = drive.keyframes.get(view as usize)?.number;
        Some(TrackPoint { keyframe, feature })
    };
    tracks(&mounted.camera, &views, params)
        .into_iter()
        .map(|track| {
            track
                .iter()
                .filter_map(|at| point(at.view, at.feature))
                .collect()
        })
        .collect()
}
