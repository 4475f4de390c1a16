//! Loop closures among the drives of a site.

use nalgebra::Matrix6;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::drive::{Drive, KeyframeView, Surveyed};
use super::index::PlaceIndex;
use super::local_points::{LocalPoint, PointLimits, local_points};
use super::verification::{KeyframePoints, verified};
use super::vocabulary::{Bag, Vocabulary, VocabularyOptions};
use crate::geometry::pose::Pose;
use crate::geometry::resection::ResectionOptions;
use crate::metric_map::features::{Descriptor, FeatureNoise, KeyframeFeatures, Words, words};
use crate::metric_map::matching::MatchLimits;
use crate::metric_map::odometry::OdometryScale;

/// How loops are looked for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct LoopOptions {
    /// The words that places are compared by.
    #[serde(flatten)]
    pub vocabulary: VocabularyOptions,
    /// Keyframes of one session are compared when more driven path than this lies between them (m). Over 10 m odometry
    /// that is 1 % off errs by 0.1 m, which tracks bridge as well as a loop.
    #[schemars(range(min = 0.0))]
    pub min_path_m: f64,
    /// Similar keyframes nearer together along a session than this are one place (m): what lies 5 m apart shows most of
    /// the same things.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub place_m: f64,
    /// Loops from a keyframe to one place lead to keyframes at least as far apart (m), so that they do not repeat each
    /// other.
    #[schemars(range(min = 0.0))]
    pub spacing_m: f64,
    /// Places that are looked at closely for each keyframe, the most similar first.
    pub places: usize,
    /// Loops wanted for each keyframe.
    pub edges: usize,
    /// Driven path before and after a keyframe whose sightings make its points (m): a base of 6 m for points 20 m away,
    /// and a drift of centimetres.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub window_m: f64,
    /// A point's standard deviation along its ray, at most, as a share of its range; beyond that its error is far from
    /// normal.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub max_relative_sigma: f64,
    /// When descriptors match, seen from either side.
    #[serde(flatten)]
    pub limits: MatchLimits,
    /// How exactly features lie.
    #[serde(flatten)]
    pub features: FeatureNoise,
    /// What the points that odometry gives are off by together.
    #[serde(flatten)]
    pub odometry: OdometryScale,
    /// Probability that a wrong match agrees with a wrong pose: a cone of three sigma is a thousandth of a half space,
    /// and what there is to see crowds around the horizon.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub agreement: f64,
    /// False loops per comparison that chance may make. With `agreement` it sets the least number of inliers: 13 of 30
    /// matches, 27 of 300.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub false_alarms: f64,
    /// Inliers must lie in as many of 24 directions around the vehicle.
    pub min_sectors: usize,
    /// Loops whose position is known less well are left out (m).
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub max_sigma_m: f64,
    /// The search for a pose.
    #[serde(flatten)]
    pub resection: ResectionOptions,
}

impl Default for LoopOptions {
    fn default() -> Self {
        Self {
            vocabulary: VocabularyOptions::default(),
            min_path_m: 10.0,
            place_m: 5.0,
            spacing_m: 1.0,
            places: 4,
            edges: 3,
            window_m: 3.0,
            max_relative_sigma: 0.3,
            limits: MatchLimits::default(),
            features: FeatureNoise::default(),
            odometry: OdometryScale::default(),
            agreement: 0.01,
            false_alarms: 1e-6,
            min_sectors: 3,
            max_sigma_m: 0.2,
            resection: ResectionOptions::default(),
        }
    }
}

/// Two keyframes that see the same place.
#[derive(Debug, Clone, PartialEq)]
pub struct Loop {
    /// Drive and keyframe that came later.
    pub later: (usize, usize),
    /// Drive and keyframe that came earlier.
    pub earlier: (usize, usize),
    /// The later vehicle in the earlier one's frame.
    pub earlier_from_later: Pose,
    /// Covariance: translation along the earlier vehicle's axes (m²), then rotation about them (rad²).
    pub covariance: Matrix6<f64>,
    /// Features that matched.
    pub matches: usize,
    /// Matches that agree with the pose.
    pub inliers: usize,
}

impl Loop {
    /// Standard deviation of the relative position along an axis, root mean square of the three; metres.
    pub fn sigma_m(&self) -> f64 {
        (self.covariance.fixed_view::<3, 3>(0, 0).trace() / 3.0).sqrt()
    }

    /// The same of the relative orientation; radians.
    pub fn sigma_rad(&self) -> f64 {
        (self.covariance.fixed_view::<3, 3>(3, 3).trace() / 3.0).sqrt()
    }
}

