//! Walkers at the zebra crossings. They look before they step out: the whole drive is known, so
//! they cross only while the vehicle stays away.

use super::CarPark;
use super::layout::{Crossing, Layout};
use crate::plane::{Pose2, between, distance, heading};
use crate::random::stream;
use crate::render::Solid;
use crate::vehicle::Ground;
use crate::vehicle::Trajectory;
use evermap_algorithms::geometry::pose::Pose;
use nalgebra::{UnitQuaternion, Vector3};
use rand::Rng;
use std::f64::consts::PI;

/// Walking speed, m/s.
const PACE_MPS: f64 = 1.35;
/// The vehicle's middle must stay this far from a crossing in use, metres.
const CLEAR_M: f64 = 3.6;
/// Length of one full step cycle, metres.
const STRIDE_M: f64 = 1.4;

/// One way across.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Trip {
    start_s: f64,
    end_s: f64,
    from: [f64; 2],
    to: [f64; 2],
}

/// A person with an errand.
#[derive(Debug, Clone, PartialEq)]
pub struct Walker {
    trips: Vec<Trip>,
    home: [f64; 2],
    facing: f64,
    /// Body height, metres.
    pub height_m: f64,
    /// Grey of coat, trousers and head.
    pub greys: [u8; 3],
}

/// Where a walker is at an instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WalkerState {
    /// Where they are, and which way they look.
    pub pose: Pose2,
    /// Whether they walk rather than stand.
    pub walking: bool,
    /// Distance walked on this trip, metres.
    pub walked_m: f64,
}

/// The walkers of a session; the initial drive has none.
pub fn walkers(
    world: &CarPark,
    layout: &Layout,
    session: usize,
    drive: &Trajectory,
) -> Vec<Walker> {
    if session == 0 {
        return Vec::new();
    }
    (0..world.walkers)
        .filter_map(|index| {
            let crossings = &layout.crossings;
            let crossing = crossings.get((index + session) % crossings.len())?;
            Some(walker(world, session, index, crossing, drive))
        })
        .collect()
}

fn walker(
    world: &CarPark,
    session: usize,
    index: usize,
    crossing: &Crossing,
    drive: &Trajectory,
) -> Walker {
    let mut rng = stream(world.seed, "walker", (session * 64 + index) as u64);
    let shift = [-0.42, 0.0, 0.42][index / 2 % 3] + rng.random_range(-0.1..0.1);
    let back = 0.7 * (index / 2) as f64;
    let away = (crossing.island[1] - crossing.wall[1]).signum();
    let beside = |[x, y]: [f64; 2], on: f64| [x + shift, y + on];
    let mut ends = [
        beside(crossing.island, away * back),
        beside(crossing.wall, -away * 0.3 * back),
    ];
    if rng.random_bool(0.5) {
        ends.swap(0, 1);
    }
    let home = ends[0];
    let span = distance(ends[0], ends[1]) / PACE_MPS;
    let mut trips = Vec::new();
    let mut now: f64 = rng.random_range(0.0..6.0);
    while now < drive.duration_s() {
        if is_clear(crossing, drive, now, span) {
            trips.push(Trip {
                start_s: now,
                end_s: now + span,
                from: ends[0],
                to: ends[1],
            });
            ends.swap(0, 1);
            now += span + rng.random_range(1.0..7.0);
        } else {
            now += 0.5;
        }
    }
    let turned = if trips.len() % 2 == 0 { 0.0 } else { PI };
    Walker {
        facing: heading(home, ends[1]) + turned,
        trips,
        home,
        height_m: rng.random_range(1.58..1.88),
        greys: [
            rng.random_range(25..235),
            rng.random_range(20..130),
            rng.random_range(120..210),
        ],
    }
}

