#![doc = include_str!("bundle_adjustment.md")]

use std::collections::{BTreeMap, BTreeSet};

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::geometry::rig::RigCamera;
use evermap_algorithms::metric_map::association::{FeatureRef, Landmark, descriptors_of};
use evermap_algorithms::metric_map::mapping::{
    Candidate, Map, MapInput, MapObservation, MappingParams, SummaryParams, Touch, map, summary,
    touched,
};
use evermap_contract::{Emit, Fault, Key, Operator, Port, Reach, Sides, Work};
use evermap_schemas::layers::{
    AdjustedPose, Features, ImageSize, Keyframe, MapFrame, Observation, Track, TrackPoint,
    VehiclePose,
};
use evermap_schemas::{Bytes, Stamp};

use crate::inputs::rig::{self, OfVehicle};
use crate::inputs::survey::{KeyframeName, NewDrives, Survey};

/// See the module's page.
pub struct BundleAdjustment;

impl Operator for BundleAdjustment {
    const NAME: &'static str = "bundle_adjustment";
    const VERSION: u32 = 11;
    const PAGE: &'static str = include_str!("bundle_adjustment.md");
    type Params = OfVehicle<MappingParams>;
    type Output = AdjustedPose;

    fn work() -> Work<Self::Params> {
        let poses = Port::site::<VehiclePose>("poses");
        let mut sides = vec![
            Port::site::<Keyframe>("keyframes"),
            Port::site::<Features>("features").fetched(),
            Port::site::<Track>("tracks"),
        ];
        sides.extend(rig::ports(Reach::Site));
        sides.push(Port::site::<AdjustedPose>("previous").optional());
        sides.push(Port::site::<MapFrame>("previous_frames").optional());
        Work::group(poses, Key::SITE, sides, adjust)
    }
}

fn adjust(
    params: &OfVehicle<MappingParams>,
    poses: Vec<VehiclePose>,
    mut sides: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let site = poses[0].site.clone();
    let frames = sides.rows::<MapFrame>("previous_frames")?;
    let summary = &params.options.summary;
    let previous = kept(sides.take("previous")?, &frames, summary);
    let keyframes: Vec<Keyframe> = sides.rows("keyframes")?;
    let first_new = first_new(&previous);
    let mut staying = BTreeSet::from_iter(base(&previous, &frames));
    let PreviousKeyframes {
        rows: known,
        holding,
        untouched,
    } = PreviousKeyframes::new(previous, &new_places(&poses, &keyframes), summary);
    let new = NewDrives { poses, keyframes };
    // Who has neighbours that stay lies where they do.
    let whole = holding.is_empty() && untouched.is_empty();
    let frames = if whole {
        named(&frames)
    } else {
        BTreeSet::new()
    };
    staying.extend(holding);
    let survey = Survey::new(&known, new, &sides, &params.vehicle, emit)?;
    let landmarks = landmarks(&survey, &known);
    // What they say is in the survey now, and takes as much again.
    drop(known);
    let tracks = tracks(&survey, sides.take("tracks")?, emit);
    let found = map::<Fault>(
        &MapInput {
            scene: &survey.scene,
            poses: &survey.poses,
            landmarks: &landmarks,
            tracks: &tracks,
            fixed: &fixed(&survey, &staying),
            datum: &survey.among(&frames),
            first_new,
        },
        &survey,
        &params.options,
    )?;
    emit_all(&survey, &found, &site, untouched, emit)
}

/// The keyframes of map frames.
fn named(frames: &[MapFrame]) -> BTreeSet<KeyframeName> {
    let names = frames.iter();
    let names = names.map(|frame| (frame.session.clone(), frame.stamp));
    names.collect()
}

/// The keyframes of the version before that hold the map up.
struct PreviousKeyframes {
    /// Those that new drives have to do with.
    rows: Vec<AdjustedPose>,
    /// Which of them stay where they are.
    holding: BTreeSet<KeyframeName>,
    /// The others.
    untouched: Vec<AdjustedPose>,
}