/// The loops from each keyframe to earlier ones, of its own drive and of others; drives that began earlier count as
/// earlier as a whole. Ordered by the later keyframe; to one keyframe the best first.
///
/// What is compared is all that is held of what cameras saw: features are looked at keyframe by keyframe, four times and
/// once for each keyframe that they are compared with.
///
/// # Errors
/// Why features cannot be fetched.
pub fn loops<E: Send>(drives: &[Drive<'_, E>], options: &LoopOptions) -> Result<Vec<Loop>, E> {
    let site = Site::new(drives, options)?;
    let each = (0..site.documents.len()).into_par_iter();
    let found: Vec<Vec<Loop>> = each
        .map(|document| site.closed(document))
        .collect::<Result<_, E>>()?;
    Ok(found.into_iter().flatten().collect())
}

/// All drives of a site, with what is worked out once. A document is a keyframe, in the order driven.
struct Site<'a, E> {
    options: &'a LoopOptions,
    drives: Vec<Surveyed<'a, E>>,
    points: Vec<Vec<Vec<LocalPoint>>>,
    /// Drive and keyframe.
    documents: Vec<(usize, usize)>,
    /// The first document of each drive.
    first: Vec<usize>,
    bags: Vec<Bag>,
    index: PlaceIndex,
}

impl<'a, E: Send> Site<'a, E> {
    fn new(drives: &'a [Drive<'a, E>], options: &'a LoopOptions) -> Result<Self, E> {
        let surveyed: Vec<_> = drives
            .iter()
            .map(|drive| Surveyed::new(drive, options.features.sigma_px))
            .collect();
        let limits = PointLimits {
            window_m: options.window_m,
            max_relative_sigma: options.max_relative_sigma,
        };
        let points = surveyed
            .iter()
            .map(|drive| local_points(drive, &limits))
            .collect::<Result<_, E>>()?;
        let (documents, first) = documents(drives);
        let vocabulary = vocabulary(drives, &documents, &options.vocabulary)?;
        let bags = of_each(drives, &documents, |_, features| {
            vocabulary.bag(descriptors(features))
        })?;
        let index = PlaceIndex::new(vocabulary.words(), &bags);
        Ok(Self {
            options,
            drives: surveyed,
            points,
            documents,
            first,
            bags,
            index,
        })
    }

    fn view(&self, document: usize) -> Result<KeyframeView<'a>, E> {
        let (drive, keyframe) = self.documents[document];
        self.drives[drive].view(keyframe)
    }

    /// A document that is seen so, with its points.
    fn with_points<'v>(
        &'v self,
        document: usize,
        view: &'v KeyframeView<'v>,
    ) -> KeyframePoints<'v> {
        let (drive, keyframe) = self.documents[document];
        KeyframePoints {
            mounts: &self.drives[drive].mounts,
            view,
            points: &self.points[drive][keyframe],
        }
    }

    fn path_m(&self, document: usize) -> f64 {
        let (drive, keyframe) = self.documents[document];
        self.drives[drive].path_m[keyframe]
    }

    fn same_drive(&self, a: usize, b: usize) -> bool {
        self.documents[a].0 == self.documents[b].0
    }

    /// Path between two keyframes of one drive; infinite for those of two.
    fn apart_m(&self, a: usize, b: usize) -> f64 {
        if self.same_drive(a, b) {
            (self.path_m(a) - self.path_m(b)).abs()
        } else {
            f64::INFINITY
        }
    }

    /// The documents that look most alike, one for each place.
    fn candidates(&self, later: usize) -> Vec<usize> {
        let mut scored: Vec<(f32, usize)> = self
            .index
            .scores(&self.bags[later], later)
            .into_iter()
            .zip(0..)
            .filter(|(score, earlier)| {
                *score > 0.0 && self.apart_m(*earlier, later) > self.options.min_path_m
            })
            .collect();
        scored.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let mut chosen: Vec<usize> = Vec::new();
        for (_, document) in scored {
            if chosen.len() >= self.options.places {
                break;
            }
            if chosen
                .iter()
                .all(|other| self.apart_m(*other, document) > self.options.place_m)
            {
                chosen.push(document);
            }
        }
        chosen
    }

    fn closed(&self, later: usize) -> Result<Vec<Loop>, E> {
        let mut found: Vec<Loop> = Vec::new();
        let candidates = self.candidates(later);
        if candidates.is_empty() {
            return Ok(found);
        }
        let view = self.view(later)?;
        for earlier in candidates {
            if found.len() >= self.options.edges {
                break;
            }
            let Some(first) = self.loop_between(earlier, later, &view, None)? else {
                continue;
            };
            let beside = self.beside(earlier, &first);
            found.push(first);
            if let Some((document, guess)) = beside
                && found.len() < self.options.edges
            {
                found.extend(self.loop_between(document, later, &view, Some(&guess))?);
            }
        }
        found.sort_by(|a, b| b.inliers.cmp(&a.inliers).then(a.earlier.cmp(&b.earlier)));
        Ok(found)
    }

    /// The loop from one document to another, which is seen so.
    fn loop_between(
        &self,
        earlier: usize,
        later: usize,
        seen: &KeyframeView<'_>,
        guess: Option<&Pose>,
    ) -> Result<Option<Loop>, E> {
        let view = self.view(earlier)?;
        let verified = verified(
            self.with_points(earlier, &view),
            self.with_points(later, seen),
            guess,
            self.options,
        );
        let found = verified.map(|verified| Loop {
            later: self.documents[later],
            earlier: self.documents[earlier],
            earlier_from_later: verified.earlier_from_later,
            covariance: verified.covariance,
            matches: verified.matches,
            inliers: verified.inliers,
        });
        Ok(found.filter(|found| found.sigma_m() <= self.options.max_sigma_m))
    }

    /// The keyframe of the same place, but not the same spot, that the later one stood nearest to; and how.
    fn beside(&self, earlier: usize, found: &Loop) -> Option<(usize, Pose)> {
        let (drive, keyframe) = found.earlier;
        let surveyed = &self.drives[drive];
        let later = (found.later.0 == drive).then(|| surveyed.path_m[found.later.1]);
        let first = self.first[drive];
        let near = (0..surveyed.path_m.len()).filter(|other| {
            let apart = self.apart_m(first + other, earlier);
            let from_later =
                later.map_or(f64::INFINITY, |path| (path - surveyed.path_m[*other]).abs());
            (self.options.spacing_m..=self.options.place_m).contains(&apart)
                && from_later > self.options.min_path_m
        });
        let guessed = near.map(|other| {
            let guess = surveyed
                .between(other, keyframe)
                .compose(&found.earlier_from_later);
            (guess.translation.norm(), other, guess)
        });
        let (_, nearest, guess) = guessed.min_by(|a, b| a.0.total_cmp(&b.0))?;
        Some((first + nearest, guess))
    }
}

