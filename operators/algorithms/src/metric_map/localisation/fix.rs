//! The pose of one keyframe from a guess, and whether to believe it.

use super::association::{Cells, Claim, Search, claims};
use super::motion::{Guess, difference};
use super::refinement::{Pair, Refined, Refinement};
use super::view::{InView, Sighted, eyes};
use super::{LandmarkMap, LocalisationParams};
use crate::geometry::rig::Rig;
use crate::metric_map::features::KeyframeFeatures;
use nalgebra::Vector3;
use std::collections::BTreeSet;

/// Squared Mahalanobis distance between pose and guess that 99.999 % of true ones stay below (six unknowns).
const CONSISTENT: f64 = 33.1;
/// Standard deviation that a guess of a recognised place is verified with, metres and radians.
const PLACE_SIGMA_M: f64 = 0.1;
const PLACE_SIGMA_RAD: f64 = 0.03;
/// Azimuth sectors around the vehicle; above and below the horizon of the cameras counts apart.
const SECTORS: f64 = 12.0;

/// Why a pose is not believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Doubt {
    /// No landmark should be in view.
    NothingInView,
    /// Fewer inliers than a fix needs.
    FewInliers,
    /// Too many features around the projected landmarks match by chance.
    LowShare,
    /// Inliers lie in too few directions.
    OneSided,
    /// The pose is less certain than a fix must be.
    Uncertain,
    /// The pose is farther from the guess than odometry allows.
    FarFromGuess,
    /// It is sound, but what the stretch that it is of shows does not tell this place from another one like it.
    Undecided,
    /// It is sound, but the stretch that it is of shows another place, laid out like this one.
    AnotherPlace,
}

/// A landmark, once for each camera, with the feature that shows it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LandmarkMatch {
    /// Index of the landmark in the map.
    pub landmark: usize,
    /// Index of the camera in the rig.
    pub camera: usize,
    /// Index of the feature in the camera's image.
    pub feature: usize,
    /// Distance between feature and projected landmark, pixels.
    pub residual_px: f64,
    /// Robust weight, 0 to 1.
    pub weight: f64,
}

/// The pose of one keyframe.
#[derive(Debug, Clone, PartialEq)]
pub struct Fix {
    /// The pose with its covariance.
    pub pose: Guess,
    /// Landmarks that should be in view, counted once for each camera.
    pub candidates: usize,
    /// Those that matched a feature within the radius of verification.
    pub matches: usize,
    /// The matches that agree with the pose.
    pub inliers: Vec<LandmarkMatch>,
    /// Why not to believe it; `None` for a sound fix.
    pub doubt: Option<Doubt>,
}

impl Fix {
    /// Whether the pose is to be believed, as far as one keyframe can tell.
    pub fn is_sound(&self) -> bool {
        self.doubt.is_none()
    }

    /// Root mean square of the inliers' distances in the image, pixels; `None` without inliers.
    pub fn rms_px(&self) -> Option<f64> {
        let sum: f64 = self
            .inliers
            .iter()
            .map(|found| found.residual_px.powi(2))
            .sum();
        (!self.inliers.is_empty()).then(|| (sum / self.inliers.len() as f64).sqrt())
    }
}

/// Localises keyframes of one rig in one map.
#[derive(Debug, Clone)]
pub struct Localiser<'a> {
    pub(super) rig: &'a Rig,
    pub(super) map: &'a LandmarkMap,
    pub(super) params: LocalisationParams,
    in_view: InView,
}

impl<'a> Localiser<'a> {
    /// A localiser; its parameters have passed [`LocalisationParams::check`].
    pub fn new(rig: &'a Rig, map: &'a LandmarkMap, params: LocalisationParams) -> Self {
        Self {
            rig,
            map,
            params,
            in_view: InView::new(rig, map, &params),
        }
    }

    /// All landmarks that cameras should see from a guess: each once per camera, ordered by camera and landmark.
    pub(super) fn sighted(&self, guess: &Guess) -> Vec<Sighted> {
        let sigma_px = self.params.features.sigma_px;
        self.in_view.sighted(self.rig, self.map, guess, sigma_px)
    }

    /// The pose of a keyframe near a guess: matched as far as the guess's covariance reaches, refined, matched
    /// and refined again from the better pose, and verified.
    pub fn fix(&self, guess: &Guess, features: &KeyframeFeatures) -> Fix {
        let cells = Cells::of_keyframe(features, &self.params.features);
        let mut best = *guess;
        for _ in 0..2 {
            let seen = self.sighted(&best);
            let found = claims(self.map, &seen, &cells, Search::Covariance, &self.params);
            match self.refine(guess, &best, &seen, &found, &cells) {
                Some(refined) => best = refined.guess,
                None => break,
            }
        }
        self.verify(guess, &best, &cells)
    }