/// Whether the vehicle stays away from the crossing from `now` until `span` seconds later, with
/// a second and a half to spare on both sides.
fn is_clear(crossing: &Crossing, drive: &Trajectory, now: f64, span: f64) -> bool {
    let r = crossing.rect;
    let steps = ((span + 3.0) / 0.1) as usize;
    (0..=steps).all(|k| {
        let at = drive.motion(now - 1.5 + 0.1 * k as f64);
        let [x, y] = at.pose.point([1.3, 0.0]);
        let dx = (r.x0 - x).max(x - r.x1).max(0.0);
        let dy = (r.y0 - y).max(y - r.y1).max(0.0);
        dx.hypot(dy) > CLEAR_M
    })
}

impl Walker {
    /// Where the walker is `t` seconds after the session's start.
    pub fn state(&self, t: f64) -> WalkerState {
        let next = self.trips.partition_point(|trip| trip.start_s <= t);
        let Some(trip) = next.checked_sub(1).and_then(|k| self.trips.get(k)) else {
            return WalkerState {
                pose: Pose2::new(self.home, self.facing),
                walking: false,
                walked_m: 0.0,
            };
        };
        let f = ((t - trip.start_s) / (trip.end_s - trip.start_s)).clamp(0.0, 1.0);
        let at = between(trip.from, trip.to, f);
        WalkerState {
            pose: Pose2::new(at, heading(trip.from, trip.to)),
            walking: t < trip.end_s,
            walked_m: f * distance(trip.from, trip.to),
        }
    }

    /// The walker's body at an instant; `faces` are those of coat, trousers and head.
    pub fn solids(&self, t: f64, ground: &Ground, faces: [u16; 3]) -> Vec<Solid> {
        let state = self.state(t);
        let swing = if state.walking {
            0.45 * (2.0 * PI * state.walked_m / STRIDE_M).sin()
        } else {
            0.0
        };
        let h = self.height_m;
        let (hip, shoulder) = (0.48 * h, 0.81 * h);
        let [coat, trousers, skin] = faces;
        let torso = ([-0.12, -0.2, 0.0], [0.12, 0.2, shoulder - hip]);
        let head = ([-0.1, -0.085, 0.0], [0.11, 0.085, 0.15 * h]);
        let leg = ([-0.075, -0.075, -hip], [0.075, 0.075, 0.0]);
        let arm = ([-0.05, -0.045, -0.36 * h], [0.05, 0.045, 0.0]);
        // Where it hangs (to the left and up), how far it swings, and the box around it there.
        let limbs = [
            ([0.0, hip], 0.0, torso, coat),
            ([0.0, 0.85 * h], 0.0, head, skin),
            ([0.1, hip], swing, leg, trousers),
            ([-0.1, hip], -swing, leg, trousers),
            ([0.25, shoulder], -0.8 * swing, arm, coat),
            ([-0.25, shoulder], 0.8 * swing, arm, coat),
        ];
        let body = state.pose.upright(ground.height(state.pose.y));
        let limb = |([left, up], pitch, (low, high), face): ([f64; 2], f64, _, u16)| {
            let swung = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), pitch);
            let pivot = body.transform(&Vector3::new(0.0, left, up));
            let stand = Pose::new(pivot, body.rotation * swung);
            Solid::cuboid(&stand, low, high, [face; 6])
        };
        limbs.map(limb).to_vec()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use crate::car_park::Route;

    #[test]
    fn walkers_walk_and_are_never_run_over() {
        let world = CarPark::default();
        let layout = Layout::new(&world);
        for session in 1..4 {
            let path = Route::of_session(&world, session).path(&layout, 0.0, 2.0);
            let drive = Trajectory::new(path, world.speed_mps, layout.ground);
            let people = walkers(&world, &layout, session, &drive);
            assert_eq!(people.len(), world.walkers);
            let mut walked = 0;
            for k in 0..(drive.duration_s() * 10.0) as usize {
                let t = 0.1 * k as f64;
                let at = drive.motion(t);
                for person in &people {
                    let state = person.state(t);
                    walked += usize::from(state.walking);
                    for along in [-0.6, 1.3, 3.2] {
                        let away = distance(state.pose.at(), at.pose.point([along, 0.0]));
                        assert!(away > 1.5, "{away} m at {t} s of session {session}");
                    }
                }
            }
            assert!(walked > 50, "nobody walks in session {session}");
        }
    }
}