/// Keyframes by the time their drive began and their own, and the first of each drive.
fn documents<E>(drives: &[Drive<'_, E>]) -> (Vec<(usize, usize)>, Vec<usize>) {
    let mut order: Vec<usize> = (0..drives.len()).collect();
    let began = |drive: &usize| {
        drives[*drive]
            .keyframes
            .first()
            .map(|keyframe| keyframe.stamp)
    };
    order.sort_by_key(|drive| (began(drive), *drive));
    let mut first = vec![0; drives.len()];
    let mut documents = Vec::new();
    for drive in order {
        first[drive] = documents.len();
        documents.extend((0..drives[drive].keyframes.len()).map(|keyframe| (drive, keyframe)));
    }
    (documents, first)
}

/// What is made of each document and its features.
fn of_each<E: Send, T: Send>(
    drives: &[Drive<'_, E>],
    documents: &[(usize, usize)],
    make: impl Fn(usize, &KeyframeFeatures) -> T + Sync,
) -> Result<Vec<T>, E> {
    let each = documents.par_iter().enumerate();
    let made = each.map(|(document, (drive, keyframe))| -> Result<T, E> {
        let features = drives[*drive].seen.features(*keyframe)?;
        Ok(make(document, &features))
    });
    made.collect()
}

fn descriptors(features: &KeyframeFeatures) -> impl Iterator<Item = &Descriptor> {
    let all = features.images.iter().flat_map(|image| &image.features);
    all.map(|feature| &feature.descriptor)
}

/// The vocabulary of all documents, as [`Vocabulary::train`] makes it of all their descriptors.
pub(super) fn vocabulary<E: Send>(
    drives: &[Drive<'_, E>],
    documents: &[(usize, usize)],
    options: &VocabularyOptions,
) -> Result<Vocabulary, E> {
    let counts = of_each(drives, documents, |_, features| {
        descriptors(features).count()
    })?;
    let mut all = 0;
    let before: Vec<usize> = counts
        .iter()
        .map(|count| {
            all += count;
            all - count
        })
        .collect();
    let step = options.step(all);
    let sample = of_each(drives, documents, |document, features| {
        // How far behind the last one that was taken the document begins.
        let behind = before[document] % step;
        let taken = descriptors(features).skip((step - behind) % step);
        taken.step_by(step).map(words).collect::<Vec<Words>>()
    })?;
    Ok(Vocabulary::of_sample(&sample.concat(), options))
}
