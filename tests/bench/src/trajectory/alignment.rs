//! The motion that lays one set of points onto another.
//!
//! Umeyama, "Least-squares estimation of transformation parameters between two point patterns",
//! PAMI 1991, equations 34 to 43.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::PosePair;
use evermap_algorithms::geometry::pose::Pose;

/// How much orientations count beside positions in [`align`]: as much as points this far from
/// each pose, metres. Little enough not to move an alignment that the positions fix, enough to
/// fix the roll about a straight line.
const LEVER_M: f64 = 1e-3;

/// A rigid motion with a change of size: `target = scale * rotation * source + translation`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Similarity {
    /// Rotation and translation (metres of the target).
    pub pose: Pose,
    /// Metres of the target per metre of the source.
    pub scale: f64,
}

impl Similarity {
    /// A point of the source in the target.
    pub fn transform(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.pose.rotation * (self.scale * point) + self.pose.translation
    }
}

/// `truth_from_estimate`: the rigid motion that brings the estimated positions nearest to the true
/// ones in the sense of least squares. Orientations decide only what positions leave open, the
/// roll about a straight drive.
///
/// `None` without pairs, or where a number is not finite.
pub fn align(pairs: &[PosePair]) -> Option<Pose> {
    let source: Vec<_> = pairs.iter().map(|pair| pair.estimate.translation).collect();
    let target: Vec<_> = pairs.iter().map(|pair| pair.truth.translation).collect();
    let moments = Moments::new(&source, &target)?;
    let turned = pairs.iter().map(|pair| {
        let truth = pair.truth.rotation.to_rotation_matrix().into_inner();
        let estimate = pair.estimate.rotation.to_rotation_matrix().into_inner();
        truth * estimate.transpose()
    });
    let orientations = turned.sum::<Matrix3<f64>>() * (LEVER_M * LEVER_M / pairs.len() as f64);
    let (rotation, _) = rotation_of(&(moments.covariance + orientations))?;
    Some(moments.pose(rotation, 1.0))
}

/// The rigid motion from `source` to `target` (points of equal index belong together, metres).
/// Where all points lie on a line, the roll about it is arbitrary.
///
/// `None` without points, for lists of different length, or where a number is not finite.
pub fn align_points(source: &[Vector3<f64>], target: &[Vector3<f64>]) -> Option<Pose> {
    let moments = Moments::new(source, target)?;
    let (rotation, _) = rotation_of(&moments.covariance)?;
    Some(moments.pose(rotation, 1.0))
}

/// The rigid motion with a change of size from `source` to `target`, as [`align_points`].
///
/// `None` also where all points of the source are one: they have no size to change.
pub fn align_points_scaled(source: &[Vector3<f64>], target: &[Vector3<f64>]) -> Option<Similarity> {
    let moments = Moments::new(source, target)?;
    let (rotation, trace) = rotation_of(&moments.covariance)?;
    let scale = trace / moments.source_variance;
    if !scale.is_finite() || scale <= 0.0 {
        return None;
    }
    Some(Similarity {
        pose: moments.pose(rotation, scale),
        scale,
    })
}

/// Means, and second moments about them.
struct Moments {
    source_mean: Vector3<f64>,
    target_mean: Vector3<f64>,
    source_variance: f64,
    /// Mean of `target * sourceᵀ`.
    covariance: Matrix3<f64>,
}

impl Moments {
    fn new(source: &[Vector3<f64>], target: &[Vector3<f64>]) -> Option<Self> {
        if source.is_empty() || source.len() != target.len() {
            return None;
        }
        let n = source.len() as f64;
        let source_mean = source.iter().sum::<Vector3<f64>>() / n;
        let target_mean = target.iter().sum::<Vector3<f64>>() / n;
        let mut covariance = Matrix3::zeros();
        let mut source_variance = 0.0;
        for (from, to) in source.iter().zip(target) {
            let from = from - source_mean;
            covariance += (to - target_mean) * from.transpose() / n;
            source_variance += from.norm_squared() / n;
        }
        let finite = covariance.iter().all(|value| value.is_finite())
            && source_mean
                .iter()
                .chain(&target_mean)
                .all(|value| value.is_finite());
        finite.then_some(Self {
            source_mean,
            target_mean,
            source_variance,
            covariance,
        })
    }

    fn pose(&self, rotation: UnitQuaternion<f64>, scale: f64) -> Pose {
        let translation = self.target_mean - rotation * (scale * self.source_mean);
        Pose::new(translation, rotation)
    }
}

