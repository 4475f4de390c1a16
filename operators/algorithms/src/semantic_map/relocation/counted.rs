//! Views searched by counting matches, as paper 2 does: the tree `interpretation`, view by view.

use super::interpretation::{InterpretationTree, Shapes};
use super::level::RankedHit;
use super::options::Options;
use super::similarity;
use super::view_map::{Best, Hit};
use crate::semantic_map::semantic_graph::Graph;

/// The views of a map, as the tree `interpretation` knows them.
#[derive(Debug, Clone)]
pub(super) struct CountedViews {
    options: Options,
    views: Vec<Shapes>,
}

impl CountedViews {
    pub(super) fn new<'a>(graphs: impl Iterator<Item = &'a Graph>, options: &Options) -> Self {
        Self {
            views: graphs
                .map(|graph| Shapes::of_view(graph, options))
                .collect(),
            options: options.clone(),
        }
    }

    /// Prepares a view to be looked for.
    pub(super) fn query(&self, graph: &Graph) -> Shapes {
        Shapes::of_query(graph, &self.options)
    }

    /// The `top` of some views with the most matches, of equal ones the first. Views that there are not are passed over.
    pub(super) fn best(
        &self,
        query: &Shapes,
        views: impl Iterator<Item = u32>,
        top: usize,
    ) -> Vec<Hit> {
        let mut tree = InterpretationTree::new(&self.options);
        let mut best = Best::new(top, &self.options);
        for view in views {
            best.add(self.found(query, view, &mut tree));
        }
        let found = best.into_found().into_iter();
        found
            .filter_map(|found| self.hit(query, found.view, &mut tree))
            .collect()
    }

    /// One view, however few areas match; `None` for a view that there is not.
    pub(super) fn compare(&self, query: &Shapes, view: u32) -> Option<Hit> {
        self.hit(query, view, &mut InterpretationTree::new(&self.options))
    }

    /// The best match of each area that has one: areas of the query and of the view, in their order.
    pub(super) fn pairs(&self, query: &Shapes, view: u32) -> Vec<[u16; 2]> {
        let mut tree = InterpretationTree::new(&self.options);
        self.found(query, view, &mut tree);
        tree.pairs()
    }

    fn found(&self, query: &Shapes, view: u32, tree: &mut InterpretationTree) -> Option<RankedHit> {
        let matched = tree.grow(query, self.views.get(view as usize)?);
        Some(RankedHit::new(matched, matched, view, 0))
    }

    fn hit(&self, query: &Shapes, view: u32, tree: &mut InterpretationTree) -> Option<Hit> {
        let shapes = self.views.get(view as usize)?;
        let (matched, areas) = (tree.grow(query, shapes), query.len() as u32);
        Some(Hit {
            view,
            turn_rad: super::view_map::turn_rad(tree.turn(query, shapes)),
            matched,
            score: f64::from(matched) / f64::from(areas.max(1)),
            similarity: similarity(areas, matched),
        })
    }
}
