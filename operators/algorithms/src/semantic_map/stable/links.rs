//! Views that are linked with each other, and where one is seen from another along the links.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Matrix6;

use crate::geometry::pose::Pose;

/// A link as one of its ends sees it.
#[derive(Debug, Clone, Copy)]
struct Way {
    to: usize,
    here_from_there: Pose,
    /// How unsure it is (m²).
    variance: f64,
}

/// Views by name, and what links them.
#[derive(Debug, Clone)]
pub struct Links<K> {
    names: Vec<K>,
    numbers: BTreeMap<K, usize>,
    ways: Vec<Vec<Way>>,
    reach_m: f64,
}

impl<K: Ord + Clone> Links<K> {
    /// Without any view. Views around another one are looked for this far away (m).
    pub fn new(reach_m: f64) -> Self {
        Self {
            names: Vec::new(),
            numbers: BTreeMap::new(),
            ways: Vec::new(),
            reach_m,
        }
    }

    /// Adds a link, which leads both ways. The covariance of `here_from_there` is along the axes of the other view:
    /// translation (m²), then rotation (rad²).
    pub fn add(&mut self, here: K, there: K, here_from_there: Pose, covariance: &Matrix6<f64>) {
        let part = |from: usize| covariance.fixed_view::<3, 3>(from, from).trace();
        // A turn counts by how far it moves what is at the end of the reach.
        let variance = part(0) + self.reach_m * self.reach_m * part(3);
        if !variance.is_finite() {
            return;
        }
        let variance = variance.max(f64::MIN_POSITIVE);
        let (here, there) = (self.number(here), self.number(there));
        let mut add = |from: usize, to, here_from_there| {
            self.ways[from].push(Way {
                to,
                here_from_there,
                variance,
            });
        };
        add(here, there, here_from_there);
        add(there, here, here_from_there.inverse());
    }

    fn number(&mut self, name: K) -> usize {
        let next = self.names.len();
        let number = *self.numbers.entry(name.clone()).or_insert(next);
        if number == next {
            self.names.push(name);
            self.ways.push(Vec::new());
        }
        number
    }

    /// The views around one, by the surest way to each that does not leave the reach, with their poses in its frame: the
    /// nearest first.
    pub fn around(&self, view: &K) -> Vec<(&K, Pose)> {
        let Some(start) = self.numbers.get(view).copied() else {
            return Vec::new();
        };
        let mut poses = BTreeMap::from([(start, (0.0_f64, Pose::identity()))]);
        // Variances are not negative, so their bits are in their order.
        let mut ahead = BTreeSet::from([(0_u64, start)]);
        while let Some((bits, at)) = ahead.pop_first() {
            let (sure, pose) = poses[&at];
            if bits != sure.to_bits() {
                continue;
            }
            for way in &self.ways[at] {
                let found = pose.compose(&way.here_from_there);
                let variance = sure + way.variance;
                let known = poses.get(&way.to).map(|(variance, _)| *variance);
                let near = found.translation.norm() <= self.reach_m;
                if near && known.is_none_or(|known| variance < known) {
                    poses.insert(way.to, (variance, found));
                    ahead.insert((variance.to_bits(), way.to));
                }
            }
        }
        poses.remove(&start);
        let mut around: Vec<(usize, Pose)> = poses
            .into_iter()
            .map(|(view, (_, pose))| (view, pose))
            .collect();
        let away = |(_, pose): &(usize, Pose)| pose.translation.norm();
        around.sort_by(|a, b| {
            let names = || self.names[a.0].cmp(&self.names[b.0]);
            away(a).total_cmp(&away(b)).then_with(names)
        });
        let named = around.into_iter();
        named
            .map(|(view, pose)| (&self.names[view], pose))
            .collect()
    }
}
