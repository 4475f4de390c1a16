//! Whether two keyframes see the same place, by the geometry of what they see.

use nalgebra::{Matrix6, UnitQuaternion};

use super::drive::KeyframeView;
use super::local_points::LocalPoint;
use super::loops::LoopOptions;
use crate::geometry::lie::{se3, so3};
use crate::geometry::pose::Pose;
use crate::geometry::resection::{
    Correspondence, Resection, ResectionOptions, inliers_beyond_chance, refine, resect,
};
use crate::metric_map::features::Descriptor;
use crate::metric_map::matching::Descriptors;

/// Directions around the vehicle are told apart by as many sectors.
const SECTORS: usize = 24;

/// Mahalanobis distance, squared, beyond which two estimates of one pose disagree: 99.9 % of six degrees of freedom.
const MAX_DISAGREEMENT: f64 = 22.5;

/// A keyframe with its points.
#[derive(Clone, Copy)]
pub(super) struct KeyframePoints<'a> {
    /// `vehicle_from_camera`, in the rig's order.
    pub(super) mounts: &'a [Pose],
    pub(super) view: &'a KeyframeView<'a>,
    pub(super) points: &'a [LocalPoint],
}

/// How a later keyframe stood in an earlier one.
#[derive(Debug, Clone)]
pub(super) struct Verified {
    pub(super) earlier_from_later: Pose,
    /// Translation along the axes of the earlier vehicle (m²), then rotation about them (rad²).
    pub(super) covariance: Matrix6<f64>,
    pub(super) matches: usize,
    pub(super) inliers: usize,
}

/// Features that look alike; the earlier one's point is known.
struct Pair<'a> {
    camera: usize,
    feature: usize,
    point: &'a LocalPoint,
    distance: u32,
}

impl KeyframePoints<'_> {
    fn descriptor(&self, camera: usize, feature: usize) -> Option<&Descriptor> {
        let images = &self.view.features.images;
        Some(&images.get(camera)?.features.get(feature)?.descriptor)
    }

    fn images(&self) -> usize {
        self.view.features.images.len()
    }

    fn all(&self, camera: usize) -> Descriptors {
        self.view.features.images[camera]
            .features
            .iter()
            .map(|feature| &feature.descriptor)
            .collect()
    }

    fn correspondence(
        &self,
        camera: usize,
        feature: usize,
        point: &LocalPoint,
        distance: u32,
    ) -> Option<Correspondence> {
        let bearing = self.view.bearing(camera, feature)?;
        Some(Correspondence {
            camera,
            bearing: bearing.direction.cast(),
            sigma_rad: f64::from(bearing.sigma_rad),
            point: point.position.cast(),
            point_covariance: point.covariance.cast(),
            quality: -f64::from(distance),
        })
    }

    fn point(&self, camera: usize, feature: usize) -> Option<&LocalPoint> {
        let wanted = (camera as u32, feature as u32);
        let found = self
            .points
            .binary_search_by_key(&wanted, |point| (point.camera, point.feature));
        found.ok().map(|index| &self.points[index])
    }
}

/// The pose of the later keyframe from the points of the earlier one, confirmed the other way round. With a guess only
/// poses near it are looked for.
pub(super) fn verified(
    earlier: KeyframePoints<'_>,
    later: KeyframePoints<'_>,
    guess: Option<&Pose>,
    options: &LoopOptions,
) -> Option<Verified> {
    let pairs = pairs(&earlier, &later, options);
    let needed = inliers_beyond_chance(pairs.len(), options.agreement, options.false_alarms);
    if pairs.len() < needed {
        return None;
    }
    let resection = ResectionOptions {
        min_inliers: needed,
        ..options.resection.clone()
    };
    let forward: Vec<_> = (pairs.iter())
        .filter_map(|pair| {
            later.correspondence(pair.camera, pair.feature, pair.point, pair.distance)
        })
        .collect();
    let found = match guess {
        Some(guess) => refine(later.mounts, &forward, guess, &resection)?,
        None => resect(later.mounts, &forward, &resection)?,
    };
    if sectors(&later, &forward, &found) < options.min_sectors {
        return None;
    }
    let back: Vec<_> = (pairs.iter())
        .filter_map(|pair| {
            let point = later.point(pair.camera, pair.feature)?;
            let (camera, feature) = (pair.point.camera as usize, pair.point.feature as usize);
            earlier.correspondence(camera, feature, point, pair.distance)
        })
        .collect();
    let fused = confirmed(&earlier, &back, &found, options)?;
    Some(Verified {
        earlier_from_later: fused.0,
        covariance: fused.1,
        matches: pairs.len(),
        inliers: found.inliers.len(),
    })
}

