//! Where to begin.

use std::f64::consts::TAU;

use nalgebra::{UnitQuaternion, Vector3};

use super::Options;
use super::alignment::{Estimate, Fit};
use crate::geometry::pose::Pose;

/// From a start half as far away as this (m), in each direction, the coarsest size finds what is there.
const STEP_M: f64 = 3.0;
/// And from one turned by half as much (rad): a street bends by this within 5 m at a radius of 14 m, a narrow corner.
const STEP_RAD: f64 = 0.35;

/// An estimate, how it fits, and whether it rests.
pub(super) type Aligned = (Estimate, Fit, bool);

/// Estimates to begin with: around the guess, as far as panoramas may be apart, places on the ground and a turn to either
/// side; without one, all headings.
pub(super) fn starts(guess: Option<&Pose>, options: &Options) -> Vec<Estimate> {
    let turns = if guess.is_some() {
        (-1..=1).map(|turn| f64::from(turn) * STEP_RAD).collect()
    } else {
        let all = (TAU / STEP_RAD).ceil() as u32;
        let turned = |turn| f64::from(turn) * TAU / f64::from(all);
        (0..all).map(turned).collect::<Vec<f64>>()
    };
    let guess = guess.copied().unwrap_or_else(Pose::identity);
    let places = (options.reach_m / STEP_M).floor() as i32;
    let mut starts = Vec::new();
    for right in -places..=places {
        for ahead in -places..=places {
            for turn in &turns {
                let away = Vector3::new(f64::from(right), 0.0, f64::from(ahead)) * STEP_M;
                let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), *turn);
                let pose = Pose::new(guess.translation + away, guess.rotation * turn);
                starts.push(Estimate {
                    other_from_reference: pose.inverse(),
                    brightness: [1.0, 0.0],
                });
            }
        }
    }
    starts
}

/// Estimates closer to each other than this (m) are of one place: what several starts have come to.
const ONE_PLACE_M: f64 = 0.3;

/// The places that go on from a size to the next finer one, of estimates with the best first: two at the finest, so that
/// the second says whether there is a choice.
pub(super) fn kept(size: usize, sizes: usize, aligned: Vec<Aligned>) -> Vec<Aligned> {
    let most = match sizes - size {
        1 => 6,
        2 => 4,
        3 => 3,
        _ => 2,
    };
    let at = |aligned: &Aligned| aligned.0.other_from_reference.inverse().translation;
    let mut kept: Vec<Aligned> = Vec::with_capacity(most);
    for one in aligned {
        let known = |known: &Aligned| (at(known) - at(&one)).norm() <= ONE_PLACE_M;
        if kept.len() < most && !kept.iter().any(known) {
            kept.push(one);
        }
    }
    kept
}