impl PreviousKeyframes {
    fn new(previous: Vec<AdjustedPose>, new: &[[f64; 3]], params: &SummaryParams) -> Self {
        let places: Vec<[f64; 3]> = previous
            .iter()
            .map(|row| place(&row.map_from_vehicle))
            .collect();
        let mut known = Self {
            rows: Vec::new(),
            holding: BTreeSet::new(),
            untouched: Vec::new(),
        };
        for (row, touch) in previous.into_iter().zip(touched(&places, new, params)) {
            if touch == Touch::Untouched {
                known.untouched.push(row);
                continue;
            }
            if touch == Touch::Holding {
                known.holding.insert((row.session.clone(), row.stamp));
            }
            known.rows.push(row);
        }
        known
    }
}

fn place(pose: &evermap_schemas::Pose) -> [f64; 3] {
    [pose.x, pose.y, pose.z]
}

/// Where the keyframes of new drives are.
fn new_places(poses: &[VehiclePose], keyframes: &[Keyframe]) -> Vec<[f64; 3]> {
    let new: BTreeSet<&str> = keyframes.iter().map(|row| row.session.as_str()).collect();
    let poses = poses
        .iter()
        .filter(|row| new.contains(row.session.as_str()));
    let places = poses.map(|row| place(&row.map_from_vehicle));
    places
        .filter(|place| place.iter().all(|at| at.is_finite()))
        .collect()
}

/// The first name that no landmark of the version before has.
fn first_new(previous: &[AdjustedPose]) -> u32 {
    let seen = previous.iter().flat_map(|row| &row.observations);
    let last = seen.map(|seen| seen.landmark).max();
    last.map_or(0, |last| last.saturating_add(1))
}

/// The keyframe of the version before that stays: that of the map's first frame, or the earliest.
fn base(previous: &[AdjustedPose], frames: &[MapFrame]) -> Option<KeyframeName> {
    let frames: BTreeMap<(&str, Stamp), u32> = frames
        .iter()
        .map(|frame| ((frame.session.as_str(), frame.stamp), frame.frame))
        .collect();
    let order = |row: &&AdjustedPose| {
        let frame = frames.get(&(row.session.as_str(), row.stamp));
        (
            frame.copied().unwrap_or(u32::MAX),
            row.stamp,
            row.session.clone(),
        )
    };
    let base = previous.iter().min_by_key(order)?;
    Some((base.session.clone(), base.stamp))
}

/// The keyframes that stay: the base, and those that hold the others; where there are none, the earliest.
fn fixed(survey: &Survey, staying: &BTreeSet<KeyframeName>) -> Vec<usize> {
    let fixed = survey.among(staying);
    if !fixed.is_empty() {
        return fixed;
    }
    let keyframes = survey.keyframes.iter().enumerate();
    let earliest = keyframes.min_by_key(|(_, keyframe)| (keyframe.stamp, &keyframe.session));
    earliest.map(|(at, _)| at).into_iter().collect()
}

/// The keyframes of the version before that go on holding the map up; those of map frames do.
fn kept(
    previous: Vec<AdjustedPose>,
    frames: &[MapFrame],
    params: &SummaryParams,
) -> Vec<AdjustedPose> {
    let frames = named(frames);
    let mut seen_by: BTreeMap<u32, BTreeSet<&str>> = BTreeMap::new();
    for row in &previous {
        for seen in &row.observations {
            let sessions = seen_by.entry(seen.landmark).or_default();
            sessions.insert(&row.session);
        }
    }
    let candidate = |row: &AdjustedPose| Candidate {
        // One without a pose is left out, and counted, where poses are read.
        pose: Pose::from_array(row.map_from_vehicle.to_array())
            .unwrap_or_else(|_| Pose::identity()),
        held: frames.contains(&(row.session.clone(), row.stamp)),
        landmarks: row.observations.iter().map(|seen| seen.landmark).collect(),
    };
    let candidates: Vec<Candidate> = previous.iter().map(candidate).collect();
    let drives = |landmark: u32| seen_by.get(&landmark).map_or(0, BTreeSet::len);
    let kept = summary(&candidates, &drives, params);
    let rows = previous.into_iter().zip(kept);
    rows.filter_map(|(row, kept)| kept.then_some(row)).collect()
}

