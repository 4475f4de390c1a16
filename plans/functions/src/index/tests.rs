//! Queries with and without indexes.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

use std::sync::Arc;
use std::time::Instant;

use arrow::array::Array;
use arrow::util::pretty::pretty_format_batches;
use datafusion::catalog::{MemorySchemaProvider, SchemaProvider};
use datafusion::prelude::{SessionContext, col, lit};
use evermap_algorithms::semantic_map::relation_index::{self, names_digest};
use evermap_algorithms::semantic_map::semantic_graph::{Area, Edge, Graph, Relation};
use evermap_schemas::layers::{ClassCount, ClassLeaf, RelatedViews, View};
use evermap_schemas::{Bytes, LayerRow, batch};

use super::*;
use crate::register;
use crate::tests::{context, rows, view, views};

/// Leaves of the views above: one for each, as their contents differ.
fn leaves() -> Vec<ClassLeaf> {
    let contents: [&[(&str, u16)]; 4] = [
        &[("car", 1), ("road", 1)],
        &[("road", 1), ("sign", 1)],
        &[("building", 2), ("tree", 1)],
        &[],
    ];
    let leaf = |((leaf, view), counts): ((u32, View), &[(&str, u16)])| ClassLeaf {
        site: view.site,
        leaf,
        counts: counts
            .iter()
            .map(|(class, areas)| ClassCount {
                class: (*class).to_owned(),
                areas: *areas,
            })
            .collect(),
        views: vec![view.view],
    };
    (0..).zip(views()).zip(contents).map(leaf).collect()
}

const CLASSES: [&str; 5] = ["building", "car", "road", "sign", "tree"];

/// A view's graph, as the operator that makes the index sees it.
fn graph(view: &View) -> Graph {
    let class = |name: &str| CLASSES.iter().position(|class| *class == name).unwrap() as u8;
    let areas = view.graph.areas.iter().map(|area| Area {
        class: class(&area.class),
        pixels: area.pixels,
        u: area.u,
        v: area.v,
        major_px: area.major_px,
        minor_px: area.minor_px,
        orientation_rad: area.orientation_rad,
        eccentricity: area.eccentricity,
    });
    let edges = view.graph.edges.iter().map(|edge| Edge {
        a: edge.a,
        b: edge.b,
        boundary_px: edge.boundary_px,
    });
    Graph {
        width: view.graph.width,
        height: view.graph.height,
        wraps: view.graph.wraps,
        field_of_view_rad: None,
        areas: areas.collect(),
        edges: edges.collect(),
    }
}

/// The rows of `relation_index` for views of one site.
fn relations(mut views: Vec<View>) -> Vec<RelatedViews> {
    views.sort_by(|a, b| a.view.cmp(&b.view));
    let graphs: Vec<Graph> = views.iter().map(graph).collect();
    let digest = names_digest(views.iter().map(|view| view.view.as_str()));
    let index = relation_index::RelationIndex::new(graphs.iter());
    let rows = index
        .iter()
        .map(|((class, relation, other), set)| RelatedViews {
            site: views[0].site.clone(),
            class: CLASSES[usize::from(class)].to_owned(),
            relation: relation.word().to_owned(),
            other: CLASSES[usize::from(other)].to_owned(),
            views: Bytes(set.to_bytes()),
            names: digest.clone(),
        });
    rows.collect()
}

