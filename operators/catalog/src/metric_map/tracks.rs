#![doc = include_str!("tracks.md")]

use evermap_algorithms::metric_map::matching::MatchLimits;
use evermap_algorithms::metric_map::tracking::{TrackParams, View, tracks};
use evermap_contract::{Emit, Fault, Grain, Kernel, Operator, Port, Sides, group_whole};
use evermap_schemas::layers::{Features, Keyframe, Track, TrackPoint};
use evermap_schemas::roles::{Calibration, Transform};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::drive::{Drive, drives};

/// See the module's page.
pub struct Tracks;

/// How features are followed.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TracksParams {
    /// Descriptors that differ in more bits than this, of 512, do not match.
    pub max_distance: u32,
    /// The best match's distance must be below this share of the next best one's.
    pub max_ratio: f64,
    /// Nothing is nearer to a camera than this (m).
    pub min_depth_m: f64,
    /// Keyframes that a track may miss between two sightings.
    pub gap: u32,
    /// Tracks with fewer sightings are dropped.
    pub min_points: u32,
    /// Tracks are cut after this many sightings.
    pub max_points: u32,
    /// Standard deviation of where a small feature lies (px).
    pub noise_px: f64,
    /// Standard deviation of odometry's way between two keyframes: share of the way.
    pub way_sigma: f64,
    /// Standard deviation of odometry's rotation between two keyframes, tilt included (rad).
    pub turn_sigma_rad: f64,
    /// Keyframes farther apart than this are not matched (m).
    pub max_step_m: f64,
    /// The frame that the keyframes' poses are of.
    pub vehicle_frame: String,
}

impl Default for TracksParams {
    fn default() -> Self {
        let TrackParams {
            limits:
                MatchLimits {
                    max_distance,
                    max_ratio,
                },
            min_depth_m,
            gap,
            min_points,
            max_points,
            noise_px,
            way_sigma,
            turn_sigma_rad,
            max_step_m,
        } = TrackParams::default();
        Self {
            max_distance,
            max_ratio,
            min_depth_m,
            gap,
            min_points,
            max_points,
            noise_px,
            way_sigma,
            turn_sigma_rad,
            max_step_m,
            vehicle_frame: "base_link".to_owned(),
        }
    }
}

impl TracksParams {
    fn tracking(&self) -> TrackParams {
        TrackParams {
            limits: MatchLimits {
                max_distance: self.max_distance,
                max_ratio: self.max_ratio,
            },
            min_depth_m: self.min_depth_m,
            gap: self.gap,
            min_points: self.min_points,
            max_points: self.max_points,
            noise_px: self.noise_px,
            way_sigma: self.way_sigma,
            turn_sigma_rad: self.turn_sigma_rad,
            max_step_m: self.max_step_m,
        }
    }

    fn check(&self) -> Result<(), Fault> {
        let positive = [
            ("max_ratio", self.max_ratio),
            ("min_depth_m", self.min_depth_m),
            ("noise_px", self.noise_px),
            ("way_sigma", self.way_sigma),
            ("turn_sigma_rad", self.turn_sigma_rad),
            ("max_step_m", self.max_step_m),
        ];
        match positive
            .iter()
            .find(|(_, value)| !(value.is_finite() && *value > 0.0))
        {
            Some((name, value)) => Err(Fault::user(format!("expected {name} > 0, found {value}"))),
            None => Ok(()),
        }
    }
}

impl Operator for Tracks {
    const NAME: &'static str = "tracks";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("tracks.md");
    type Params = TracksParams;
    type Output = Track;

    fn ports() -> Vec<Port> {
        let camera = Grain::Key {
            columns: &["site", "session", "camera"],
            order: &["stamp"],
        };
        vec![
            Port::of::<Features>("features", camera),
            Port::of::<Keyframe>("keyframes", Grain::SESSION),
            Port::of::<Calibration>("calibration", Grain::SESSION),
            Port::of::<Transform>("transforms", Grain::SESSION),
        ]
    }

    fn kernel(params: TracksParams) -> Result<Kernel, Fault> {
        params.check()?;
        Ok(group_whole(move |features, sides, emit| {
            follow(features, sides, &params, emit)
        }))
    }
}

/// The tracks of one camera of one session.
fn follow(
    features: Vec<Features>,
    sides: &Sides,
    params: &TracksParams,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let Some(first) = features.first() else {
        return Ok(());
    };
    let (site, session, camera) = (
        first.site.clone(),
        first.session.clone(),
        first.camera.clone(),
    );
    let images = features.len();
    let keyframes = sides.rows::<Keyframe>("keyframes")?;
    let keyframes = keyframes
        .into_iter()
        .filter(|row| row.site == site && row.session == session)
        .collect();
    let mut drives = drives(keyframes, features, sides, &params.vehicle_frame)?;
    let Some(drive) = drives.remove(&(site.clone(), session.clone())) else {
        emit.skip("image belongs to no keyframe", images as u64);
        return Ok(());
    };
    drive
        .skipped
        .iter()
        .for_each(|(reason, count)| emit.skip(reason, *count));
    let rows = of_drive(&drive, params)
        .into_iter()
        .zip(0..)
        .map(|(points, track)| Track {
            site: site.clone(),
            session: session.clone(),
            camera: camera.clone(),
            track,
            points,
        });
    emit.rows(rows.collect())
}

/// Tracks of the drive's only camera; none where it cannot be used.
fn of_drive(drive: &Drive, params: &TracksParams) -> Vec<Vec<TrackPoint>> {
    let Some(mounted) = drive.rig.cameras.first() else {
        return Vec::new();
    };
    let views: Vec<View<'_>> = drive
        .keyframes
        .iter()
        .filter_map(|keyframe| {
            Some(View {
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
    tracks(&mounted.camera, &views, &params.tracking())
        .into_iter()
        .map(|track| {
            track
                .iter()
                .filter_map(|at| point(at.view, at.feature))
                .collect()
        })
        .collect()
}
