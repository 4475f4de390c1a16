//! The adjacency of Algorithm 1, and its first half: who is connected to whom.

use super::cells::{CellIndex, distance};
use super::thinning::{Visit, Visits};

/// Nodes with positions and symmetric, sorted neighbour lists; removed nodes know who took over.
pub(super) struct Graph {
    pub(super) positions: Vec<[f64; 3]>,
    neighbours: Vec<Vec<u32>>,
    /// The node itself while it exists, else the node that replaced it.
    heir: Vec<u32>,
}

impl Graph {
    pub(super) fn new(positions: Vec<[f64; 3]>) -> Self {
        let count = positions.len() as u32;
        Self {
            neighbours: vec![Vec::new(); positions.len()],
            heir: (0..count).collect(),
            positions,
        }
    }

    /// Nodes that still exist, ascending.
    pub(super) fn nodes(&self) -> impl Iterator<Item = u32> + '_ {
        (0..self.positions.len() as u32).filter(|&node| self.exists(node))
    }

    pub(super) fn exists(&self, node: u32) -> bool {
        self.heir[node as usize] == node
    }

    pub(super) fn position(&self, node: u32) -> &[f64; 3] {
        &self.positions[node as usize]
    }

    pub(super) fn neighbours(&self, node: u32) -> &[u32] {
        &self.neighbours[node as usize]
    }

    pub(super) fn degree(&self, node: u32) -> usize {
        self.neighbours(node).len()
    }

    pub(super) fn adjacent(&self, a: u32, b: u32) -> bool {
        self.neighbours(a).binary_search(&b).is_ok()
    }

    pub(super) fn length(&self, a: u32, b: u32) -> f64 {
        distance(self.position(a), self.position(b))
    }

    pub(super) fn connect(&mut self, a: u32, b: u32) {
        if a == b {
            return;
        }
        for (from, to) in [(a, b), (b, a)] {
            let list = &mut self.neighbours[from as usize];
            if let Err(at) = list.binary_search(&to) {
                list.insert(at, to);
            }
        }
    }

    /// Removes a node; what it stood for is from now on `heir`'s.
    pub(super) fn remove(&mut self, node: u32, heir: u32) {
        for other in std::mem::take(&mut self.neighbours[node as usize]) {
            let list = &mut self.neighbours[other as usize];
            if let Ok(at) = list.binary_search(&node) {
                list.remove(at);
            }
        }
        self.heir[node as usize] = heir;
    }

    /// The existing node that stands for `node` now.
    pub(super) fn standing_for(&self, mut node: u32) -> u32 {
        while self.heir[node as usize] != node {
            node = self.heir[node as usize];
        }
        node
    }
}

/// Algorithm 1, lines 1–12: connect all within `connect_m`, but not what followed within the same
/// drive while it stayed within `connect_m`; then connect in the order driven. `most_followers`
/// bounds how far ahead the second step looks, for drives that stand and tremble for hours. Gives the visits, too.
pub(super) fn connect(
    visits: Visits,
    connect_m: f64,
    most_followers: usize,
) -> (Graph, Vec<Vec<Visit>>) {
    let Visits { nodes, drives, .. } = visits;
    let followed = followers(&nodes, &drives, connect_m, most_followers);
    let mut graph = Graph::new(nodes);
    let mut index = CellIndex::new(connect_m);
    for id in 0..graph.positions.len() as u32 {
        let position = graph.positions[id as usize];
        let mut near = Vec::new();
        index.near(&position, |other| near.push(other));
        for other in near {
            let close = graph.length(id, other) <= connect_m;
            if close && followed.binary_search(&(other, id)).is_err() {
                graph.connect(id, other);
            }
        }
        index.insert(id, &position);
    }
    for drive in &drives {
        for pair in drive.windows(2) {
            graph.connect(pair[0].node, pair[1].node);
        }
    }
    (graph, drives)
}

/// Pairs (smaller id, larger id) that some drive visited one after the other without leaving the
/// radius in between: sorted, without repeats. Looks at `most` visits ahead.
fn followers(
    nodes: &[[f64; 3]],
    drives: &[Vec<Visit>],
    connect_m: f64,
    most: usize,
) -> Vec<(u32, u32)> {
    let mut pairs = Vec::new();
    for drive in drives {
        let mut sorted_until = pairs.len();
        for (k, from) in drive.iter().enumerate() {
            let from = from.node;
            let within = |to: &&Visit| {
                distance(&nodes[from as usize], &nodes[to.node as usize]) <= connect_m
            };
            let after = drive[k + 1..].iter().take_while(within).take(most);
            pairs.extend(after.map(|to| (from.min(to.node), from.max(to.node))));
            // A drive that goes round and round says the same again and again.
            if pairs.len() > 2 * sorted_until.max(1 << 16) {
                pairs.sort_unstable();
                pairs.dedup();
                sorted_until = pairs.len();
            }
        }
    }
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}
