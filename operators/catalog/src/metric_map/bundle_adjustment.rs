#![doc = include_str!("bundle_adjustment.md")]

use std::collections::BTreeMap;

use evermap_algorithms::metric_map::association::{FeatureRef, Landmark};
use evermap_algorithms::metric_map::mapping::{Map, MapInput, MappingParams, map};
use evermap_contract::{Emit, Fault, Key, Operator, Port, Reach, Sides, Work};
use evermap_schemas::layers::{
    AdjustedPose, Features, GraphPose, Keyframe, Observation, Track, TrackPoint,
};

use crate::inputs::rig::{self, OfVehicle};
use crate::inputs::survey::Survey;

/// See the module's page.
pub struct BundleAdjustment;

impl Operator for BundleAdjustment {
    const NAME: &'static str = "bundle_adjustment";
    const VERSION: u32 = 4;
    const PAGE: &'static str = include_str!("bundle_adjustment.md");
    type Params = OfVehicle<MappingParams>;
    type Output = AdjustedPose;

    fn work() -> Work<Self::Params> {
        let poses = Port::site::<GraphPose>("poses");
        let mut sides = vec![
            Port::site::<Keyframe>("keyframes"),
            Port::site::<Features>("features"),
            Port::site::<Track>("tracks"),
        ];
        sides.extend(rig::ports(Reach::Site));
        sides.push(Port::site::<AdjustedPose>("previous").optional());
        Work::group(poses, Key::SITE, sides, adjust)
    }
}

fn adjust(
    params: &OfVehicle<MappingParams>,
    mut poses: Vec<GraphPose>,
    sides: &Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let Some(site) = poses.first().map(|pose| pose.site.clone()) else {
        return Ok(());
    };
    let previous = sides.rows::<AdjustedPose>("previous")?;
    let base = base(&poses, &previous);
    keep_previous(&mut poses, &previous);
    let guesses = poses.iter().map(|row| {
        let pose = row.map_from_vehicle.to_array();
        (row.session.as_str(), row.keyframe, pose)
    });
    let keyframes = sides.rows::<Keyframe>("keyframes")?;
    let survey = Survey::new(guesses, keyframes, sides, &params.vehicle, emit)?;
    let landmarks = landmarks(&survey, &previous);
    let tracks = tracks(&survey, sides.rows("tracks")?, emit);
    let fixed = base
        .and_then(|(session, keyframe)| survey.keyframe(&session, keyframe))
        .unwrap_or(0);
    let found = map(
        &MapInput {
            scene: &survey.scene,
            poses: &survey.poses,
            landmarks: &landmarks,
            tracks: &tracks,
            fixed,
        },
        &params.options,
    );
    emit.rows(rows(&survey, &found, &site))
}

/// The keyframe whose pose stays: the earliest of the version before, or of all.
fn base(poses: &[GraphPose], previous: &[AdjustedPose]) -> Option<(String, u32)> {
    let known = previous
        .iter()
        .map(|row| (row.stamp, &row.session, row.keyframe))
        .min();
    let first = || {
        poses
            .iter()
            .map(|row| (row.stamp, &row.session, row.keyframe))
            .min()
    };
    known
        .or_else(first)
        .map(|(_, session, keyframe)| (session.clone(), keyframe))
}

/// Poses of the version before are taken as they were.
fn keep_previous(poses: &mut [GraphPose], previous: &[AdjustedPose]) {
    let known: BTreeMap<(&str, u32), &AdjustedPose> = previous
        .iter()
        .map(|row| ((row.session.as_str(), row.keyframe), row))
        .collect();
    for row in poses {
        if let Some(known) = known.get(&(row.session.as_str(), row.keyframe)) {
            row.map_from_vehicle = known.map_from_vehicle.clone();
        }
    }
}

/// The landmarks of the version before, by name.
fn landmarks(survey: &Survey, previous: &[AdjustedPose]) -> Vec<Landmark> {
    let landmark = |(id, features)| Landmark {
        id,
        point: Default::default(),
        features,
    };
    let landmarks = survey.landmarks(previous).into_iter();
    landmarks.map(landmark).collect()
}

fn tracks(survey: &Survey, rows: Vec<Track>, emit: &mut Emit<'_>) -> Vec<Vec<FeatureRef>> {
    let features = |row: Track| -> Vec<FeatureRef> {
        let feature = |point: &TrackPoint| {
            let keyframe = survey.keyframe(&row.session, point.keyframe)?;
            survey.feature(keyframe, &row.camera, point.feature)
        };
        row.points.iter().filter_map(feature).collect()
    };
    let all = rows.len();
    let mut tracks: Vec<_> = rows.into_iter().map(features).collect();
    tracks.retain(|track| track.len() > 1);
    emit.skip(
        "track has fewer than two features in keyframes with a pose",
        (all - tracks.len()) as u64,
    );
    tracks
}

fn rows(survey: &Survey, found: &Map, site: &str) -> Vec<AdjustedPose> {
    let mut seen: Vec<Vec<Observation>> = vec![Vec::new(); survey.scene.keyframes.len()];
    for observation in &found.observations {
        let image = observation.feature.image;
        let keyframe = survey.scene.images[image as usize].keyframe;
        seen[keyframe as usize].push(Observation {
            camera: survey.scene.camera(image).name.clone(),
            feature: observation.feature.feature,
            landmark: found.landmarks[observation.landmark as usize].id,
            residual_px: observation.residual_px as f32,
            weight: observation.weight as f32,
        });
    }
    let keyframes = survey.keyframes.iter().zip(&found.poses).zip(seen);
    let mut rows: Vec<AdjustedPose> = keyframes
        .map(|((keyframe, pose), mut observations)| {
            observations.sort_by(|a, b| (&a.camera, a.feature).cmp(&(&b.camera, b.feature)));
            AdjustedPose {
                site: site.to_owned(),
                session: keyframe.session.clone(),
                stamp: keyframe.stamp,
                keyframe: keyframe.number,
                map_from_vehicle: evermap_schemas::Pose::from_array(pose.to_array()),
                observations,
            }
        })
        .collect();
    rows.sort_by(|a, b| (&a.session, a.stamp).cmp(&(&b.session, b.stamp)));
    rows
}
