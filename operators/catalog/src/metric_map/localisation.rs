#![doc = include_str!("localisation.md")]

use std::collections::BTreeMap;

use evermap_algorithms::metric_map::features::{DESCRIPTOR_BYTES, Descriptor};
use evermap_algorithms::metric_map::localisation::{
    DriveKeyframe, Fix, KeyframeLocalisation, LandmarkMap, LocalisationParams as Options,
    Localiser, MapLandmark, Places, State,
};
use evermap_algorithms::geometry::rig::Rig;
use evermap_contract::{Emit, Fault, Grain, Kernel, Operator, Port, Sides, group_whole};
use evermap_schemas::Pose;
use evermap_schemas::layers::{Features, Keyframe, Landmark, Localisation as Row, Observation};
use evermap_schemas::roles::{Calibration, Transform};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::drive::{Drive, drives};
use crate::inputs::rig::SessionName;

/// See the module's page.
pub struct Localisation;

/// How a drive is localised.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LocalisationParams {
    /// Standard deviation of a feature's place in the image (px).
    pub feature_px: f64,
    /// Descriptors that differ in more bits, of 512, are not of one landmark.
    pub match_bits: u32,
    /// A landmark's distance by descriptor, over that of the next that could be meant, is below this.
    pub match_ratio: f64,
    /// Radius in which a pose is verified (px).
    pub verify_px: f64,
    /// Largest radius of a search (px).
    pub search_px: f64,
    /// Fewest inliers of a fix.
    pub min_inliers: usize,
    /// Smallest share of inliers among the matches within `verify_px`.
    pub min_inlier_share: f64,
    /// Fewest of 24 directions around the vehicle that inliers lie in.
    pub min_directions: usize,
    /// Largest standard deviation of a localised position (m).
    pub max_sigma_m: f64,
    /// Largest standard deviation of a localised orientation (rad).
    pub max_sigma_rad: f64,
    /// What the map's landmarks around a keyframe are off by together (m).
    pub map_m: f64,
    /// What they are turned by together (rad).
    pub map_rad: f64,
    /// Standard deviation of odometry's distance over distance.
    pub odometry_scale: f64,
    /// Standard deviation of odometry's heading by distance (rad/m).
    pub odometry_yaw_rad_per_m: f64,
    /// Standard deviation of roll and pitch by distance (rad/m).
    pub tilt_rad_per_m: f64,
    /// A guess less certain than this is given up (m).
    pub give_up_m: f64,
    /// Keyframes that must confirm a recovered one.
    pub confirmations: usize,
    /// Landmarks farther than this are not looked for (m).
    pub reach_m: f64,
    /// How far outside the cone it was seen from a landmark is looked for (rad).
    pub view_slack_rad: f64,
    /// How far outside the ranges it was seen at a landmark is looked for, as a factor.
    pub range_slack: f64,
    /// The frame that poses are of.
    pub vehicle_frame: String,
}

impl Default for LocalisationParams {
    fn default() -> Self {
        let options = Options::default();
        Self {
            feature_px: options.feature_px,
            match_bits: options.match_bits,
            match_ratio: options.match_ratio,
            verify_px: options.verify_px,
            search_px: options.search_px,
            min_inliers: options.min_inliers,
            min_inlier_share: options.min_inlier_share,
            min_directions: options.min_directions,
            max_sigma_m: options.max_sigma_m,
            max_sigma_rad: options.max_sigma_rad,
            map_m: options.map_m,
            map_rad: options.map_rad,
            odometry_scale: options.odometry_scale,
            odometry_yaw_rad_per_m: options.odometry_yaw_rad_per_m,
            tilt_rad_per_m: options.tilt_rad_per_m,
            give_up_m: options.give_up_m,
            confirmations: options.confirmations,
            reach_m: options.reach_m,
            view_slack_rad: options.view_slack_rad,
            range_slack: options.range_slack,
            vehicle_frame: "base_link".to_owned(),
        }
    }
}