/// The rotation that is nearest to a matrix, and the trace of what is left of it (Umeyama, 40 and
/// 42).
fn rotation_of(covariance: &Matrix3<f64>) -> Option<(UnitQuaternion<f64>, f64)> {
    // The decomposition works to an absolute precision; small motions need a relative one.
    let size = covariance.amax();
    if size <= f64::MIN_POSITIVE {
        return Some((UnitQuaternion::identity(), 0.0));
    }
    let svd = (covariance / size).try_svd(true, true, f64::EPSILON, 1000)?;
    let (u, v_t) = (svd.u?, svd.v_t?);
    // Singular values come sorted; a mirror image is undone along the smallest.
    let sign = if u.determinant() * v_t.determinant() < 0.0 {
        -1.0
    } else {
        1.0
    };
    let mirror = Vector3::new(1.0, 1.0, sign);
    let rotation = u * Matrix3::from_diagonal(&mirror) * v_t;
    let rotation = Rotation3::from_matrix_unchecked(rotation);
    let trace = size * svd.singular_values.dot(&mirror);
    Some((UnitQuaternion::from_rotation_matrix(&rotation), trace))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use proptest::prelude::*;

    fn vectors(size: f64) -> impl Strategy<Value = Vector3<f64>> {
        prop::array::uniform3(-size..size).prop_map(Vector3::from)
    }

    fn poses() -> impl Strategy<Value = Pose> {
        (vectors(50.0), vectors(3.0))
            .prop_map(|(t, r)| Pose::new(t, UnitQuaternion::from_scaled_axis(r)))
    }

    fn squares(pose: &Pose, source: &[Vector3<f64>], target: &[Vector3<f64>]) -> f64 {
        let pairs = source.iter().zip(target);
        pairs
            .map(|(a, b)| (pose.transform(a) - b).norm_squared())
            .sum()
    }

    proptest! {
        #[test]
        fn a_motion_is_found_again(
            pose in poses(), scale in 0.1..10.0f64, points in prop::collection::vec(vectors(20.0), 4..30)
        ) {
            let similarity = Similarity { pose, scale };
            let moved: Vec<_> = points.iter().map(|p| similarity.transform(p)).collect();
            let found = align_points_scaled(&points, &moved).unwrap();
            prop_assert!((found.scale / scale - 1.0).abs() < 1e-9);
            for (from, to) in points.iter().zip(&moved) {
                prop_assert!((found.transform(from) - to).norm() < 1e-8);
            }
        }

        #[test]
        fn no_motion_nearby_is_better(
            source in prop::collection::vec(vectors(20.0), 3..20), noise in vectors(3.0),
            pose in poses(), step in vectors(0.1), turn in vectors(0.1)
        ) {
            let target: Vec<_> = source.iter().enumerate()
                .map(|(k, p)| pose.transform(p) + noise * (k as f64 * 2.3).sin()).collect();
            let best = align_points(&source, &target).unwrap();
            let beside = Pose::new(best.translation + step, UnitQuaternion::from_scaled_axis(turn) * best.rotation);
            let gap = squares(&beside, &source, &target) - squares(&best, &source, &target);
            prop_assert!(gap > -1e-9, "{gap}");
        }

        #[test]
        fn orientations_fix_the_roll_about_a_line(pose in poses(), way in vectors(1.0)) {
            prop_assume!(way.norm() > 0.1);
            let pairs: Vec<_> = (0..20).map(|k| {
                let estimate = Pose::new(way * f64::from(k), UnitQuaternion::from_euler_angles(0.1, 0.2, 0.3));
                PosePair { stamp_ns: k.into(), truth: pose.compose(&estimate), estimate }
            }).collect();
            let found = align(&pairs).unwrap();
            prop_assert!(found.rotation.angle_to(&pose.rotation) < 1e-6);
            prop_assert!((found.translation - pose.translation).norm() < 1e-6);
        }

        #[test]
        fn nothing_panics(source in prop::collection::vec(prop::array::uniform3(any::<f64>()), 0..6)) {
            let points: Vec<_> = source.into_iter().map(Vector3::from).collect();
            let target: Vec<_> = points.iter().rev().copied().collect();
            if let Some(pose) = align_points(&points, &target) {
                prop_assert!((pose.rotation.norm() - 1.0).abs() < 1e-6);
            }
            let _ = align_points_scaled(&points, &target);
        }
    }

    #[test]
    fn one_point_is_moved_and_a_mirror_image_is_not_made() {
        let here = [Vector3::new(1.0, 2.0, 3.0)];
        let there = [Vector3::new(4.0, 4.0, 4.0)];
        let pose = align_points(&here, &there).unwrap();
        assert_eq!(pose.rotation, UnitQuaternion::identity());
        assert!((pose.transform(&here[0]) - there[0]).norm() < 1e-12);
        assert!(align_points_scaled(&here, &there).is_none());
        assert!(align_points(&[], &[]).is_none());
        assert!(align_points(&here, &[]).is_none());
        let corner = [
            Vector3::x(),
            Vector3::y() * 2.0,
            Vector3::z() * 3.0,
            Vector3::zeros(),
        ];
        let mirrored = corner.map(|p| Vector3::new(-p.x, p.y, p.z));
        let pose = align_points(&corner, &mirrored).unwrap();
        let matrix = pose.rotation.to_rotation_matrix();
        assert!((matrix.matrix().determinant() - 1.0).abs() < 1e-9);
    }
}
