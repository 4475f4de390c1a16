//! Points of the world in the frame of the keyframe that sees them, from tracks and a short stretch of odometry.

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use super::drive::{Bearing, DriveTrack, Surveyed};
use crate::geometry::pose::Pose;

/// Rounds of triangulation: the first finds the ranges that weigh the second.
const ROUNDS: usize = 3;

/// A ray may miss its point by as many standard deviations.
const MAX_SIGMA: f64 = 3.5;

/// Nearer to a camera there is nothing but its own vehicle, metres.
const MIN_RANGE_M: f64 = 0.2;

/// A feature whose point is known.
#[derive(Debug, Clone, Copy)]
pub(super) struct LocalPoint {
    pub(super) camera: u32,
    pub(super) feature: u32,
    /// Vehicle frame of the keyframe, metres.
    pub(super) position: Vector3<f32>,
    /// Of the position, m².
    pub(super) covariance: Matrix3<f32>,
}

/// What a point must be like.
#[derive(Debug, Clone, Copy)]
pub(super) struct PointLimits {
    /// Path before and after the keyframe whose sightings count, metres.
    pub(super) window_m: f64,
    /// Standard deviation along the ray as a share of the range.
    pub(super) max_relative_sigma: f64,
}

/// A sighting, in the odometry frame.
pub(super) struct Ray {
    pub(super) keyframe: usize,
    feature: u32,
    pub(super) origin: Vector3<f64>,
    direction: Vector3<f64>,
    variance: f64,
}

/// For each keyframe of a drive its points, by camera and feature.
pub(super) fn local_points<E: Send>(
    drive: &Surveyed<'_, E>,
    limits: &PointLimits,
) -> Result<Vec<Vec<LocalPoint>>, E> {
    let bearings = drive.bearings()?;
    let tracks = drive.drive.tracks.par_iter().zip(&bearings);
    let found: Vec<Vec<(usize, LocalPoint)>> = tracks
        .map(|(track, bearings)| of_track(drive, track, bearings, limits))
        .collect();
    let mut points = vec![Vec::new(); drive.drive.keyframes.len()];
    for (keyframe, point) in found.into_iter().flatten() {
        points[keyframe].push(point);
    }
    points
        .par_iter_mut()
        .for_each(|points: &mut Vec<LocalPoint>| {
            points.sort_unstable_by_key(|point| (point.camera, point.feature));
            points.dedup_by_key(|point| (point.camera, point.feature));
            points.shrink_to_fit();
        });
    Ok(points)
}

fn of_track<E>(
    drive: &Surveyed<'_, E>,
    track: &DriveTrack,
    bearings: &[Option<Bearing>],
    limits: &PointLimits,
) -> Vec<(usize, LocalPoint)> {
    let rays = rays(drive, track, bearings);
    let mut found = Vec::with_capacity(rays.len());
    let mut last: Option<(std::ops::Range<usize>, Option<Triangulated>)> = None;
    for ray in &rays {
        let here = drive.path_m[ray.keyframe];
        let start = rays.partition_point(|ray| drive.path_m[ray.keyframe] < here - limits.window_m);
        let end = rays.partition_point(|ray| drive.path_m[ray.keyframe] <= here + limits.window_m);
        let window = start..end;
        if last.as_ref().is_none_or(|(of, _)| *of != window) {
            last = Some((window.clone(), triangulated(&rays[window], limits)));
        }
        let Some((_, Some(point))) = &last else {
            continue;
        };
        let vehicle_from_odom = drive.drive.keyframes[ray.keyframe]
            .odom_from_vehicle
            .inverse();
        let turn = vehicle_from_odom.rotation.to_rotation_matrix().into_inner();
        let local = LocalPoint {
            camera: track.camera as u32,
            feature: ray.feature,
            position: vehicle_from_odom.transform(&point.position).cast(),
            covariance: (turn * point.covariance * turn.transpose()).cast(),
        };
        found.push((ray.keyframe, local));
    }
    found
}

/// The track's sightings that have a ray, by keyframe; given where each is seen.
pub(super) fn rays<E>(
    drive: &Surveyed<'_, E>,
    track: &DriveTrack,
    bearings: &[Option<Bearing>],
) -> Vec<Ray> {
    let Some(mount) = drive.mounts.get(track.camera) else {
        return Vec::new();
    };
    let ray = |((keyframe, feature), bearing): (&(u32, u32), &Option<Bearing>)| {
        let index = *keyframe as usize;
        let bearing = (*bearing)?;
        let odom_from_camera: Pose = drive.drive.keyframes[index]
            .odom_from_vehicle
            .compose(mount);
        Some(Ray {
            keyframe: index,
            feature: *feature,
            origin: odom_from_camera.translation,
            direction: odom_from_camera.rotate(&bearing.direction.cast()),
            variance: f64::from(bearing.sigma_rad).powi(2),
        })
    };
    let mut rays: Vec<Ray> = track.points.iter().zip(bearings).filter_map(ray).collect();
    rays.sort_by_key(|ray| ray.keyframe);
    rays.dedup_by_key(|ray| ray.keyframe);
    rays
}

pub(super) struct Triangulated {
    pub(super) position: Vector3<f64>,
    pub(super) covariance: Matrix3<f64>,
}

/// The point nearest to all rays, in angles: linear least squares of the distances across the rays, each divided by
/// its range.
pub(super) fn triangulated(rays: &[Ray], limits: &PointLimits) -> Option<Triangulated> {
    if rays.len() < 2 {
        return None;
    }
    let middle = rays[rays.len() / 2].origin;
    let mut ranges = vec![1.0; rays.len()];
    let mut solved = None;
    for _ in 0..ROUNDS {
        let (mut information, mut pull) = (Matrix3::zeros(), Vector3::zeros());
        for (ray, range) in rays.iter().zip(&ranges) {
            let across = Matrix3::identity() - ray.direction * ray.direction.transpose();
            let across = across / (ray.variance * range * range);
            information += across;
            pull += across * (ray.origin - middle);
        }
        let covariance = information.try_inverse()?;
        let position = middle + covariance * pull;
        for (ray, range) in rays.iter().zip(&mut ranges) {
            *range = (position - ray.origin).norm().max(MIN_RANGE_M);
        }
        solved = Some(Triangulated {
            position,
            covariance,
        });
    }
    solved.filter(|point| sound(point, rays, limits))
}

fn sound(point: &Triangulated, rays: &[Ray], limits: &PointLimits) -> bool {
    let mut nearest = f64::INFINITY;
    for ray in rays {
        let towards = point.position - ray.origin;
        let range = towards.norm();
        let missed = towards.cross(&ray.direction).norm();
        let allowed = MAX_SIGMA * ray.variance.sqrt() * range;
        let ahead = towards.dot(&ray.direction) > 0.0;
        if !(range >= MIN_RANGE_M && ahead && missed <= allowed) {
            return false;
        }
        nearest = nearest.min(range);
    }
    // The largest variance is at most the trace, and along the rays nearly all of it.
    point.covariance.trace() <= (limits.max_relative_sigma * nearest).powi(2)
}
