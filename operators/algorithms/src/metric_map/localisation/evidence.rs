//! Whether a stretch of a drive is of the mapped place, or of another one that is laid out alike.
//!
//! Car parks are built from one drawing, terraces from one plan: lines, pillars and lamps are where they are here, a
//! keyframe's fix has inliers enough, and all of it agrees with odometry. What differs is what nobody drew: stains,
//! wear, posters. So a second question is asked of features, one that the pose has no part in: *which landmark of the
//! whole map does this feature show?* It is answered where one landmark is clearly more alike than all that lie
//! elsewhere. Here, answers point to where the feature was seen. Elsewhere they point anywhere: what was drawn is found
//! all over the map, so that no answer is clear, and what was not drawn is in the map only by accident, anywhere in it.
//!
//! **One place.** Answers that agree with the fix's pose are counted against those that do not. The latter are accidents,
//! at home and abroad: as many answers must be expected to be wrong as are seen to be, so that they are the measure of
//! what agreement is worth. What lies in one direction stands or falls together (a gate seen by two cameras, a sign's
//! twenty corners) and counts once. A place is *for* the map when more directions agree than do not, else *against* it.
//! How many landmarks are not seen is no measure: an image has 500 features and thousands of landmarks, of which nineteen
//! in twenty are missed at home, too; what is not recognised where it should be lowers the first count.
//!
//! **A stretch.** Even another place has a spot that is the same (a gate with its name on it), for some metres. Places
//! some metres apart are nearly independent, and the count over them is Wald's sequential test (*Sequential tests of
//! statistical hypotheses*, 1945): at home three places in four are for the map at least, elsewhere one in four at most,
//! so each is worth a factor of 3 in odds, and odds of 1000 to 1 need ln 1000 / ln 3 = 6.3 more of one kind than of the
//! other: seven, [`LocalisationParams::evidence_places`]. They are asked in an order that begins all over the stretch,
//! until that is reached. Measured on simulated car parks: at home 30 of 30 and 26 of 28 places were for the map, the
//! latter driven the other way; in car parks of the same drawing 6 of 24, all at the gate, and none of 28.
//!
//! **Its ends.** A drive may leave the mapped part, or come into it: there a few landmarks, seen from far, make fixes that
//! are off by half a metre. So a stretch that is believed is believed from its first place that is for the map to its last.
//!
//! [`LocalisationParams::evidence_places`]: super::LocalisationParams::evidence_places

use std::borrow::Cow;
use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use nalgebra::Vector2;
use rayon::prelude::*;

use super::fix::{Doubt, Fix, Localiser};
use super::view::{direction, eyes};
use super::{DriveKeyframe, LandmarkMap};
use crate::metric_map::features::{Feature, Words, distances, words};

/// A landmark is clearly the one when its bits are less than this share of those of any other that lies elsewhere.
/// Stricter than between neighbouring images, as a whole map has more that looks alike by accident.
const CLEARLY: f64 = 0.75;
/// Landmarks nearer together than this are one thing, metres.
const SAME_THING_M: f64 = 1.0;
/// Path between two places of a stretch, metres, at least.
const PLACE_M: f64 = 2.0;
/// Places that a stretch is asked at, at most.
const MOST_PLACES: usize = 64;
/// Descriptors of landmarks that are not in view, at most, taken evenly from the map: what is drawn occurs in any
/// sample.
const MOST_ELSEWHERE: usize = 65_536;

/// A descriptor, and the landmark that looks like it.
type LandmarkDescriptor = (Words, u32);

/// All looks of a map, to be searched as a whole.
pub(super) struct Evidence<'a> {
    localiser: &'a Localiser<'a>,
    known: Vec<LandmarkDescriptor>,
    /// Every so many landmarks are among the known ones.
    step: usize,
}

impl<'a> Evidence<'a> {
    pub(super) fn new(localiser: &'a Localiser<'a>) -> Self {
        let landmarks = localiser.map.landmarks();
        let all: usize = landmarks.iter().map(|known| known.descriptors.len()).sum();
        let step = all.div_ceil(MOST_ELSEWHERE).max(1);
        let sample = (0..landmarks.len()).step_by(step);
        Self {
            known: sample
                .flat_map(|landmark| looks(localiser.map, landmark))
                .collect(),
            localiser,
            step,
        }
    }