/// Mutually nearest descriptors of each pair of cameras; of several matches of a later feature the nearest.
fn pairs<'a>(
    earlier: &KeyframePoints<'a>,
    later: &KeyframePoints<'_>,
    options: &LoopOptions,
) -> Vec<Pair<'a>> {
    let all: Vec<Descriptors> = (0..later.images())
        .map(|camera| later.all(camera))
        .collect();
    let mut pairs: Vec<Pair<'a>> = Vec::new();
    for points in earlier.points.chunk_by(|a, b| a.camera == b.camera) {
        let described = points
            .iter()
            .filter_map(|point| earlier.descriptor(point.camera as usize, point.feature as usize));
        let with_points: Descriptors = described.collect();
        for (camera, all) in all.iter().enumerate() {
            let found = with_points.mutual(all, &options.limits);
            pairs.extend(found.into_iter().filter_map(|found| {
                Some(Pair {
                    camera,
                    feature: found.found as usize,
                    point: points.get(found.query as usize)?,
                    distance: found.distance,
                })
            }));
        }
    }
    pairs.sort_by_key(|pair| (pair.camera, pair.feature, pair.distance));
    pairs.dedup_by_key(|pair| (pair.camera, pair.feature));
    pairs
}

/// In how many directions around the later vehicle inliers lie.
fn sectors(later: &KeyframePoints<'_>, given: &[Correspondence], found: &Resection) -> usize {
    let mut hit = [false; SECTORS];
    for index in &found.inliers {
        let given = &given[*index];
        let direction = later.mounts[given.camera].rotate(&given.bearing);
        let turn = direction.y.atan2(direction.x) / std::f64::consts::TAU + 0.5;
        hit[((turn * SECTORS as f64) as usize).min(SECTORS - 1)] = true;
    }
    hit.iter().filter(|hit| **hit).count()
}

/// Looks back: the earlier rig in the points of the later keyframe. Where there are too few of them, one side must do.
fn confirmed(
    earlier: &KeyframePoints<'_>,
    back: &[Correspondence],
    found: &Resection,
    options: &LoopOptions,
) -> Option<(Pose, Matrix6<f64>)> {
    let forward = &found.world_from_vehicle;
    let forward_covariance = inflated(&found.covariance, forward, options);
    let needed = inliers_beyond_chance(back.len(), options.agreement, options.false_alarms);
    if back.len() < 2 * needed {
        return Some((*forward, forward_covariance));
    }
    let resection = ResectionOptions {
        min_inliers: 6,
        ..options.resection.clone()
    };
    let looked = refine(earlier.mounts, back, &forward.inverse(), &resection)?;
    let backward = looked.world_from_vehicle.inverse();
    let backward_covariance = inflated(&inverted(&looked), &backward, options);
    fused(
        (forward, &forward_covariance),
        (&backward, &backward_covariance),
    )
}

/// The covariance of the inverse of a pose `a_from_b`, along the axes of b. `a_from_b Exp(ρ, φ)` has the inverse
/// `Exp(-ρ, -φ) b_from_a`, whose translation t is moved by `-ρ + t × φ` and whose rotation is turned by -φ.
fn inverted(found: &Resection) -> Matrix6<f64> {
    let along_right = se3::covariance_along_right(&found.world_from_vehicle, &found.covariance);
    let translation = found.world_from_vehicle.inverse().translation;
    let mut change = -Matrix6::identity();
    change
        .fixed_view_mut::<3, 3>(0, 3)
        .copy_from(&translation.cross_matrix());
    change * along_right * change.transpose()
}

/// The points come from odometry: its error of scale is theirs, and with them the relative position's.
fn inflated(covariance: &Matrix6<f64>, pose: &Pose, options: &LoopOptions) -> Matrix6<f64> {
    let error = pose.translation * options.odometry.sigma;
    let mut inflated = *covariance;
    let mut position = inflated.fixed_view_mut::<3, 3>(0, 0);
    position += error * error.transpose();
    inflated
}

/// Both by their information; none where they disagree. They come from the same images, so that two are counted to
/// know no more than one.
fn fused(
    (a, of_a): (&Pose, &Matrix6<f64>),
    (b, of_b): (&Pose, &Matrix6<f64>),
) -> Option<(Pose, Matrix6<f64>)> {
    let apart = se3::join(
        &(b.translation - a.translation),
        &so3::log(&(b.rotation * a.rotation.inverse())),
    );
    let disagreement = (of_a + of_b).cholesky()?.solve(&apart).dot(&apart);
    if disagreement > MAX_DISAGREEMENT {
        return None;
    }
    let [information_a, information_b] = [of_a.try_inverse()?, of_b.try_inverse()?];
    let covariance = (information_a + information_b).try_inverse()?;
    let (shift, turn) = se3::split(&(covariance * information_b * apart));
    let rotation = UnitQuaternion::new_normalize((so3::exp(&turn) * a.rotation).into_inner());
    let pose = Pose::new(a.translation + shift, rotation);
    Some((pose, covariance * 2.0))
}
