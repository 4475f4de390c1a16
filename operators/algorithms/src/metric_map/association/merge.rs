//! Hits become merged landmarks.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use rayon::prelude::*;

use super::point::{Sight, triangulate};
use super::search::{Hit, Search};
use super::{AssociationParams, DescriptorSource, FeatureRef, Landmark, Scene};
use crate::geometry::pose::Pose;
use crate::solving::parts::{first, join};

/// Part of the smaller landmark's features that may be contradicted: wrong members of a track should not keep it
/// apart for ever. They are dropped.
const MOST_CONFLICTS: f64 = 0.2;
/// Part of the features that one point must explain.
const LEAST_EXPLAINED: f64 = 0.8;
/// A feature belongs to no landmark.
const NONE: u32 = u32::MAX;

/// Looks for every landmark in all images that may show it, and makes one of those that turn out to be the same.
/// `poses` are `map_from_vehicle` of the scene's keyframes. Features appear in at most one landmark, before and after.
/// Given are the landmarks in the order of the ones given; merged ones take the place of the earliest.
///
/// # Errors
/// As [`DescriptorSource::descriptors`].
pub fn associate<E: Send>(
    scene: &Scene,
    described: &dyn DescriptorSource<E>,
    poses: &[Pose],
    landmarks: &[Landmark],
    params: &AssociationParams,
) -> Result<Vec<Landmark>, E> {
    let hits = Search::new(scene, described, poses, landmarks, params)?.hits()?;
    let owners = owners(scene, landmarks);
    let mut votes: Vec<((u32, u32), u32)> = Vec::new();
    let mut free: Vec<(u32, Hit)> = Vec::new();
    for hit in hits {
        let owner = owners[hit.feature.image as usize][hit.feature.feature as usize];
        if owner == NONE {
            free.push((hit.bits, hit));
        } else if owner != hit.landmark {
            let pair = (owner.min(hit.landmark), owner.max(hit.landmark));
            votes.push((pair, hit.bits));
        }
    }
    let mut groups = Groups::new(scene, poses, landmarks, params);
    groups.merge(&elected(votes, params.min_votes));
    free.par_sort_unstable();
    for (_, hit) in free {
        groups.add(hit.landmark, hit.feature);
    }
    Ok(groups.finish())
}

/// The pairs of landmarks that enough images say to be one, first those that most say it of; `votes` have the bits in which
/// what was seen differs.
fn elected(mut votes: Vec<((u32, u32), u32)>, least: u32) -> Vec<(u32, u32)> {
    votes.par_sort_unstable();
    let of_pairs = votes.chunk_by(|(a, _), (b, _)| a == b);
    let of_pairs = of_pairs.filter(|votes| votes.len() >= least as usize);
    let ranked = of_pairs.map(|votes| {
        let count = votes.len() as u32;
        let bits: u32 = votes.iter().map(|(_, bits)| bits).sum();
        (Reverse(count), bits / count, votes[0].0)
    });
    let mut ranked: Vec<_> = ranked.collect();
    ranked.sort_unstable();
    ranked.into_iter().map(|(.., pair)| pair).collect()
}

/// The pairs, in their order, in parts that share no landmark.
fn apart(landmarks: usize, pairs: &[(u32, u32)]) -> Vec<Vec<(u32, u32)>> {
    let mut parents: Vec<u32> = (0..landmarks as u32).collect();
    for (a, b) in pairs {
        join(&mut parents, [*a, *b]);
    }
    let mut parts: BTreeMap<u32, Vec<(u32, u32)>> = BTreeMap::new();
    for pair in pairs {
        let part = first(&mut parents, pair.0);
        parts.entry(part).or_default().push(*pair);
    }
    parts.into_values().collect()
}

fn owners(scene: &Scene, landmarks: &[Landmark]) -> Vec<Vec<u32>> {
    let mut owners: Vec<Vec<u32>> = scene
        .images
        .iter()
        .map(|image| vec![NONE; image.features.len()])
        .collect();
    for (at, landmark) in landmarks.iter().enumerate() {
        for feature in &landmark.features {
            owners[feature.image as usize][feature.feature as usize] = at as u32;
        }
    }
    owners
}

/// Landmarks that grow together.
struct Groups<'a> {
    scene: &'a Scene,
    cameras: Vec<Pose>,
    /// Features that one point explains lie nearer to it than this, pixels.
    explained_px: f64,
    parents: Vec<u32>,
    /// `None` for those that went into another one.
    landmarks: Vec<Option<Landmark>>,
    /// Features added, so that none is given away twice.
    taken: std::collections::BTreeSet<FeatureRef>,
}

impl<'a> Groups<'a> {
    fn new(
        scene: &'a Scene,
        poses: &[Pose],
        landmarks: &[Landmark],
        params: &AssociationParams,
    ) -> Self {
        Self {
            scene,
            cameras: scene.map_from_cameras(poses),
            explained_px: params.agree_px.max(0.75 * params.radius_px),
            parents: (0..landmarks.len() as u32).collect(),
            landmarks: landmarks.iter().cloned().map(Some).collect(),
            taken: Default::default(),
        }
    }