#[tokio::test]
async fn a_layer_that_is_a_query_on_files_is_the_layer() {
    let context = SessionContext::new();
    register(&context);
    let table = context.read_batch(batch(views()).unwrap()).unwrap();
    let (one, two) = (table.clone(), table.clone());
    let halves = one
        .filter(col("view").lt(lit("m")))
        .unwrap()
        .union(two.filter(col("view").gt_eq(lit("m"))).unwrap());
    context
        .register_table(View::NAME, halves.unwrap().into_view())
        .unwrap();
    let rows_of = batch(relations(views())).unwrap();
    context.register_batch(RelatedViews::NAME, rows_of).unwrap();
    use_indexes(&context).await.unwrap();
    for query in [
        "SELECT view FROM views WHERE related(graph, 'car', 'on', 'road')",
        "SELECT v.view FROM views v WHERE related(v.graph, 'car', 'on', 'road')",
        "SELECT view FROM datafusion.public.views WHERE related(graph, 'car', 'on', 'road')",
    ] {
        assert_eq!(rows(&context, query).await.unwrap(), ["car"], "{query}");
        let plan = explained(&context, query).await;
        assert!(plan.contains(RelatedViews::NAME), "{plan}");
    }
    let query = "SELECT view FROM (SELECT view, graph FROM views WHERE view = 'houses') AS views \
                 WHERE related(graph, 'car', 'on', 'road')";
    assert!(rows(&context, query).await.unwrap().is_empty());
}

/// A context with the views above, and with indexes.
async fn indexed(leaves: Vec<ClassLeaf>, relations: Vec<RelatedViews>) -> SessionContext {
    let context = context();
    let leaves = batch(leaves).unwrap();
    context.register_batch(ClassLeaf::NAME, leaves).unwrap();
    let relations = batch(relations).unwrap();
    context
        .register_batch(RelatedViews::NAME, relations)
        .unwrap();
    use_indexes(&context).await.unwrap();
    context
}

#[tokio::test]
async fn an_index_is_opened_whenever_it_answers() {
    let context = indexed(leaves(), relations(views())).await;
    for (index, query) in [
        (
            ClassLeaf::NAME,
            "SELECT view FROM views WHERE contains(graph, 'car')",
        ),
        (
            RelatedViews::NAME,
            "SELECT view FROM views WHERE related(graph, 'car', 'on', 'road')",
        ),
    ] {
        assert_eq!(rows(&context, query).await.unwrap(), ["car"], "{query}");
        let table = context.deregister_table(index).unwrap().unwrap();
        let refused = rows(&context, query).await.unwrap_err();
        let expected = format!("expected a table {index}, found none");
        assert!(refused.contains(&expected), "{refused}");
        context.register_table(index, table).unwrap();
        assert_eq!(rows(&context, query).await.unwrap(), ["car"], "{query}");
    }
}

#[tokio::test]
async fn a_class_that_no_view_has_is_refused() {
    let context = indexed(leaves(), relations(views())).await;
    for (query, class) in [
        (
            "SELECT view FROM views WHERE contains(graph, 'buildin')",
            "buildin",
        ),
        (
            "SELECT count(*) FROM views v WHERE NOT contains(v.graph, 'cars', 2)",
            "cars",
        ),
        (
            "SELECT view FROM views WHERE related(graph, 'car', 'on', 'raod')",
            "raod",
        ),
    ] {
        let refused = rows(&context, query).await.unwrap_err();
        let expected = format!(
            "no view of this map has the class `{class}`; its classes are building, car, road, sign, tree"
        );
        assert!(refused.contains(&expected), "{refused}");
    }
    // What only is called so, or is no literal, is answered by graphs.
    for query in [
        "SELECT view FROM (SELECT view, graph FROM views LIMIT 9) AS views WHERE contains(graph, 'cars')",
        "SELECT view FROM views, (VALUES ('cars')) AS asked(class) WHERE contains(graph, class)",
    ] {
        assert!(rows(&context, query).await.unwrap().is_empty(), "{query}");
    }
}

/// The views above under other names: as many, and with the same graphs.
fn elsewhere() -> Vec<View> {
    let named = |view: View| View {
        view: format!("{} elsewhere", view.view),
        ..view
    };
    views().into_iter().map(named).collect()
}

async fn explained(context: &SessionContext, query: &str) -> String {
    let plan = context.sql(&format!("EXPLAIN {query}")).await.unwrap();
    let plan = plan.collect().await.unwrap();
    pretty_format_batches(&plan).unwrap().to_string()
}

