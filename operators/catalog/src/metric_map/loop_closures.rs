#![doc = include_str!("loop_closures.md")]

use std::collections::BTreeSet;

use evermap_algorithms::metric_map::places::{self, Loop, LoopOptions};
use evermap_contract::{Emit, Fault, Key, Operator, Port, Reach, Sides, Work};
use evermap_schemas::layers::{Features, Keyframe, LoopClosure, Track};

use crate::inputs::drive::{
    FeaturedDrive, FeaturedImage, FetchedFeatures, StoredRows, stored_drives, tracks,
};
use crate::inputs::rig::{self, OfVehicle};

/// See the module's page.
pub struct LoopClosures;

impl Operator for LoopClosures {
    const NAME: &'static str = "loop_closures";
    const VERSION: u32 = 6;
    const PAGE: &'static str = include_str!("loop_closures.md");
    type Params = OfVehicle<LoopOptions>;
    type Output = LoopClosure;

    fn work() -> Work<Self::Params> {
        let keyframes = Port::site::<Keyframe>("keyframes");
        let mut sides = vec![
            Port::site::<Features>("features").fetched(),
            Port::site::<Track>("tracks"),
            Port::site::<LoopClosure>("previous").optional(),
        ];
        sides.extend(rig::ports(Reach::Site));
        Work::group(keyframes, Key::SITE, sides, loop_closures)
    }
}

fn loop_closures(
    params: &OfVehicle<LoopOptions>,
    mut keyframes: Vec<Keyframe>,
    mut sides: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let site = keyframes[0].site.clone();
    let images: Vec<FeaturedImage> = sides.rows("features")?;
    let new: BTreeSet<String> = images.iter().map(|row| row.session.clone()).collect();
    emit.rows(known(sides.take("previous")?, &keyframes, &new))?;
    keyframes.retain(|row| new.contains(&row.session));
    let images = images.into_iter().enumerate();
    let drives = stored_drives(keyframes, images, &sides, &params.vehicle, emit)?;
    let mut tracks = tracks(sides.take("tracks")?, &drives, emit);
    let features = sides.fetched("features")?;
    let seen = drives.values().map(|drive| FetchedFeatures {
        drive,
        features: &features,
    });
    let seen: Vec<FetchedFeatures<'_>> = seen.collect();
    let searched: Vec<places::Drive<'_, Fault>> = drives
        .keys()
        .zip(&seen)
        .map(|(session, seen)| seen.with_tracks(tracks.remove(session).unwrap_or_default()))
        .collect();
    let found = places::loops(&searched, &params.options)?;
    let drives: Vec<(&String, &FeaturedDrive<StoredRows>)> = drives.iter().collect();
    let rows = found.iter().map(|found| row(&site, found, &drives));
    emit.rows(rows.flatten().collect())
}

/// The loops of the version before between sessions that are there and are not searched again.
fn known(
    mut previous: Vec<LoopClosure>,
    keyframes: &[Keyframe],
    new: &BTreeSet<String>,
) -> Vec<LoopClosure> {
    let there: BTreeSet<&String> = keyframes.iter().map(|row| &row.session).collect();
    let is_known = |session: &String| there.contains(session) && !new.contains(session);
    previous.retain(|row| is_known(&row.session) && is_known(&row.other_session));
    previous
}

fn row(
    site: &str,
    found: &Loop,
    drives: &[(&String, &FeaturedDrive<StoredRows>)],
) -> Option<LoopClosure> {
    let keyframe = |(drive, keyframe): (usize, usize)| {
        let (session, drive) = *drives.get(drive)?;
        Some((session.clone(), drive.keyframes.get(keyframe)?))
    };
    let (session, later) = keyframe(found.later)?;
    let (other_session, earlier) = keyframe(found.earlier)?;
    Some(LoopClosure {
        site: site.to_owned(),
        session,
        stamp: later.stamp,
        keyframe: later.number,
        other_session,
        other_stamp: earlier.stamp,
        other_keyframe: earlier.number,
        other_from_vehicle: evermap_schemas::Pose::from_array(found.earlier_from_later.to_array()),
        matches: found.matches as u32,
        inliers: found.inliers as u32,
        sigma_m: found.sigma_m(),
        sigma_rad: found.sigma_rad(),
    })
}
