//! Hits become merged landmarks.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use super::point::{Sight, triangulate};
use super::search::{Hit, Search};
use super::{AssociationParams, FeatureRef, Landmark, Scene};
use crate::geometry::pose::Pose;

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
pub fn associate(
    scene: &Scene,
    poses: &[Pose],
    landmarks: &[Landmark],
    params: &AssociationParams,
) -> Vec<Landmark> {
    let hits = Search::new(scene, poses, landmarks, params).hits();
    let owners = owners(scene, landmarks);
    let mut votes: BTreeMap<(u32, u32), (u32, u32)> = BTreeMap::new();
    let mut free: Vec<(u32, Hit)> = Vec::new();
    for hit in hits {
        let owner = owners[hit.feature.image as usize][hit.feature.feature as usize];
        if owner == NONE {
            free.push((hit.bits, hit));
        } else if owner != hit.landmark {
            let pair = (owner.min(hit.landmark), owner.max(hit.landmark));
            let votes = votes.entry(pair).or_default();
            *votes = (votes.0 + 1, votes.1 + hit.bits);
        }
    }
    let mut groups = Groups::new(scene, poses, landmarks, params);
    let mut pairs: Vec<_> = votes
        .into_iter()
        .filter(|(_, (count, _))| *count >= params.min_votes)
        .collect();
    pairs.sort_by_key(|(pair, (count, bits))| (Reverse(*count), bits / count, *pair));
    for ((a, b), _) in pairs {
        groups.merge(a, b);
    }
    free.sort_unstable();
    for (_, hit) in free {
        groups.add(hit.landmark, hit.feature);
    }
    groups.finish()
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

    fn root(&mut self, mut at: u32) -> u32 {
        while self.parents[at as usize] != at {
            let above = self.parents[self.parents[at as usize] as usize];
            self.parents[at as usize] = above;
            at = above;
        }
        at
    }

    fn merge(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        let (into, from) = (a.min(b), a.max(b));
        if into == from {
            return;
        }
        let (Some(kept), Some(gone)) = (
            &self.landmarks[into as usize],
            &self.landmarks[from as usize],
        ) else {
            return;
        };
        let Some(features) = united(&kept.features, &gone.features) else {
            return;
        };
        let Some(merged) = self.explained(kept.id, features) else {
            return;
        };
        self.landmarks[into as usize] = Some(merged);
        self.landmarks[from as usize] = None;
        self.parents[from as usize] = into;
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
        let root = self.root(landmark);
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
