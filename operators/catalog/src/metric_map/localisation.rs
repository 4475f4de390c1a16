#![doc = include_str!("localisation.md")]

use std::collections::BTreeMap;

use evermap_algorithms::geometry::rig::Rig;
use evermap_algorithms::metric_map::features::KeyframeFeatures;
use evermap_algorithms::metric_map::localisation::{
    Doubt, DriveKeyframe, Fix, KeyframeLocalisation, LandmarkMap, LocalisationParams, Localiser,
    MapLandmark, Places, State,
};
use evermap_contract::{Emit, Fault, Key, Operator, Port, Reach, Sides, Work};
use evermap_schemas::Pose;
use evermap_schemas::layers::{Features, Keyframe, Landmark, Localisation as Row, Observation};

use crate::inputs::drive::{FeaturedDrive, descriptors, drives};
use crate::inputs::rig::{self, OfVehicle};

/// See the module's page.
pub struct Localisation;

impl Operator for Localisation {
    const NAME: &'static str = "localisation";
    const VERSION: u32 = 7;
    const PAGE: &'static str = include_str!("localisation.md");
    type Params = OfVehicle<LocalisationParams>;
    type Output = Row;

    fn work() -> Work<Self::Params> {
        let features = Port::session::<Features>("features");
        let mut sides = vec![Port::session::<Keyframe>("keyframes")];
        sides.extend(rig::ports(Reach::Session));
        sides.push(Port::site::<Landmark>("landmarks").needed());
        Work::group(features, Key::SESSION, sides, localise)
    }

    fn check(params: &Self::Params) -> Result<(), Fault> {
        let checked = params.options.check();
        checked.map_err(|error| Fault::user(error.to_string()))
    }
}

fn localise(
    params: &OfVehicle<LocalisationParams>,
    features: Vec<Features>,
    sides: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let site = features[0].site.clone();
    let (numbers, landmarks) = landmarks(sides.rows("landmarks")?);
    let sound = LandmarkMap::new(landmarks);
    let senseless = numbers.len() - sound.len();
    emit.skip(
        "invalid landmark: a position or covariance is not finite",
        senseless as u64,
    );
    let keyframes = sides.rows("keyframes")?;
    for (session, drive) in drives(keyframes, features, &sides, &params.vehicle, emit)? {
        let found = localise_drive(&drive, &sound, params.options);
        emit.skip(
            "keyframe held back: it may be of another place that looks alike",
            of_another_place(&found) as u64,
        );
        emit.rows(rows([&site, &session], &drive, found, &numbers))?;
    }
    Ok(())
}

fn localise_drive(
    drive: &FeaturedDrive,
    map: &LandmarkMap,
    params: LocalisationParams,
) -> Vec<KeyframeLocalisation> {
    let keyframes: Vec<_> = drive
        .keyframes
        .iter()
        .map(|keyframe| DriveKeyframe {
            odom_from_vehicle: keyframe.odom_from_vehicle,
            features: &keyframe.features,
        })
        .collect();
    let places = Places::new(&drive.rig, map, &params);
    Localiser::new(&drive.rig, map, params).localise(&keyframes, &places)
}

/// How many poses agree with the map, and are of another place all the same.
fn of_another_place(found: &[KeyframeLocalisation]) -> usize {
    let fixes = found.iter().filter_map(|found| found.fix.as_ref());
    fixes
        .filter(|fix| fix.doubt == Some(Doubt::AnotherPlace))
        .count()
}

/// The landmarks, and their numbers in the map.
fn landmarks(rows: Vec<Landmark>) -> (Vec<u32>, Vec<MapLandmark>) {
    let mut sightings: BTreeMap<(String, u32), u32> = BTreeMap::new();
    let of_row = |row: Landmark| {
        let mut seen_from: Vec<u32> = row
            .sightings
            .into_iter()
            .map(|seen| {
                let next = sightings.len() as u32;
                *sightings
                    .entry((seen.session, seen.keyframe))
                    .or_insert(next)
            })
            .collect();
        seen_from.sort_unstable();
        seen_from.dedup();
        let landmark = MapLandmark {
            position: [row.x, row.y, row.z].into(),
            sigma_m: row.sigma_m,
            view: row.view.into(),
            view_cos: row.view_cos,
            near_m: row.near_m,
            far_m: row.far_m,
            descriptors: descriptors(&row.descriptors).collect(),
            seen_from,
        };
        (row.landmark, landmark)
    };
    rows.into_iter().map(of_row).unzip()
}

fn rows(
    [site, session]: [&String; 2],
    drive: &FeaturedDrive,
    found: Vec<KeyframeLocalisation>,
    numbers: &[u32],
) -> Vec<Row> {
    let rows = drive.keyframes.iter().zip(found).map(|(keyframe, found)| {
        let known = found.fix.as_ref().filter(|_| found.state != State::Lost);
        let tried = |count: fn(&Fix) -> usize| found.fix.as_ref().map_or(0, count) as u32;
        Row {
            site: site.clone(),
            session: session.clone(),
            stamp: keyframe.stamp,
            keyframe: keyframe.number,
            state: state(found.state).to_owned(),
            map_from_vehicle: known.map(|fix| Pose::from_array(fix.pose.pose.to_array())),
            covariance: known.map_or_else(Vec::new, |fix| {
                fix.pose.covariance.transpose().iter().copied().collect()
            }),
            sigma_m: known.map(|fix| fix.pose.sigma_m()),
            sigma_rad: known.map(|fix| fix.pose.sigma_rad()),
            candidates: tried(|fix| fix.candidates),
            matches: tried(|fix| fix.matches),
            inliers: tried(|fix| fix.inliers.len()),
            rms_px: known.and_then(Fix::rms_px),
            observations: known.map_or_else(Vec::new, |fix| {
                observations(fix, &drive.rig, &keyframe.features, numbers)
            }),
        }
    });
    rows.collect()
}

fn state(state: State) -> &'static str {
    match state {
        State::Localised => "localised",
        State::Recovered => "recovered",
        State::Lost => "lost",
    }
}

fn observations(
    fix: &Fix,
    rig: &Rig,
    features: &KeyframeFeatures,
    numbers: &[u32],
) -> Vec<Observation> {
    let seen = fix.inliers.iter().map(|found| {
        let feature = &features.images[found.camera].features[found.feature];
        Observation {
            camera: rig.cameras[found.camera].name.clone(),
            feature: found.feature as u32,
            u: feature.pixel[0] as f32,
            v: feature.pixel[1] as f32,
            size_px: feature.size_px as f32,
            landmark: numbers[found.landmark],
            residual_px: found.residual_px as f32,
            weight: found.weight as f32,
        }
    });
    seen.collect()
}