    /// The same from a recognised place, whose pose comes from the image alone: it holds nothing back.
    pub fn fix_at_place(
        &self,
        place: &crate::geometry::pose::Pose,
        features: &KeyframeFeatures,
    ) -> Fix {
        let (shift, turn) = (
            PLACE_SIGMA_M * PLACE_SIGMA_M,
            PLACE_SIGMA_RAD * PLACE_SIGMA_RAD,
        );
        let variances = [shift, shift, shift, turn, turn, turn];
        let covariance = nalgebra::Matrix6::from_diagonal(&variances.into());
        self.fix(
            &Guess {
                pose: *place,
                covariance,
            },
            features,
        )
    }

    fn refine(
        &self,
        prior: &Guess,
        start: &Guess,
        seen: &[Sighted],
        found: &[Claim],
        cells: &[Cells<'_>],
    ) -> Option<Refined> {
        let pairs: Vec<Pair> = found.iter().map(|claim| pair(claim, seen, cells)).collect();
        let problem = Refinement {
            rig: self.rig,
            map: self.map,
            pairs: &pairs,
            prior,
            params: &self.params,
        };
        problem.solve(&start.pose)
    }

    /// Matches once more in a radius that chance would fill evenly, and judges what comes out.
    fn verify(&self, guess: &Guess, best: &Guess, cells: &[Cells<'_>]) -> Fix {
        let seen = self.sighted(best);
        let radius = Search::Radius(self.params.verify_px);
        let found = claims(self.map, &seen, cells, radius, &self.params);
        let mut fix = Fix {
            pose: *best,
            candidates: seen.len(),
            matches: found.len(),
            inliers: Vec::new(),
            doubt: Some(Doubt::FewInliers),
        };
        if seen.is_empty() {
            fix.doubt = Some(Doubt::NothingInView);
        } else if let Some(refined) = self.refine(guess, best, &seen, &found, cells) {
            fix.pose = refined.guess;
            for axis in 0..6 {
                let sigma = if axis < 3 {
                    self.params.map_m
                } else {
                    self.params.map_rad
                };
                fix.pose.covariance[(axis, axis)] += sigma * sigma;
            }
            let kept = found
                .iter()
                .zip(&refined.inliers)
                .filter_map(|(claim, inlier)| {
                    let (residual_px, weight) = (*inlier)?;
                    Some(LandmarkMatch {
                        landmark: seen[claim.sighted].landmark,
                        camera: seen[claim.sighted].camera,
                        feature: claim.feature,
                        residual_px,
                        weight,
                    })
                });
            fix.inliers = kept.collect();
            fix.doubt = self.doubt(guess, &fix);
        }
        fix
    }

    fn doubt(&self, guess: &Guess, fix: &Fix) -> Option<Doubt> {
        let params = &self.params;
        let distance = |guess: &Guess| {
            let off = difference(&guess.pose, &fix.pose.pose);
            let whitened = guess.covariance.cholesky().map(|factor| factor.solve(&off));
            whitened.map_or(f64::INFINITY, |whitened| off.dot(&whitened))
        };
        let inliers = fix.inliers.len();
        if inliers < params.min_inliers {
            Some(Doubt::FewInliers)
        } else if (inliers as f64) < params.min_inlier_share * fix.matches as f64 {
            Some(Doubt::LowShare)
        } else if self.directions(fix) < params.min_directions {
            Some(Doubt::OneSided)
        } else if fix.pose.sigma_m() > params.max_sigma_m
            || fix.pose.sigma_rad() > params.max_sigma_rad
        {
            Some(Doubt::Uncertain)
        } else if distance(guess) > CONSISTENT {
            Some(Doubt::FarFromGuess)
        } else {
            None
        }
    }

    /// Directions around the vehicle, of 24, that inliers lie in.
    fn directions(&self, fix: &Fix) -> usize {
        let eyes = eyes(self.rig, &fix.pose.pose);
        let cell = |found: &LandmarkMatch| {
            let from_eye =
                self.map.landmarks()[found.landmark].position - eyes[found.camera].centre;
            let ray = fix.pose.pose.rotation.inverse() * from_eye;
            let turn = ray.y.atan2(ray.x) / std::f64::consts::TAU + 0.5;
            let above = ray.dot(&Vector3::z()) > 0.0;
            (((turn * SECTORS) as usize).min(SECTORS as usize - 1), above)
        };
        fix.inliers.iter().map(cell).collect::<BTreeSet<_>>().len()
    }
}

fn pair(claim: &Claim, seen: &[Sighted], cells: &[Cells<'_>]) -> Pair {
    let Sighted {
        landmark, camera, ..
    } = seen[claim.sighted];
    let feature = &cells[camera].features[claim.feature];
    Pair {
        landmark,
        camera,
        pixel: feature.pixel.into(),
        blur: cells[camera].blur.of(feature.size_px),
    }
}
