#![doc = include_str!("loop_closures.md")]

use std::collections::BTreeMap;

use evermap_algorithms::metric_map::matching::MatchLimits;
use evermap_algorithms::metric_map::places::{self, DriveTrack, Loop, LoopOptions, VocabularyOptions};
use evermap_algorithms::geometry::resection::ResectionOptions;
use evermap_contract::{Emit, Fault, Grain, Kernel, Operator, Port, Sides, group_whole};
use evermap_schemas::layers::{Features, Keyframe, LoopClosure, Track};
use evermap_schemas::roles::{Calibration, Transform};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::drive::{Drive, drives};
use crate::inputs::rig::SessionName;

/// See the module's page.
pub struct LoopClosures;

/// How loops are looked for.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LoopClosuresParams {
    /// Keyframes of one session are compared when more driven path than this lies between them (m).
    pub min_path_m: f64,
    /// Places that are looked at closely for each keyframe.
    pub places: u32,
    /// Loops wanted for each keyframe.
    pub edges: u32,
    /// Similar keyframes nearer together along a session than this are one place (m).
    pub place_m: f64,
    /// Loops from a keyframe to one place lead to keyframes at least as far apart (m).
    pub spacing_m: f64,
    /// Driven path before and after a keyframe whose sightings make its points (m).
    pub window_m: f64,
    /// Standard deviation of a point along its ray, at most, as a share of its range.
    pub max_relative_sigma: f64,
    /// Standard deviation of a feature's place in the image (px).
    pub sigma_px: f64,
    /// Standard deviation of odometry's scale.
    pub odometry_scale_sigma: f64,
    /// Descriptors that differ in more bits than this, of 512, never match.
    pub max_distance: u32,
    /// A descriptor's distance must be below this share of the runner-up's.
    pub max_ratio: f64,
    /// Probability that a wrong match agrees with a wrong pose.
    pub agreement: f64,
    /// False loops per comparison that chance may make.
    pub false_alarms: f64,
    /// Inliers must lie in as many of 24 directions around the vehicle.
    pub min_sectors: u32,
    /// Loops with a larger standard deviation of position are left out (m).
    pub max_sigma_m: f64,
    /// Descriptors that the vocabulary is trained with, at most.
    pub max_training: u32,
    /// Samples of the search for a pose, at most.
    pub max_iterations: u32,
    /// The frame that relative poses are of.
    pub vehicle_frame: String,
}

impl Default for LoopClosuresParams {
    fn default() -> Self {
        let options = LoopOptions::default();
        Self {
            min_path_m: options.min_path_m,
            places: options.places as u32,
            edges: options.edges as u32,
            place_m: options.place_m,
            spacing_m: options.spacing_m,
            window_m: options.window_m,
            max_relative_sigma: options.max_relative_sigma,
            sigma_px: options.sigma_px,
            odometry_scale_sigma: options.odometry_scale_sigma,
            max_distance: options.limits.max_distance,
            max_ratio: options.limits.max_ratio,
            agreement: options.agreement,
            false_alarms: options.false_alarms,
            min_sectors: options.min_sectors as u32,
            max_sigma_m: options.max_sigma_m,
            max_training: options.vocabulary.max_training as u32,
            max_iterations: options.resection.max_iterations as u32,
            vehicle_frame: "base_link".to_owned(),
        }
    }
}

impl LoopClosuresParams {
    fn options(&self) -> LoopOptions {
        LoopOptions {
            vocabulary: VocabularyOptions {
                max_training: self.max_training as usize,
                ..Default::default()
            },
            min_path_m: self.min_path_m,
            place_m: self.place_m,
            spacing_m: self.spacing_m,
            places: self.places as usize,
            edges: self.edges as usize,
            window_m: self.window_m,
            max_relative_sigma: self.max_relative_sigma,
            limits: MatchLimits {
                max_distance: self.max_distance,
                max_ratio: self.max_ratio,
            },
            sigma_px: self.sigma_px,
            odometry_scale_sigma: self.odometry_scale_sigma,
            agreement: self.agreement,
            false_alarms: self.false_alarms,
            min_sectors: self.min_sectors as usize,
            max_sigma_m: self.max_sigma_m,
            resection: ResectionOptions {
                max_iterations: self.max_iterations as usize,
                ..Default::default()
            },
        }
    }