    /// Makes one landmark of each pair that can be one, in their order. What shares no landmark is merged side by side.
    fn merge(&mut self, pairs: &[(u32, u32)]) {
        let parts = apart(self.landmarks.len(), pairs);
        let merged: Vec<MergedLandmarks> =
            parts.par_iter().map(|pairs| self.merged(pairs)).collect();
        for MergedLandmarks { landmarks, parents } in merged {
            for (at, landmark) in landmarks {
                self.landmarks[at as usize] = Some(landmark);
            }
            for (from, into) in parents {
                self.landmarks[from as usize] = None;
                self.parents[from as usize] = into;
            }
        }
    }

    fn merged(&self, pairs: &[(u32, u32)]) -> MergedLandmarks {
        let mut part = MergedLandmarks::default();
        for (a, b) in pairs {
            let (a, b) = (part.root(*a), part.root(*b));
            let (into, from) = (a.min(b), a.max(b));
            if into == from {
                continue;
            }
            let landmark = |at: u32| {
                let grown = part.landmarks.get(&at);
                grown.or(self.landmarks[at as usize].as_ref())
            };
            let merged = landmark(into).zip(landmark(from)).and_then(|(kept, gone)| {
                let features = united(&kept.features, &gone.features)?;
                self.explained(kept.id, features)
            });
            if let Some(merged) = merged {
                part.landmarks.insert(into, merged);
                part.parents.insert(from, into);
            }
        }
        part
    }

    /// The landmark that shows as these features, if there is one.
    fn explained(&self, id: u32, features: Vec<FeatureRef>) -> Option<Landmark> {
        let sights: Vec<Sight> = features
            .iter()
            .filter_map(|feature| self.scene.sight(&self.cameras, *feature))
            .collect();
        let found = triangulate(&sights)?;
        let near = |sight: &&Sight| {
            let off_px = sight.off_px(&found.point);
            off_px.is_some_and(|off_px| off_px <= self.explained_px)
        };
        let explained = sights.iter().filter(near).count();
        (explained as f64 >= LEAST_EXPLAINED * features.len() as f64).then_some(Landmark {
            id,
            point: found.point,
            features,
        })
    }

    /// Gives a free feature to a landmark that the image does not show yet.
    fn add(&mut self, landmark: u32, feature: FeatureRef) {
        let root = first(&mut self.parents, landmark);
        let Some(landmark) = &mut self.landmarks[root as usize] else {
            return;
        };
        let place = landmark
            .features
            .binary_search_by_key(&feature.image, |known| known.image);
        if let Err(place) = place
            && self.taken.insert(feature)
        {
            landmark.features.insert(place, feature);
        }
    }

    fn finish(self) -> Vec<Landmark> {
        self.landmarks.into_iter().flatten().collect()
    }
}

/// What became of landmarks that have nothing to do with others.
#[derive(Default)]
struct MergedLandmarks {
    /// Those that grew.
    landmarks: BTreeMap<u32, Landmark>,
    /// Into which those went that are no more.
    parents: BTreeMap<u32, u32>,
}

impl MergedLandmarks {
    fn root(&self, mut at: u32) -> u32 {
        while let Some(above) = self.parents.get(&at) {
            at = *above;
        }
        at
    }
}

/// Both lists, in order, without the features that contradict each other; `None` where those are too many.
fn united(a: &[FeatureRef], b: &[FeatureRef]) -> Option<Vec<FeatureRef>> {
    let mut all: Vec<FeatureRef> = a.iter().chain(b).copied().collect();
    all.sort_unstable();
    let alone = |at: usize| {
        let image = all[at].image;
        let before = at.checked_sub(1).and_then(|before| all.get(before));
        let neighbours = [before, all.get(at + 1)];
        neighbours
            .iter()
            .flatten()
            .all(|other| other.image != image)
    };
    let kept: Vec<FeatureRef> = (0..all.len())
        .filter(|at| alone(*at))
        .map(|at| all[at])
        .collect();
    let conflicts = (all.len() - kept.len()) / 2;
    let most = MOST_CONFLICTS * a.len().min(b.len()) as f64;
    (conflicts as f64 <= most).then_some(kept)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn features(images: &[u32], feature: u32) -> Vec<FeatureRef> {
        let of = |image: &u32| FeatureRef {
            image: *image,
            feature,
        };
        images.iter().map(of).collect()
    }

    #[test]
    fn contradictions_are_dropped_while_they_are_few() {
        let long = features(&[1, 2, 3, 4, 5, 6, 7, 8, 9, 10], 0);
        let united_with = |images: &[u32]| united(&long, &features(images, 1)).map(|all| all.len());
        assert_eq!(united_with(&[11, 12]), Some(12));
        assert_eq!(united_with(&[10, 11, 12, 13, 14]), Some(13));
        assert_eq!(united_with(&[9, 10, 11]), None);
    }
}
