//! Where an adjusted map lies.
//!
//! Landmarks and odometry say how poses stand to each other; as one body they could be anywhere. So one pose stays while
//! the others are adjusted, and then its own error is everybody's: where it was wrong by half a milliradian, what is 30 m
//! away is put off by 15 mm, though nothing there has changed. Afterwards the map is moved as one body to where most of
//! its frames were. Distances are added up, not their squares: where a bend was straightened, the frames that were right
//! stay, and those that were not move.
//!
//! A free network in geodesy's words, with a datum of many points: Baarda, *S-transformations and criterion matrices*
//! (1973). The least sum of distances is found by weights: Weiszfeld, *Sur le point pour lequel la somme des distances de
//! n points donnés est minimum* (1937).

use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

use super::Map;
use crate::geometry::lie::{hat, se3};
use crate::geometry::pose::Pose;
use crate::metric_map::bundle_adjustment::SEEN_M;

/// A motion that is sought no longer, metres and radians.
const SETTLED: f64 = 1e-9;

/// Distances below this weigh alike, metres: what adjustment does not tell apart.
const NEAR_M: f64 = 1e-4;

/// Steps at most; weights settle by about a third in each.
const STEPS: usize = 100;

/// The rigid motion after which poses `now` are nearest to where they were `before`, pose by pose. Identity without poses.
pub(super) fn motion_back(before: &[Pose], now: &[Pose]) -> Pose {
    let pairs = before.iter().zip(now);
    let pairs: Vec<_> = pairs
        .flat_map(|(before, now)| marks(before).into_iter().zip(marks(now)))
        .collect();
    // About their middle, so that turns and moves are told apart.
    let middle =
        pairs.iter().map(|(before, _)| before).sum::<Vector3<f64>>() / pairs.len().max(1) as f64;
    let mut motion = Pose::identity();
    for _ in 0..STEPS {
        let Some(step) = step(&pairs, &middle, &motion) else {
            break;
        };
        let about = Pose::new(middle, Pose::identity().rotation);
        let moved = about.compose(&se3::exp(&step)).compose(&about.inverse());
        motion = moved.compose(&motion);
        if step.amax() < SETTLED {
            break;
        }
    }
    motion
}

/// A pose, and what is about as far away ahead, to the left and above as what it sees.
fn marks(pose: &Pose) -> [Vector3<f64>; 4] {
    let arms = [Vector3::zeros(), Vector3::x(), Vector3::y(), Vector3::z()];
    arms.map(|arm| pose.transform(&(arm * SEEN_M)))
}

/// The twist about `middle` that brings moved marks nearest to where they were; far ones count by their distance alone.
fn step(
    pairs: &[(Vector3<f64>, Vector3<f64>)],
    middle: &Vector3<f64>,
    motion: &Pose,
) -> Option<Vector6<f64>> {
    let (mut normal, mut right) = (Matrix6::zeros(), Vector6::zeros());
    for (before, now) in pairs {
        let moved = motion.transform(now);
        let off = before - moved;
        let weight = 1.0 / off.norm().max(NEAR_M);
        // A mark at `x` from the middle moves by `ρ + φ × x`.
        let turned = -hat(&(moved - middle));
        let corner = turned.transpose() * weight;
        for (row, column, block) in [
            (0, 0, Matrix3::identity() * weight),
            (0, 3, turned * weight),
            (3, 0, corner),
            (3, 3, corner * turned),
        ] {
            let mut into = normal.fixed_view_mut::<3, 3>(row, column);
            into += block;
        }
        right += se3::join(&(off * weight), &(corner * off));
    }
    Some(normal.cholesky()?.solve(&right))
}

impl Map {
    /// Moves the map as one body.
    pub(super) fn moved(&mut self, motion: &Pose) {
        for pose in &mut self.poses {
            *pose = motion.compose(pose);
        }
        for landmark in &mut self.landmarks {
            landmark.point = motion.transform(&landmark.point);
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn ring(poses: usize) -> Vec<Pose> {
        let turn = std::f64::consts::TAU / poses as f64;
        (0..poses)
            .map(|at| at as f64 * turn)
            .map(|angle| Pose::from_yaw(20.0 * angle.cos(), 20.0 * angle.sin(), angle))
            .collect()
    }

    fn far_m(a: &[Pose], b: &[Pose]) -> Vec<f64> {
        let pairs = a.iter().zip(b);
        pairs
            .map(|(a, b)| (a.translation - b.translation).norm())
            .collect()
    }

    #[test]
    fn a_map_that_moved_as_one_body_is_where_it_was() {
        let before = ring(40);
        let away = se3::exp(&Vector6::new(0.3, -0.2, 0.1, 0.01, -0.02, 0.05));
        let now: Vec<Pose> = before.iter().map(|pose| away.compose(pose)).collect();
        let back = motion_back(&before, &now);
        assert!(se3::log(&back.compose(&away)).amax() < 1e-7);
        assert_eq!(motion_back(&[], &[]), Pose::identity());
    }

    #[test]
    fn what_was_corrected_moves_and_the_rest_stays() {
        let before = ring(40);
        let away = se3::exp(&Vector6::new(0.0, 0.0, 0.0, 0.0, 0.0, 5e-4));
        let mut now: Vec<Pose> = before.iter().map(|pose| away.compose(pose)).collect();
        for pose in &mut now[30..] {
            pose.translation.x += 0.5;
        }
        let back = motion_back(&before, &now);
        let moved: Vec<Pose> = now.iter().map(|pose| back.compose(pose)).collect();
        let far_m = far_m(&before, &moved);
        assert!(far_m[..30].iter().all(|m| *m < 1e-3), "{far_m:?}");
        assert!(
            far_m[30..].iter().all(|m| (*m - 0.5).abs() < 1e-3),
            "{far_m:?}"
        );
    }

    #[test]
    fn the_sum_of_distances_is_least() {
        let before = ring(12);
        let mut now = before.clone();
        for (at, pose) in now.iter_mut().enumerate() {
            pose.translation.y += 0.01 * ((at * 7 % 5) as f64 - 1.0);
            *pose = pose.compose(&Pose::from_yaw(
                0.0,
                0.0,
                1e-3 * ((at * 3 % 4) as f64 - 1.0),
            ));
        }
        let sum = |motion: &Pose| -> f64 {
            let pairs = before.iter().zip(&now);
            let marks = pairs.flat_map(|(before, now)| marks(before).into_iter().zip(marks(now)));
            marks
                .map(|(before, now)| (before - motion.transform(&now)).norm())
                .sum()
        };
        let back = motion_back(&before, &now);
        let least = sum(&back);
        assert!(least < sum(&Pose::identity()));
        for axis in 0..6 {
            for by in [-3e-3, 3e-3] {
                let mut twist = Vector6::zeros();
                twist[axis] = by;
                assert!(sum(&se3::exp(&twist).compose(&back)) > least);
            }
        }
    }

    #[test]
    fn poses_on_a_line_do_not_turn_about_it() {
        let before: Vec<Pose> = (0..10)
            .map(|at| Pose::from_yaw(f64::from(at), 0.0, 0.0))
            .collect();
        let away = se3::exp(&Vector6::new(0.0, 0.0, 0.0, 0.01, 0.0, 0.0));
        let now: Vec<Pose> = before.iter().map(|pose| away.compose(pose)).collect();
        let back = motion_back(&before, &now);
        assert!(se3::log(&back.compose(&away)).amax() < 1e-7);
    }
}