#[tokio::test]
async fn indexes_answer_as_graphs_do_and_these_are_not_read() {
    let (plain, indexed) = (context(), indexed(leaves(), relations(views())).await);
    for query in [
        "SELECT view FROM views WHERE contains(graph, 'building', 2)",
        "SELECT view FROM views WHERE NOT contains(graph, 'car')",
        "SELECT v.view FROM views AS v WHERE contains(v.graph, 'road') AND NOT contains(v.graph, 'car')",
        "SELECT view FROM views WHERE contains(graph, 'road') OR contains(graph, 'tree') OR view = 'nothing'",
        "SELECT a.view FROM views a JOIN views b ON a.site = b.site WHERE contains(a.graph, 'car') AND b.view = 'houses'",
        "SELECT view FROM (SELECT * FROM views) WHERE contains(graph, 'sign')",
        "SELECT contains(graph, 'sign') AS shown FROM views",
        "SELECT view FROM views WHERE related(graph, 'car', 'on', 'road')",
        "SELECT view FROM views WHERE NOT related(graph, 'sign', 'top', 'road')",
        "SELECT view FROM views WHERE related(graph, 'car', 'touches', 'road') AND contains(graph, 'car')",
        "SELECT v.view FROM views v WHERE related(v.graph, 'building', 'touches', 'tree') OR related(v.graph, 'sign', 'above', 'road')",
        "SELECT related(graph, 'tree', 'right of', 'building') AS so FROM views",
    ] {
        let answers = [rows(&plain, query).await, rows(&indexed, query).await];
        assert_eq!(answers[0], answers[1], "{query}");
        assert!(!answers[0].as_ref().unwrap().is_empty(), "{query}");
    }
    for relation in Relation::ALL {
        for (class, other) in CLASSES
            .iter()
            .flat_map(|class| CLASSES.map(|other| (class, other)))
        {
            let query = format!(
                "SELECT view FROM views WHERE related(graph, '{class}', '{relation}', '{other}')"
            );
            let answers = [rows(&plain, &query).await, rows(&indexed, &query).await];
            assert_eq!(answers[0], answers[1], "{query}");
        }
    }
    for (asked, index) in [
        ("contains(graph, 'car')", ClassLeaf::NAME),
        ("related(graph, 'car', 'on', 'road')", RelatedViews::NAME),
    ] {
        let query = format!("SELECT view FROM views WHERE NOT {asked}");
        let plan = explained(&indexed, &query).await;
        assert!(plan.contains(index) && !plan.contains("graph"), "{plan}");
    }
}

#[tokio::test]
async fn an_index_of_other_views_is_not_used() {
    let mut few = leaves();
    few.pop();
    let mut others = leaves();
    for (leaf, view) in others.iter_mut().zip(elsewhere()) {
        leaf.views = vec![view.view];
    }
    let mut twice = leaves();
    twice[3].views = vec!["car".to_owned()];
    for leaves in [few, others, twice] {
        // As many views as there are, of other names.
        let context = indexed(leaves, relations(elsewhere())).await;
        for (condition, found) in [
            ("NOT contains(graph, 'car')", 3),
            ("NOT related(graph, 'car', 'on', 'road')", 3),
            ("related(graph, 'car', 'on', 'road')", 1),
        ] {
            let query = format!("SELECT view FROM views WHERE {condition}");
            let plan = explained(&context, &query).await;
            assert!(!plan.contains("_index"), "{plan}");
            assert_eq!(
                rows(&context, &query).await.unwrap().len(),
                found,
                "{query}"
            );
        }
    }
    // Two digests for one site: one of them is of other views.
    let both = [relations(views()), relations(elsewhere())].concat();
    let context = indexed(leaves(), both).await;
    let query = "SELECT view FROM views WHERE related(graph, 'car', 'on', 'road')";
    assert!(!explained(&context, query).await.contains("_index"));
}

