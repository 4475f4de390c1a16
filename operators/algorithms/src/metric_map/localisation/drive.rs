//! A whole drive: from keyframe to keyframe by odometry, lost and found, forwards and backwards.

use std::ops::Range;

use super::evidence::Evidence;
use super::fix::{Doubt, Fix, Localiser};
use super::motion::{Guess, Odometer, difference};
use crate::geometry::pose::Pose;
use crate::metric_map::features::KeyframeFeatures;

/// Keyframes without a fix in a row after which the place is recognised anew; odometry goes on meanwhile.
const MOST_MISSES: usize = 3;
/// Two poses of one keyframe are two places when they are this far apart, metres and radians.
const OTHER_PLACE_M: f64 = 0.5;
const OTHER_PLACE_RAD: f64 = 0.1;
/// A place with more than this share of the best one's inliers is a second explanation.
const RIVAL_SHARE: f64 = 0.6;
/// While lost, a keyframe is tried only this far down the road from the last that was, metres.
const RETRY_M: f64 = 0.4;

/// One keyframe of the drive.
#[derive(Debug, Clone, Copy)]
pub struct DriveKeyframe<'a> {
    /// The vehicle in the frame of its odometry.
    pub odom_from_vehicle: Pose,
    /// What its cameras saw, in the rig's order.
    pub features: &'a KeyframeFeatures,
}

/// What is known of a keyframe's pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum State {
    /// Found near the guess of odometry.
    Localised,
    /// Found by its place, without a guess, and confirmed by the keyframes beside it.
    Recovered,
    /// Not known.
    Lost,
}

/// The result for one keyframe.
#[derive(Debug, Clone, PartialEq)]
pub struct KeyframeLocalisation {
    /// Whether its pose is known.
    pub state: State,
    /// The fix; where lost, the last one tried, if any: it says what was missing.
    pub fix: Option<Fix>,
}

/// Proposes poses for a keyframe of which nothing is known: none, one, or several to choose from.
pub trait Recognise {
    /// `map_from_vehicle`, the likeliest first.
    fn propose(&self, features: &KeyframeFeatures) -> Vec<Pose>;
}

/// Fixes that hang off each other by odometry.
struct Walk {
    odometer: Odometer,
    /// In order of driving, or against it.
    fixes: Vec<(usize, Fix)>,
    misses: Vec<(usize, Fix)>,
}

struct DriveLocalisation<'a> {
    localiser: &'a Localiser<'a>,
    evidence: Evidence<'a>,
    keyframes: &'a [DriveKeyframe<'a>],
    odometer: Odometer,
    found: Vec<KeyframeLocalisation>,
}

impl Localiser<'_> {
    /// Localises a drive, whose keyframes are in order of time. One result per keyframe.
    pub fn localise(
        &self,
        keyframes: &[DriveKeyframe<'_>],
        places: &dyn Recognise,
    ) -> Vec<KeyframeLocalisation> {
        let lost = KeyframeLocalisation {
            state: State::Lost,
            fix: None,
        };
        let mut drive = DriveLocalisation {
            localiser: self,
            evidence: Evidence::new(self),
            keyframes,
            odometer: Odometer::new(),
            found: vec![lost; keyframes.len()],
        };
        if !self.map.is_empty() {
            drive.run(places);
        }
        drive.found
    }
}

