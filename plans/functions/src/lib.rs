//! SQL functions on map layers.
//!
//! | function | true where |
//! |---|---|
//! | `contains(graph, class [, count])` | the view shows at least so many areas of the class (1) |
//! | `related(graph, class, relation, class)` | an area of the first class is so related to one of the second |
//!
//! `graph` is the graph column of a layer like `views`; both functions are null where it is. `contains` on text is
//! DataFusion's own. Relations are those of [`evermap_algorithms::semantic_map::semantic_graph::Relation`]: eight directions, `on`
//! and `touches`.
//!
//! With [`use_class_index`], `contains` on `views` is answered by the layer `class_index`, and graphs are not read.

mod contains;
mod graphs;
mod index;
mod related;
#[cfg(test)]
mod tests;

use datafusion::logical_expr::ScalarUDF;
use datafusion::prelude::SessionContext;

pub use index::use_class_index;

/// Adds the functions to a context.
pub fn register(context: &SessionContext) {
    context.register_udf(ScalarUDF::from(contains::Contains::default()));
    context.register_udf(ScalarUDF::from(related::Related::default()));
}