    /// The keyframes of a stretch, fixes in order of driving with their keyframes, that are of this place: `ahead` more
    /// places are for it than against it, and the ends have places that are for it.
    ///
    /// # Errors
    /// [`Doubt::AnotherPlace`] where as many more are against it, [`Doubt::Undecided`] where too few are either.
    pub(super) fn believed(
        &self,
        keyframes: &[DriveKeyframe<'_>],
        fixes: &[(usize, &Fix)],
        ahead: usize,
    ) -> Result<Range<usize>, Doubt> {
        let mut asked = BTreeMap::new();
        let mut ask = |(keyframe, fix): (usize, &Fix)| -> Ordering {
            let ask = || self.at_place(&keyframes[keyframe], fix);
            *asked.entry(keyframe).or_insert_with(ask)
        };
        let (need, mut sum) = (ahead as i64, 0);
        for place in spread(places(keyframes, fixes)) {
            sum += ask(place) as i64;
            if sum.abs() >= need {
                break;
            }
        }
        if sum <= -need {
            return Err(Doubt::AnotherPlace);
        } else if sum < need {
            return Err(Doubt::Undecided);
        }
        let backwards: Vec<(usize, &Fix)> = fixes.iter().rev().copied().collect();
        let mut end = |fixes: &[(usize, &Fix)]| {
            let mut places = places(keyframes, fixes).into_iter();
            let first = places.find(|place| ask(*place) == Ordering::Greater);
            first.map(|(keyframe, _)| keyframe).ok_or(Doubt::Undecided)
        };
        Ok(end(fixes)?..end(&backwards)? + 1)
    }

    /// Directions in which features are recognised here, against those in which they are elsewhere.
    fn at_place(&self, keyframe: &DriveKeyframe<'_>, fix: &Fix) -> Ordering {
        let Localiser {
            rig, map, params, ..
        } = self.localiser;
        let known = self.with_those_in_view(fix);
        let eyes = eyes(rig, &fix.pose.pose);
        let images = rig.cameras.iter().zip(&eyes).zip(&keyframe.features.images);
        let all =
            images.flat_map(|(camera, image)| image.features.iter().map(move |it| (camera, it)));
        let all: Vec<_> = all.collect();
        let votes = all.into_par_iter().filter_map(|((mounted, eye), feature)| {
            let ray = mounted.camera.unproject(feature.pixel)?;
            let shown = recognised(map, &known, feature, params.limits.match_bits)?;
            let seen = eye.project(&map.landmarks()[shown].position);
            let off_px = seen.map(|pixel| (pixel - Vector2::from(feature.pixel)).norm());
            let agrees = off_px.is_some_and(|off_px| off_px <= params.verify_px);
            Some((agrees, direction(&mounted.vehicle_from_camera.rotate(&ray))))
        });
        let votes: BTreeSet<(bool, [i64; 2])> = votes.collect();
        let here = votes.iter().filter(|(agrees, _)| *agrees).count();
        here.cmp(&(votes.len() - here))
    }

    /// What is known of the whole map, and of what should be in view all.
    fn with_those_in_view(&self, fix: &Fix) -> Cow<'_, [LandmarkDescriptor]> {
        if self.step == 1 {
            return Cow::Borrowed(&self.known);
        }
        let map = self.localiser.map;
        let seen = self.localiser.sighted(&fix.pose);
        let left_out = |landmark: &usize| !landmark.is_multiple_of(self.step);
        let seen: BTreeSet<usize> = seen
            .iter()
            .map(|seen| seen.landmark)
            .filter(left_out)
            .collect();
        let seen = seen.into_iter().flat_map(|landmark| looks(map, landmark));
        Cow::Owned(self.known.iter().copied().chain(seen).collect())
    }
}

fn looks(map: &LandmarkMap, landmark: usize) -> impl Iterator<Item = LandmarkDescriptor> {
    let looks = map.landmarks()[landmark].descriptors.iter();
    looks.map(move |look| (words(look), landmark as u32))
}

/// Fixes of a stretch so far apart that each is of another place.
fn places<'f>(
    keyframes: &[DriveKeyframe<'_>],
    fixes: &[(usize, &'f Fix)],
) -> Vec<(usize, &'f Fix)> {
    let at = |(keyframe, _): &(usize, &Fix)| keyframes[*keyframe].odom_from_vehicle.translation;
    let step_m = |pair: &[(usize, &Fix)]| (at(&pair[1]) - at(&pair[0])).norm();
    let length_m: f64 = fixes.windows(2).map(step_m).sum();
    let apart_m = PLACE_M.max(length_m / MOST_PLACES as f64);
    let mut path_m = apart_m;
    let mut places = Vec::new();
    for (index, fix) in fixes.iter().enumerate() {
        if index > 0 {
            path_m += step_m(&fixes[index - 1..=index]);
        }
        if path_m >= apart_m {
            places.push(*fix);
            path_m = 0.0;
        }
    }
    places
}

/// In an order in which the first few lie all over the stretch.
fn spread<T>(places: Vec<T>) -> impl Iterator<Item = T> {
    let mut numbered: Vec<(usize, T)> = places.into_iter().enumerate().collect();
    numbered.sort_by_key(|(number, _)| number.reverse_bits());
    numbered.into_iter().map(|(_, place)| place)
}

/// The landmark that a feature clearly shows.
fn recognised(
    map: &LandmarkMap,
    known: &[LandmarkDescriptor],
    feature: &Feature,
    most: u32,
) -> Option<usize> {
    let bits = distances(known.iter().map(|(look, _)| look), &feature.descriptor);
    let (best, first) = bits.iter().enumerate().min_by_key(|(_, bits)| **bits)?;
    if *first > most {
        return None;
    }
    let shown = known[best].1 as usize;
    let place = map.landmarks()[shown].position;
    let rival = |(bits, (_, other)): (&u32, &LandmarkDescriptor)| {
        let alike = f64::from(*first) >= CLEARLY * f64::from(*bits);
        alike && (map.landmarks()[*other as usize].position - place).norm() > SAME_THING_M
    };
    (!bits.iter().zip(known).any(rival)).then_some(shown)
}