impl LocalisationParams {
    fn options(&self) -> Options {
        Options {
            feature_px: self.feature_px,
            match_bits: self.match_bits,
            match_ratio: self.match_ratio,
            verify_px: self.verify_px,
            search_px: self.search_px,
            min_inliers: self.min_inliers,
            min_inlier_share: self.min_inlier_share,
            min_directions: self.min_directions,
            max_sigma_m: self.max_sigma_m,
            max_sigma_rad: self.max_sigma_rad,
            map_m: self.map_m,
            map_rad: self.map_rad,
            odometry_scale: self.odometry_scale,
            odometry_yaw_rad_per_m: self.odometry_yaw_rad_per_m,
            tilt_rad_per_m: self.tilt_rad_per_m,
            give_up_m: self.give_up_m,
            confirmations: self.confirmations,
            reach_m: self.reach_m,
            view_slack_rad: self.view_slack_rad,
            range_slack: self.range_slack,
        }
    }
}

impl Operator for Localisation {
    const NAME: &'static str = "localisation";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("localisation.md");
    type Params = LocalisationParams;
    type Output = Row;

    fn ports() -> Vec<Port> {
        vec![
            Port::of::<Features>("features", Grain::SESSION),
            Port::of::<Keyframe>("keyframes", Grain::SESSION),
            Port::of::<Calibration>("calibration", Grain::SESSION),
            Port::of::<Transform>("transforms", Grain::SESSION),
            Port::of::<Landmark>("landmarks", Grain::Whole),
        ]
    }

    fn kernel(params: LocalisationParams) -> Result<Kernel, Fault> {
        let options = params.options();
        options
            .check()
            .map_err(|error| Fault::user(error.to_string()))?;
        let vehicle_frame = params.vehicle_frame;
        Ok(group_whole(move |features: Vec<Features>, sides, emit| {
            localise(features, sides, &vehicle_frame, options, emit)
        }))
    }
}

fn localise(
    features: Vec<Features>,
    sides: &Sides,
    vehicle_frame: &str,
    options: Options,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let (numbers, landmarks) = landmarks(sides.rows("landmarks")?);
    let sound = LandmarkMap::new(landmarks);
    emit.skip(
        "landmark makes no sense",
        (numbers.len() - sound.len()) as u64,
    );
    let keyframes = sides.rows("keyframes")?;
    for (name, drive) in drives(keyframes, features, sides, vehicle_frame)? {
        for (reason, count) in &drive.skipped {
            emit.skip(reason, *count);
        }
        let found = localise_drive(&drive, &sound, options)?;
        emit.rows(rows(&name, &drive, found, &numbers))?;
    }
    Ok(())
}

fn localise_drive(
    drive: &Drive,
    map: &LandmarkMap,
    options: Options,
) -> Result<Vec<KeyframeLocalisation>, Fault> {
    let localiser =
        Localiser::new(&drive.rig, map, options).map_err(|error| Fault::user(error.to_string()))?;
    let keyframes: Vec<_> = drive
        .keyframes
        .iter()
        .map(|keyframe| DriveKeyframe {
            odom_from_vehicle: keyframe.odom_from_vehicle,
            features: &keyframe.features,
        })
        .collect();
    Ok(localiser.localise(&keyframes, &Places::new(&drive.rig, map, &options)))
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
            descriptors: descriptors(&row.descriptors.0),
            seen_from,
        };
        (row.landmark, landmark)
    };
    rows.into_iter().map(of_row).unzip()
}

fn descriptors(bytes: &[u8]) -> Vec<Descriptor> {
    let each = bytes.chunks_exact(DESCRIPTOR_BYTES).map(|bytes| {
        let mut descriptor = [0; DESCRIPTOR_BYTES];
        descriptor.copy_from_slice(bytes);
        Descriptor(descriptor)
    });
    each.collect()
}

fn rows(
    (site, session): &SessionName,
    drive: &Drive,
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
            observations: known.map_or_else(Vec::new, |fix| observations(fix, &drive.rig, numbers)),
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

fn observations(fix: &Fix, rig: &Rig, numbers: &[u32]) -> Vec<Observation> {
    let seen = fix.inliers.iter().map(|found| Observation {
        camera: rig.cameras[found.camera].name.clone(),
        feature: found.feature as u32,
        landmark: numbers[found.landmark],
        residual_px: found.residual_px as f32,
        weight: found.weight as f32,
    });
    seen.collect()
}