impl DriveLocalisation<'_> {
    fn run(&mut self, places: &dyn Recognise) {
        let mut next = 0;
        while next < self.keyframes.len() {
            let Some(fix) = self.recover(next, places) else {
                next = self.further(next);
                continue;
            };
            let (start, learned) = (fix.pose, self.odometer);
            self.set(next, State::Recovered, fix);
            let mut stretch = vec![next];
            let ahead = self.walk(next, start, false, usize::MAX);
            let last = ahead.fixes.last().map_or(next, |(index, _)| *index);
            stretch.extend(self.publish(ahead));
            let behind = self.walk(next, start, true, usize::MAX);
            stretch.extend(self.publish(behind));
            stretch.sort_unstable();
            match self.believed(&stretch) {
                Ok(sure) => {
                    stretch.retain(|index| !sure.contains(index));
                    self.hold_back(&stretch, Doubt::Undecided);
                }
                Err(doubt) => {
                    self.hold_back(&stretch, doubt);
                    self.odometer = learned;
                }
            }
            next = last + 1;
        }
    }

    /// The keyframes of a stretch that are believed, or why fixes that agree with each other are not all the same.
    fn believed(&self, stretch: &[usize]) -> Result<Range<usize>, Doubt> {
        let ahead = self.localiser.params.evidence_places;
        if ahead == 0 {
            return Ok(0..self.keyframes.len());
        }
        let fix = |index: &usize| Some((*index, self.found[*index].fix.as_ref()?));
        let fixes: Vec<(usize, &Fix)> = stretch.iter().filter_map(fix).collect();
        self.evidence.believed(self.keyframes, &fixes, ahead)
    }

    fn hold_back(&mut self, stretch: &[usize], doubt: Doubt) {
        for index in stretch {
            let held = &mut self.found[*index];
            held.state = State::Lost;
            if let Some(fix) = &mut held.fix {
                fix.doubt = Some(doubt);
            }
        }
    }

    /// Whether the keyframe is part of a stretch: one that is localised, or one of another place.
    fn is_settled(&self, index: usize) -> bool {
        let found = &self.found[index];
        let doubt = found.fix.as_ref().and_then(|fix| fix.doubt);
        found.state != State::Lost || doubt == Some(Doubt::AnotherPlace)
    }

    /// The next keyframe that is far enough from this one for another try.
    fn further(&self, from: usize) -> usize {
        let here = self.keyframes[from].odom_from_vehicle.translation;
        let away = |keyframe: &DriveKeyframe<'_>| {
            let distance = (keyframe.odom_from_vehicle.translation - here).norm();
            distance >= RETRY_M || distance.is_nan()
        };
        let rest = &self.keyframes[from + 1..];
        from + 1 + rest.iter().position(away).unwrap_or(rest.len())
    }

    fn set(&mut self, index: usize, state: State, fix: Fix) {
        self.found[index] = KeyframeLocalisation {
            state,
            fix: Some(fix),
        };
    }

    /// Publishes a walk; gives the keyframes that have a fix.
    fn publish(&mut self, walk: Walk) -> Vec<usize> {
        self.odometer = walk.odometer;
        for (index, fix) in walk.misses {
            self.found[index].fix = Some(fix);
        }
        let fixed = walk.fixes.iter().map(|(index, _)| *index).collect();
        for (index, fix) in walk.fixes {
            self.set(index, State::Localised, fix);
        }
        fixed
    }

    /// Tries to recognise a keyframe's place. Believed when no other place explains it nearly as well, and the
    /// keyframes beside it agree.
    fn recover(&mut self, index: usize, places: &dyn Recognise) -> Option<Fix> {
        let features = self.keyframes[index].features;
        let proposed = places.propose(features);
        let mut tried: Vec<Fix> = proposed
            .iter()
            .map(|place| self.localiser.fix_at_place(place, features))
            .collect();
        tried.sort_by_key(|fix| std::cmp::Reverse((fix.is_sound(), fix.inliers.len())));
        let best = tried.first()?.clone();
        if self.found[index].state == State::Lost {
            self.found[index].fix = Some(best.clone());
        }
        let rival = |other: &&Fix| {
            elsewhere(&best.pose.pose, &other.pose.pose)
                && other.inliers.len() as f64 > RIVAL_SHARE * best.inliers.len() as f64
        };
        if !best.is_sound() || tried.iter().any(|other| rival(&other)) {
            return None;
        }
        self.confirmed(index, &best).then_some(best)
    }

    /// Whether enough of the keyframes ahead, or else behind, are localised from this one.
    fn confirmed(&self, index: usize, fix: &Fix) -> bool {
        let need = self.localiser.params.confirmations;
        let within = need + need.div_ceil(2);
        [false, true].into_iter().any(|backwards| {
            let walk = self.walk(index, fix.pose, backwards, within);
            walk.fixes.len() >= need
        })
    }

    /// From a fix on, keyframe by keyframe, until the guess is too uncertain, too many have no fix, a keyframe is reached
    /// that is settled, or `most` were visited.
    fn walk(&self, start: usize, at: Guess, backwards: bool, most: usize) -> Walk {
        let params = &self.localiser.params;
        let mut walk = Walk {
            odometer: self.odometer,
            fixes: Vec::new(),
            misses: Vec::new(),
        };
        let (mut last, mut at, mut missed, mut index) = (start, at, 0, start);
        for _ in 0..most {
            let Some(next) = self.next(index, backwards) else {
                break;
            };
            index = next;
            let odometry = [last, index].map(|at| &self.keyframes[at].odom_from_vehicle);
            let guess = walk.odometer.guess(&at, odometry, backwards, params);
            // Also where it is no number.
            let near = guess.sigma_m() <= params.give_up_m;
            if self.is_settled(index) || !near || missed > MOST_MISSES {
                break;
            }
            let fix = self.localiser.fix(&guess, self.keyframes[index].features);
            if fix.is_sound() {
                let poses = [&at.pose, &fix.pose.pose];
                walk.odometer.learn_either_way(odometry, poses, backwards);
                (last, at, missed) = (index, fix.pose, 0);
                walk.fixes.push((index, fix));
            } else {
                missed += 1;
                walk.misses.push((index, fix));
            }
        }
        walk.drop_lone(start);
        walk
    }

    fn next(&self, index: usize, backwards: bool) -> Option<usize> {
        let next = if backwards {
            index.checked_sub(1)?
        } else {
            index + 1
        };
        (next < self.keyframes.len()).then_some(next)
    }
}

impl Walk {
    /// A fix without another among the two keyframes before and the two after it does not count.
    fn drop_lone(&mut self, start: usize) {
        let mut sound: Vec<usize> = self.fixes.iter().map(|(index, _)| *index).collect();
        sound.push(start);
        let near = |index: usize| {
            sound
                .iter()
                .any(|other| (1..=2).contains(&other.abs_diff(index)))
        };
        let (kept, lone) = std::mem::take(&mut self.fixes)
            .into_iter()
            .partition(|(index, _)| near(*index));
        self.fixes = kept;
        self.misses.extend(lone);
    }
}

fn elsewhere(a: &Pose, b: &Pose) -> bool {
    let off = difference(a, b);
    off.fixed_rows::<3>(0).norm() > OTHER_PLACE_M || off.fixed_rows::<3>(3).norm() > OTHER_PLACE_RAD
}
