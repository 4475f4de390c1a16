#![doc = include_str!("surface_points.md")]

use std::collections::BTreeMap;

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::metric_map::places::{SurfaceOptions, surface_points};
use evermap_contract::{Emit, Fault, Key, Operator, Port, Reach, Sides, Work};
use evermap_schemas::layers::{Features, Keyframe, SurfacePoint, Track, VehiclePose};

use crate::inputs::drive::{FeaturedDrive, FetchedFeatures, StoredRows, stored_drives, tracks};
use crate::inputs::rig::{self, OfVehicle};

/// See the module's page.
pub struct SurfacePoints;

impl Operator for SurfacePoints {
    const NAME: &'static str = "surface_points";
    const VERSION: u32 = 2;
    const PAGE: &'static str = include_str!("surface_points.md");
    type Params = OfVehicle<SurfaceOptions>;
    type Output = SurfacePoint;

    fn work() -> Work<Self::Params> {
        let tracks = Port::session::<Track>("tracks");
        let mut sides = vec![
            Port::session::<Features>("features").fetched(),
            Port::session::<Keyframe>("keyframes"),
            Port::session::<VehiclePose>("poses"),
        ];
        sides.extend(rig::ports(Reach::Session));
        Work::group(tracks, Key::SESSION, sides, points)
    }
}

fn points(
    params: &OfVehicle<SurfaceOptions>,
    rows: Vec<Track>,
    sides: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let first = &rows[0];
    let (site, session) = (first.site.clone(), first.session.clone());
    let (keyframes, images) = (sides.rows("keyframes")?, sides.rows("features")?);
    let images = images.into_iter().enumerate();
    let mut drives = stored_drives(keyframes, images, &sides, &params.vehicle, emit)?;
    if let Some(drive) = drives.get_mut(&session) {
        place(drive, sides.rows("poses")?, emit);
    }
    let mut tracks = tracks(rows, &drives, emit);
    let Some(drive) = drives.get(&session) else {
        return Ok(());
    };
    let features = &sides.fetched("features")?;
    let seen = FetchedFeatures { drive, features };
    let drive = seen.with_tracks(tracks.remove(&session).unwrap_or_default());
    let stamp = |keyframe: usize| evermap_schemas::Stamp(drive.keyframes[keyframe].stamp);
    let found = surface_points(&drive, &params.options)?;
    let row = |(point, found): (u32, &evermap_algorithms::metric_map::places::SurfacePoint)| {
        SurfacePoint {
            site: site.clone(),
            session: session.clone(),
            point,
            x: found.position.x,
            y: found.position.y,
            z: found.position.z,
            height_m: found.height_m,
            sigma_m: found.sigma_m,
            first_stamp: stamp(found.seen[0]),
            last_stamp: stamp(found.seen[1]),
        }
    };
    emit.rows((0..).zip(&found).map(row).collect())
}

/// Puts a drive's keyframes where they are in the map; those without a pose are left out.
fn place(drive: &mut FeaturedDrive<StoredRows>, poses: Vec<VehiclePose>, emit: &mut Emit<'_>) {
    let mut placed = BTreeMap::new();
    for row in poses {
        match Pose::from_array(row.map_from_vehicle.to_array()) {
            Ok(pose) => drop(placed.insert(row.stamp, pose)),
            Err(_) => emit.skip("pose is not a rigid transform", 1),
        }
    }
    drive.keyframes.retain_mut(|keyframe| {
        let pose = placed.get(&keyframe.stamp);
        pose.is_some_and(|pose| {
            keyframe.odom_from_vehicle = *pose;
            true
        })
    });
}