    fn refuse_senseless(&self) -> Result<(), Fault> {
        let above_zero = [
            ("place_m", self.place_m),
            ("window_m", self.window_m),
            ("max_relative_sigma", self.max_relative_sigma),
            ("sigma_px", self.sigma_px),
            ("max_ratio", self.max_ratio),
            ("agreement", self.agreement),
            ("false_alarms", self.false_alarms),
            ("max_sigma_m", self.max_sigma_m),
        ];
        let any = [
            ("min_path_m", self.min_path_m),
            ("spacing_m", self.spacing_m),
            ("odometry_scale_sigma", self.odometry_scale_sigma),
        ];
        let wrong = above_zero
            .iter()
            .find(|(_, value)| !(*value > 0.0 && value.is_finite()));
        if let Some((name, value)) = wrong {
            return Err(Fault::user(format!("expected {name} > 0, found {value}")));
        }
        let wrong = any
            .iter()
            .find(|(_, value)| !(*value >= 0.0 && value.is_finite()));
        if let Some((name, value)) = wrong {
            return Err(Fault::user(format!("expected {name} >= 0, found {value}")));
        }
        Ok(())
    }
}

impl Operator for LoopClosures {
    const NAME: &'static str = "loop_closures";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("loop_closures.md");
    type Params = LoopClosuresParams;
    type Output = LoopClosure;

    fn ports() -> Vec<Port> {
        vec![
            Port::of::<Features>("features", Grain::Whole),
            Port::of::<Track>("tracks", Grain::Whole),
            Port::of::<Keyframe>("keyframes", Grain::Whole),
            Port::of::<Calibration>("calibration", Grain::Whole),
            Port::of::<Transform>("transforms", Grain::Whole),
        ]
    }

    fn kernel(params: LoopClosuresParams) -> Result<Kernel, Fault> {
        params.refuse_senseless()?;
        Ok(group_whole(move |features: Vec<Features>, sides, emit| {
            loop_closures(features, sides, &params, emit)
        }))
    }
}

fn loop_closures(
    features: Vec<Features>,
    sides: &Sides,
    params: &LoopClosuresParams,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let drives = drives(
        sides.rows("keyframes")?,
        features,
        sides,
        &params.vehicle_frame,
    )?;
    for (reason, count) in drives.values().flat_map(|drive| &drive.skipped) {
        emit.skip(reason, *count);
    }
    let mut tracks = tracks(sides.rows("tracks")?, &drives, emit);
    let names: Vec<&SessionName> = drives.keys().collect();
    let searched: Vec<places::Drive<'_>> = drives
        .iter()
        .map(|(name, drive)| searched(drive, tracks.remove(name).unwrap_or_default()))
        .collect();
    let found = places::loops(&searched, &params.options());
    let rows = found.iter().map(|found| row(found, &names, &drives));
    emit.rows(rows.flatten().collect())
}

fn searched(drive: &Drive, tracks: Vec<DriveTrack>) -> places::Drive<'_> {
    let keyframes = drive
        .keyframes
        .iter()
        .map(|keyframe| places::DriveKeyframe {
            stamp: keyframe.stamp.0,
            odom_from_vehicle: keyframe.odom_from_vehicle,
            features: &keyframe.features,
        });
    places::Drive {
        rig: &drive.rig,
        keyframes: keyframes.collect(),
        tracks,
    }
}

/// Tracks by session, with keyframes by index. A track of a camera that cannot be used is left out.
fn tracks(
    rows: Vec<Track>,
    drives: &BTreeMap<SessionName, Drive>,
    emit: &mut Emit<'_>,
) -> BTreeMap<SessionName, Vec<DriveTrack>> {
    let mut tracks: BTreeMap<SessionName, Vec<DriveTrack>> = BTreeMap::new();
    for row in rows {
        let name = (row.site, row.session);
        let drive = drives.get(&name);
        let camera = drive.and_then(|drive| Some((drive, drive.rig.index(&row.camera)?)));
        let Some((drive, camera)) = camera else {
            emit.skip("track of a camera that cannot be used", 1);
            continue;
        };
        let indexed = row.points.iter();
        let points = indexed
            .filter_map(|point| Some((drive.index(point.keyframe)? as u32, point.feature)))
            .collect();
        tracks
            .entry(name)
            .or_default()
            .push(DriveTrack { camera, points });
    }
    tracks
}

fn row(
    found: &Loop,
    names: &[&SessionName],
    drives: &BTreeMap<SessionName, Drive>,
) -> Option<LoopClosure> {
    let keyframe = |(drive, keyframe): (usize, usize)| {
        let name = *names.get(drive)?;
        Some((name, drives.get(name)?.keyframes.get(keyframe)?))
    };
    let ((site, session), later) = keyframe(found.later)?;
    let ((_, other_session), earlier) = keyframe(found.earlier)?;
    Some(LoopClosure {
        site: site.clone(),
        session: session.clone(),
        stamp: later.stamp,
        keyframe: later.number,
        other_session: other_session.clone(),
        other_stamp: earlier.stamp,
        other_keyframe: earlier.number,
        other_from_vehicle: evermap_schemas::Pose::from_array(found.earlier_from_later.to_array()),
        matches: found.matches as u32,
        inliers: found.inliers as u32,
        sigma_m: found.sigma_m(),
        sigma_rad: found.sigma_rad(),
    })
}
