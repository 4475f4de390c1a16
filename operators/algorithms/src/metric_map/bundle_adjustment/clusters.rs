//! Unknowns that see the same landmarks, put together.
//!
//! Source: Kushal & Agarwal, *Visibility based preconditioning for bundle adjustment* (CVPR 2012). Theirs are found by
//! clustering a graph of all pairs that see a common landmark, whose size grows with the square of the drives through a
//! place; ours by leaders, in one pass over the observations: a pose joins the cluster of the leader with whom it
//! shares most, or leads a new one. Poses that see nothing (a tunnel, a night) are put into runs along their drive.

use super::elimination::Layout;

/// A partition of the unknowns.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Clusters {
    /// The cluster of each unknown.
    pub(super) of: Vec<u32>,
    /// How many there are.
    pub(super) count: usize,
}

/// Shares of a leader's landmarks that are tried, from the finest clusters to the coarsest.
const SHARES: [f64; 9] = [0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1];

impl Clusters {
    /// The finest clusters of at most `most`, or the coarsest there are. What sees nothing is with its `kin`, as
    /// [`Bundle::kin`](super::schur::Bundle::kin) has it, by as many as `most` clusters have on average.
    pub(super) fn by_visibility(
        layout: &Layout,
        landmarks: usize,
        kin: &[u32],
        most: usize,
    ) -> Self {
        let seen = layout.by_block.iter().map(|own| distinct(layout, own));
        let mut seen: Vec<Vec<u32>> = seen.collect();
        let run = kin.len().div_ceil(most.max(1));
        let things = landmarks + show_runs(&mut seen, landmarks, kin, run);
        let [finer @ .., coarsest] = &SHARES;
        finer
            .iter()
            .find_map(|share| Self::with_share(&seen, things, *share, most))
            .or_else(|| Self::with_share(&seen, things, *coarsest, usize::MAX))
            .unwrap_or_default()
    }

    /// Clusters that were led one after the other put together, evenly, until there are no more than `most`.
    pub(super) fn joined(mut self, most: usize) -> Self {
        if self.count > most {
            for cluster in &mut self.of {
                *cluster = (*cluster as usize * most / self.count) as u32;
            }
            self.count = most;
        }
        self
    }

    /// `None` when there are more than `most`: a landmark has no more leaders than there are clusters, so that trying
    /// costs no more than `most` steps an observation.
    fn with_share(seen: &[Vec<u32>], landmarks: usize, share: f64, most: usize) -> Option<Self> {
        let mut leaders: Vec<Vec<u32>> = vec![Vec::new(); landmarks];
        let mut common: Vec<u32> = Vec::new();
        let mut met: Vec<u32> = Vec::new();
        let mut of = Vec::with_capacity(seen.len());
        for own in seen {
            for leader in own.iter().flat_map(|landmark| &leaders[*landmark as usize]) {
                if common[*leader as usize] == 0 {
                    met.push(*leader);
                }
                common[*leader as usize] += 1;
            }
            let counted = met.drain(..);
            let counted =
                counted.map(|leader| (std::mem::take(&mut common[leader as usize]), leader));
            // Of equals the first.
            let best = counted.max_by_key(|(count, leader)| (*count, u32::MAX - leader));
            let joined = best.filter(|(count, _)| f64::from(*count) >= share * own.len() as f64);
            let cluster = match joined {
                Some((_, leader)) => leader,
                None if common.len() == most => return None,
                None => {
                    let cluster = common.len() as u32;
                    common.push(0);
                    own.iter()
                        .for_each(|landmark| leaders[*landmark as usize].push(cluster));
                    cluster
                }
            };
            of.push(cluster);
        }
        Some(Self {
            of,
            count: common.len(),
        })
    }

    /// Each cluster cut into runs of at most `most` unknowns.
    pub(super) fn cut(&self, most: usize) -> Self {
        let mut open: Vec<Option<(u32, usize)>> = vec![None; self.count];
        let mut count = 0;
        let of = self.of.iter().map(|cluster| {
            let run = &mut open[*cluster as usize];
            match run {
                Some((part, members)) if *members < most => {
                    *members += 1;
                    *part
                }
                _ => {
                    let part = count;
                    count += 1;
                    *run = Some((part, 1));
                    part
                }
            }
        });
        Self {
            of: of.collect(),
            count: count as usize,
        }
    }

    /// The unknowns of each cluster, ascending.
    pub(super) fn members(&self) -> Vec<Vec<u32>> {
        let mut members = vec![Vec::new(); self.count];
        for (block, cluster) in (0_u32..).zip(&self.of) {
            members[*cluster as usize].push(block);
        }
        members
    }
}

/// Each unknown that sees nothing is shown the run that it is in, of at most `most` of its kin, as a landmark of their own;
/// gives the number of runs.
fn show_runs(seen: &mut [Vec<u32>], landmarks: usize, kin: &[u32], most: usize) -> usize {
    let blind = (0..seen.len()).filter(|block| seen[*block].is_empty());
    let blind: Vec<usize> = blind.collect();
    let kin: Vec<u32> = blind.iter().map(|block| kin[*block]).collect();
    let families = kin.iter().max().map_or(0, |last| *last as usize + 1);
    let kin = Clusters {
        of: kin,
        count: families,
    };
    let runs = kin.cut(most);
    for (block, run) in blind.iter().zip(&runs.of) {
        seen[*block].push(landmarks as u32 + run);
    }
    runs.count
}

/// Landmarks of some sights of one unknown, each once.
fn distinct(layout: &Layout, own: &[u32]) -> Vec<u32> {
    let landmarks = own
        .iter()
        .map(|place| layout.sights[*place as usize].landmark);
    let mut landmarks: Vec<u32> = landmarks.collect();
    landmarks.dedup();
    landmarks
}
