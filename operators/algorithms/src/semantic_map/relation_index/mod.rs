//! Views by pairs of classes and how they lie, and what tells of which views an index is.

#[cfg(test)]
mod tests;
mod view_set;

use std::collections::BTreeMap;

use crate::semantic_map::semantic_graph::{Graph, Relation};
pub use view_set::ViewSet;

/// Relations between areas that are collected before equal ones become one.
const MANY: usize = 1 << 16;

/// For each pair of classes and each relation the views in which it holds: 'car on road' is one look-up.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RelationIndex {
    sets: BTreeMap<(u8, Relation, u8), ViewSet>,
    none: ViewSet,
}

impl RelationIndex {
    /// Indexes views, numbered in their order.
    pub fn new<'a>(graphs: impl ExactSizeIterator<Item = &'a Graph>) -> Self {
        let mut index = Self {
            sets: BTreeMap::new(),
            none: ViewSet::none(graphs.len()),
        };
        for (graph, view) in graphs.zip(0_u32..) {
            let mut found = directions(graph);
            found.extend(contacts(graph));
            found.sort_unstable();
            found.dedup();
            for relation in found {
                let set = index.sets.entry(relation);
                set.or_insert_with(|| index.none.clone()).insert(view);
            }
        }
        index
    }

    /// Which class is in which relation to which, and the views in which it is: the first class by number, then the
    /// relation, then the other class.
    pub fn iter(&self) -> impl Iterator<Item = ((u8, Relation, u8), &ViewSet)> {
        self.sets.iter().map(|(related, views)| (*related, views))
    }

    /// The views in which some area of class `a` is in `relation` to some other area of class `b`; exactly those of
    /// [`Graph::holds`].
    pub fn views(&self, a: u8, relation: Relation, b: u8) -> &ViewSet {
        self.sets.get(&(a, relation, b)).unwrap_or(&self.none)
    }
}

fn directions(graph: &Graph) -> Vec<(u8, Relation, u8)> {
    // No more is reserved than is kept: a graph of 65,535 areas has billions of pairs.
    let mut found = Vec::with_capacity(graph.areas.len().pow(2).min(MANY));
    for (at, a) in graph.areas.iter().enumerate() {
        for (other, b) in graph.areas.iter().enumerate() {
            if at != other
                && let Some(direction) = Relation::direction(graph.offset(b, a))
            {
                found.push((a.class, direction, b.class));
            }
        }
        // Many areas of few classes: most are the same.
        if found.len() > MANY {
            found.sort_unstable();
            found.dedup();
        }
    }
    found
}

fn contacts(graph: &Graph) -> impl Iterator<Item = (u8, Relation, u8)> + '_ {
    [Relation::On, Relation::Touches]
        .into_iter()
        .flat_map(move |relation| {
            let pairs = graph.related(relation);
            pairs.map(move |[a, b]| (graph.areas[a].class, relation, graph.areas[b].class))
        })
}

/// What tells views from others by their names, whatever their number: a digest of the names in the order given, 64
/// hexadecimal digits.
pub fn names_digest<'a>(names: impl Iterator<Item = &'a str>) -> String {
    let mut digest = blake3::Hasher::new();
    for name in names {
        // With its length: names may hold whatever would be put between them.
        digest.update(&(name.len() as u64).to_le_bytes());
        digest.update(name.as_bytes());
    }
    digest.finalize().to_hex().to_string()
}
