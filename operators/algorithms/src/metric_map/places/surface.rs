//! Points of what stood around one drive, from its tracks and the map's poses.
//!
//! Landmarks are what a map keeps of all drives; cars that were parked during one of them are not among it for long. What
//! stood where in one drive is asked of its own tracks.

use nalgebra::Vector3;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::drive::{Bearing, Drive, DriveTrack, Surveyed};
use super::local_points::{PointLimits, rays, triangulated};
use crate::metric_map::features::FeatureNoise;

/// Which points are kept.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct SurfaceOptions {
    /// How exactly features lie.
    #[serde(flatten)]
    pub features: FeatureNoise,
    /// Largest standard deviation of a point (m): a third of the height from which on something stands, rather than lies, on
    /// the ground, so that what is seen to stand does.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub max_sigma_m: f64,
}

impl Default for SurfaceOptions {
    fn default() -> Self {
        Self {
            features: FeatureNoise::default(),
            max_sigma_m: 0.1,
        }
    }
}

/// A point that a drive saw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePoint {
    /// Where it is, in the frame of the drive's poses (m).
    pub position: Vector3<f64>,
    /// Root of the sum of its variances along three axes, the poses taken for exact (m).
    pub sigma_m: f64,
    /// Above the plane that the wheels stood on where it was seen from nearest (m).
    pub height_m: f64,
    /// Indices of the first and the last keyframe that saw it.
    pub seen: [usize; 2],
}

/// The points of a drive whose keyframes' `odom_from_vehicle` are poses in the map, by track.
///
/// # Errors
/// Why what its cameras saw cannot be fetched.
pub fn surface_points<E: Send>(
    drive: &Drive<'_, E>,
    options: &SurfaceOptions,
) -> Result<Vec<SurfacePoint>, E> {
    let surveyed = Surveyed::new(drive, options.features.sigma_px);
    let bearings = surveyed.bearings()?;
    let tracks = drive.tracks.par_iter().zip(&bearings);
    let found = tracks.filter_map(|(track, bearings)| point(&surveyed, track, bearings, options));
    Ok(found.collect())
}

fn point<E>(
    drive: &Surveyed<'_, E>,
    track: &DriveTrack,
    bearings: &[Option<Bearing>],
    options: &SurfaceOptions,
) -> Option<SurfacePoint> {
    let limits = PointLimits {
        window_m: f64::INFINITY,
        max_relative_sigma: f64::INFINITY,
    };
    let rays = rays(drive, track, bearings);
    let point = triangulated(&rays, &limits)?;
    let sigma_m = point.covariance.trace().sqrt();
    let away = |origin: &Vector3<f64>| (point.position - origin).norm();
    let nearest = rays
        .iter()
        .min_by(|a, b| away(&a.origin).total_cmp(&away(&b.origin)))?;
    let vehicle = drive.drive.keyframes[nearest.keyframe].odom_from_vehicle;
    let found = SurfacePoint {
        position: point.position,
        sigma_m,
        height_m: vehicle.inverse().transform(&point.position).z,
        seen: [rays.first()?.keyframe, rays.last()?.keyframe],
    };
    (sigma_m <= options.max_sigma_m && found.height_m.is_finite()).then_some(found)
}