#[tokio::test]
async fn what_only_has_the_name_of_the_layer_is_not_asked_of_its_indexes() {
    let context = indexed(leaves(), relations(views())).await;
    // Another map, in which no view shows a car, though they are named alike.
    let mut bare = views();
    bare.iter_mut().for_each(|view| {
        view.graph.areas.clear();
        view.graph.edges.clear();
    });
    let table = batch(bare).unwrap();
    let table = context.read_batch(table).unwrap().into_view();
    let old: Arc<dyn SchemaProvider> = Arc::new(MemorySchemaProvider::new());
    old.register_table(View::NAME.to_owned(), Arc::clone(&table))
        .unwrap();
    let catalog = context.catalog("datafusion").unwrap();
    catalog.register_schema("old", old).unwrap();
    context.register_table("stable_views", table).unwrap();
    for query in [
        "SELECT view FROM old.views WHERE contains(graph, 'car')",
        "SELECT v.view FROM old.views v WHERE related(v.graph, 'car', 'on', 'road')",
        "SELECT view FROM stable_views AS views WHERE contains(views.graph, 'car')",
        "SELECT a.view FROM (SELECT a.site FROM views a) b JOIN stable_views a ON a.site = b.site WHERE contains(a.graph, 'car')",
    ] {
        assert!(rows(&context, query).await.unwrap().is_empty(), "{query}");
    }
    let query = "SELECT view FROM datafusion.public.views WHERE contains(graph, 'car')";
    assert_eq!(rows(&context, query).await.unwrap(), ["car"]);
    assert!(explained(&context, query).await.contains("class_index"));
}

/// 13,000 views of fifteen areas in a circle, whose classes are those of the number's digits.
fn many() -> Vec<View> {
    let numbered = |number: usize| {
        let class = |area: usize| CLASSES[(number / (area + 1) + area * area) % CLASSES.len()];
        let areas: Vec<(&str, f32, f32)> = (0..15)
            .map(|area| {
                (
                    class(area),
                    (area * 37 % 100) as f32,
                    (area * 7 % 30) as f32,
                )
            })
            .collect();
        let edges: Vec<(u16, u16)> = (0..14).map(|a| (a, a + 1)).collect();
        view(&format!("monday/roof/{number:09}"), &areas, &edges)
    };
    (0..13_000).map(numbered).collect()
}

#[tokio::test]
async fn among_13_000_views_the_index_answers_as_graphs_do() {
    let (plain, indexed) = (SessionContext::new(), SessionContext::new());
    for context in [&plain, &indexed] {
        register(context);
        let views = batch(many()).unwrap();
        context.register_batch(View::NAME, views).unwrap();
    }
    let relations = batch(relations(many())).unwrap();
    indexed
        .register_batch(RelatedViews::NAME, relations)
        .unwrap();
    use_indexes(&indexed).await.unwrap();
    let query = "SELECT view FROM views WHERE related(graph, 'car', 'on', 'road')";
    assert!(!explained(&indexed, query).await.contains("graph"));
    let mut answers = Vec::new();
    for (name, context) in [
        ("graphs", &plain),
        ("index, read", &indexed),
        ("index", &indexed),
    ] {
        let start = Instant::now();
        answers.push(rows(context, query).await.unwrap());
        eprintln!(
            "related among 13,000 views by {name}, whole query: {:?}",
            start.elapsed()
        );
    }
    assert!(answers[0].len() > 1000 && answers[0].len() < 12_000);
    assert!(answers.iter().all(|answer| *answer == answers[0]));
    let of_all = names::names(&indexed, "SELECT site, \"view\" FROM views")
        .await
        .unwrap();
    let index = RelationIndex::of(&indexed, of_all).await.unwrap().unwrap();
    let asked = ("car".to_owned(), Relation::On, "road".to_owned());
    assert_eq!(index.views(&asked).await.unwrap().len(), answers[0].len());
    let start = Instant::now();
    let found = index.views(&asked).await.unwrap();
    eprintln!(
        "the look-up itself, {} views: {:?}",
        found.len(),
        start.elapsed()
    );
}