/// The landmarks of the version before, by name.
fn landmarks(survey: &Survey, known: &[AdjustedPose]) -> Vec<Landmark> {
    let landmark = |(id, features)| Landmark {
        id,
        point: Default::default(),
        features,
    };
    let landmarks = survey.landmarks(known).into_iter();
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

/// Rows that are made, and handed on, at a time: all of a site's at once take more than all that they are made from.
const AT_A_TIME: usize = 64;

/// Emits the keyframes that were adjusted and those that were not touched, by session and stamp.
fn emit_all(
    survey: &Survey,
    found: &Map,
    site: &str,
    untouched: Vec<AdjustedPose>,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let mut seen: Vec<Vec<&MapObservation>> = vec![Vec::new(); survey.scene.keyframes.len()];
    for observation in &found.observations {
        let image = &survey.scene.images[observation.feature.image as usize];
        seen[image.keyframe as usize].push(observation);
    }
    let untouched = untouched.into_iter().map(|row| {
        let name = (row.session.clone(), row.stamp);
        (name, Row::Untouched(Box::new(row)))
    });
    let surveyed = survey.keyframes.iter().zip(seen).zip(0..);
    let surveyed = surveyed.map(|((keyframe, seen), at)| {
        let name = (keyframe.session.clone(), keyframe.stamp);
        (name, Row::Adjusted(at, seen))
    });
    let mut rows: Vec<(KeyframeName, Row)> = surveyed.chain(untouched).collect();
    rows.sort_by(|(a, _), (b, _)| a.cmp(b));
    let mut rows = rows.into_iter().map(|(_, row)| match row {
        Row::Untouched(row) => Ok(*row),
        Row::Adjusted(at, seen) => adjusted(survey, found, site, at, seen),
    });
    loop {
        let some = rows.by_ref().take(AT_A_TIME);
        let some: Vec<AdjustedPose> = some.collect::<Result<_, Fault>>()?;
        if some.is_empty() {
            return Ok(());
        }
        emit.rows(some)?;
    }
}

/// What a row is made from.
enum Row<'a> {
    Untouched(Box<AdjustedPose>),
    /// The keyframe's index in the survey, and what it sees.
    Adjusted(usize, Vec<&'a MapObservation>),
}

fn adjusted(
    survey: &Survey,
    found: &Map,
    site: &str,
    at: usize,
    mut seen: Vec<&MapObservation>,
) -> Result<AdjustedPose, Fault> {
    let (keyframe, of_scene) = (&survey.keyframes[at], &survey.scene.keyframes[at]);
    // Images stand in the order of the cameras' names, their features in that of their numbers.
    seen.sort_by_key(|seen| seen.feature);
    let observations = seen.iter();
    let observations = observations.map(|seen| observation(survey, found, seen));
    let features: Vec<FeatureRef> = seen.iter().map(|seen| seen.feature).collect();
    let descriptors = descriptors_of::<Fault>(survey, &features)?.into_iter();
    let descriptors = descriptors.flat_map(|descriptor| descriptor.0);
    let rig = &survey.scene.rigs[of_scene.session as usize];
    Ok(AdjustedPose {
        site: site.to_owned(),
        session: keyframe.session.clone(),
        stamp: keyframe.stamp,
        keyframe: keyframe.number,
        stretch: keyframe.stretch,
        map_from_vehicle: evermap_schemas::Pose::from_array(found.poses[at].to_array()),
        odom_from_vehicle: evermap_schemas::Pose::from_array(of_scene.odom_from_vehicle.to_array()),
        observations: observations.collect(),
        descriptors: Bytes(descriptors.collect()),
        images: rig.cameras.iter().map(image_size).collect(),
    })
}

fn observation(survey: &Survey, found: &Map, seen: &MapObservation) -> Observation {
    let feature = survey.scene.feature(seen.feature);
    Observation {
        camera: survey.scene.camera(seen.feature.image).name.clone(),
        feature: survey.number(seen.feature),
        u: feature.pixel()[0] as f32,
        v: feature.pixel()[1] as f32,
        size_px: feature.size_px() as f32,
        landmark: found.landmarks[seen.landmark as usize].id,
        residual_px: seen.residual_px as f32,
        weight: seen.weight as f32,
    }
}

fn image_size(camera: &RigCamera) -> ImageSize {
    ImageSize {
        camera: camera.name.clone(),
        width: camera.camera.width,
        height: camera.camera.height,
    }
}
