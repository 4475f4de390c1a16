#![doc = include_str!("bundle_adjustment.md")]

use std::collections::BTreeMap;

use evermap_algorithms::metric_map::association::{AssociationParams, FeatureRef, Landmark};
use evermap_algorithms::metric_map::mapping::{AdjustParams, Map, MapInput, MappingParams, map};
use evermap_contract::{Emit, Fault, Grain, Kernel, Operator, Port, Sides, group_whole};
use evermap_schemas::layers::{
    AdjustedPose, Features, GraphPose, Keyframe, Observation, Track, TrackPoint,
};
use evermap_schemas::roles::{Calibration, Transform};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::survey::Survey;

/// See the module's page.
pub struct BundleAdjustment;

/// How poses are adjusted.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct BundleAdjustmentParams {
    /// Rounds of association and adjustment.
    pub rounds: u32,
    /// Radius around a predicted pixel that the first round searches (px).
    pub first_radius_px: f64,
    /// Radius that the last round searches (px).
    pub last_radius_px: f64,
    /// Descriptors with more differing bits are not alike.
    pub max_bits: u32,
    /// The best feature has fewer bits than this part of the second best one's.
    pub ratio: f64,
    /// Standard deviation of a feature (px).
    pub sigma_px: f64,
    /// Features farther from their landmark than this, in standard deviations, are wrong.
    pub drop_sigmas: f64,
    /// Rays to a landmark differ by at least this angle (rad).
    pub min_parallax_rad: f64,
    /// Standard deviation of a session's odometry scale about 1.
    pub odometry_scale_sigma: f64,
    /// The frame whose poses are adjusted.
    pub vehicle_frame: String,
}

impl Default for BundleAdjustmentParams {
    fn default() -> Self {
        let MappingParams {
            rounds,
            first_radius_px,
            last_radius_px,
            association,
            drop_sigmas,
            min_parallax_rad,
            adjust,
            ..
        } = MappingParams::default();
        Self {
            rounds,
            first_radius_px,
            last_radius_px,
            max_bits: association.max_bits,
            ratio: association.ratio,
            sigma_px: adjust.sigma_px,
            drop_sigmas,
            min_parallax_rad,
            odometry_scale_sigma: adjust.odometry_scale_sigma,
            vehicle_frame: "base_link".into(),
        }
    }
}

impl BundleAdjustmentParams {
    fn mapping(&self) -> Result<MappingParams, Fault> {
        let positive = [
            ("first_radius_px", self.first_radius_px),
            ("last_radius_px", self.last_radius_px),
            ("ratio", self.ratio),
            ("sigma_px", self.sigma_px),
            ("drop_sigmas", self.drop_sigmas),
            ("min_parallax_rad", self.min_parallax_rad),
            ("odometry_scale_sigma", self.odometry_scale_sigma),
        ];
        for (name, value) in positive {
            if !(value > 0.0 && value.is_finite()) {
                return Err(Fault::user(format!(
                    "expected {name} above 0, found {value}"
                )));
            }
        }
        let defaults = MappingParams::default();
        Ok(MappingParams {
            rounds: self.rounds,
            first_radius_px: self.first_radius_px,
            last_radius_px: self.last_radius_px,
            association: AssociationParams {
                max_bits: self.max_bits,
                ratio: self.ratio,
                ..defaults.association
            },
            drop_sigmas: self.drop_sigmas,
            min_parallax_rad: self.min_parallax_rad,
            adjust: AdjustParams {
                sigma_px: self.sigma_px,
                odometry_scale_sigma: self.odometry_scale_sigma,
                ..defaults.adjust
            },
            ..defaults
        })
    }
}

impl Operator for BundleAdjustment {
    const NAME: &'static str = "bundle_adjustment";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("bundle_adjustment.md");
    type Params = BundleAdjustmentParams;
    type Output = AdjustedPose;

    fn ports() -> Vec<Port> {
        vec![
            Port::of::<GraphPose>("poses", Grain::Whole),
            Port::of::<Keyframe>("keyframes", Grain::Whole),
            Port::of::<Features>("features", Grain::Whole),
            Port::of::<Track>("tracks", Grain::Whole),
            Port::of::<Calibration>("calibration", Grain::Whole),
            Port::of::<Transform>("transforms", Grain::Whole),
            Port::of::<AdjustedPose>("previous", Grain::Whole).optional(),
        ]
    }

    fn kernel(params: BundleAdjustmentParams) -> Result<Kernel, Fault> {
        let mapping = params.mapping()?;
        Ok(group_whole(
            move |poses: Vec<GraphPose>, sides: &Sides, emit: &mut Emit<'_>| {
                adjust(poses, sides, &mapping, &params.vehicle_frame, emit)
            },
        ))
    }
}

fn adjust(
    mut poses: Vec<GraphPose>,
    sides: &Sides,
    params: &MappingParams,
    vehicle_frame: &str,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let Some(site) = poses.first().map(|pose| pose.site.clone()) else {
        return Ok(());
    };
    let mut previous = sides.rows::<AdjustedPose>("previous")?;
    previous.retain(|row| row.site == site);
    let base = base(&poses, &previous);
    keep_previous(&mut poses, &previous);
    let guesses = poses.iter().map(|row| {
        let pose = row.map_from_vehicle.to_array();
        (row.session.as_str(), row.keyframe, pose)
    });
    let keyframes = sides.rows::<Keyframe>("keyframes")?;
    let survey = Survey::new(&site, guesses, keyframes, sides, vehicle_frame, emit)?;
    let landmarks = landmarks(&survey, &previous);
    let tracks = tracks(&survey, sides, &site, emit)?;
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
        params,
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
    let mut landmarks: BTreeMap<u32, Vec<FeatureRef>> = BTreeMap::new();
    for row in previous {
        let Some(keyframe) = survey.keyframe(&row.session, row.keyframe) else {
            continue;
        };
        for seen in &row.observations {
            let feature = survey.feature(keyframe, &seen.camera, seen.feature);
            landmarks.entry(seen.landmark).or_default().extend(feature);
        }
    }
    landmarks
        .into_iter()
        .map(|(id, features)| Landmark {
            id,
            point: Default::default(),
            features,
        })
        .collect()
}

fn tracks(
    survey: &Survey,
    sides: &Sides,
    site: &str,
    emit: &mut Emit<'_>,
) -> Result<Vec<Vec<FeatureRef>>, Fault> {
    let mut tracks = Vec::new();
    let mut unknown = 0;
    for row in sides.rows::<Track>("tracks")? {
        if row.site != site {
            continue;
        }
        let point = |point: &TrackPoint| {
            let keyframe = survey.keyframe(&row.session, point.keyframe)?;
            survey.feature(keyframe, &row.camera, point.feature)
        };
        let track: Vec<FeatureRef> = row.points.iter().filter_map(point).collect();
        if track.len() > 1 {
            tracks.push(track);
        } else {
            unknown += 1;
        }
    }
    emit.skip(
        "track has fewer than two features in keyframes with a pose",
        unknown,
    );
    Ok(tracks)
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
