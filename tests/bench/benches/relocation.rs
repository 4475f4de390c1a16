//! How long it takes to find a view, and to answer a question, among 1,300, 13,000 and 130,000 views of simulated
//! streets with noisy labels. One thread.
//!
//! A view every 4.9 m of 1.6 km is rendered, labelled badly, and made a graph. The views between, 0.12 m apart, are the
//! nearest of these with every area disturbed as much as areas are between views so near together, and one in ten
//! missing. Ten kilometres more are the same streets with every place turned by an angle of its own.
#![allow(missing_docs, clippy::expect_used, clippy::print_stdout)]

use std::f32::consts::TAU;
use std::hint::black_box;
use std::time::Duration;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use evermap_algorithms::semantic_map::relation_index::RelationIndex;
use evermap_algorithms::semantic_map::relocation::{ClassIndex, Options, Query, ViewMap};
use evermap_algorithms::semantic_map::semantic_graph::{
    Area, Graph, GraphOptions, Labels, Relation,
};
use evermap_bench::relocation::{CountIndex, like};
use evermap_worlds::{LabelKind, STREET_CLASSES, Street, street_labels};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

const CLASSES: u8 = STREET_CLASSES.len() as u8;
const TREE: u8 = 0;
const ROAD: u8 = 2;
const BUILDING: u8 = 6;
const CAR: u8 = 7;
/// Views that are rendered.
const PLACES: usize = 325;

fn rendered(visit: usize) -> Vec<Graph> {
    let street = Street {
        length_m: 1600.0,
        spacing_m: 1600.0 / PLACES as f64,
        ..Street::default()
    };
    let labels = street_labels(&street).expect("a street");
    let views = labels.views(visit, LabelKind::Noisy);
    views
        .map(|view| {
            let image = Labels {
                width: view.width,
                height: view.height,
                values: &view.labels,
            };
            let options = GraphOptions {
                classes: CLASSES,
                wraps: true,
                min_px: GraphOptions::share_px(0.0001, view.width, view.height),
            };
            Graph::from_labels(&image, &options).expect("a graph")
        })
        .collect()
}

/// The same place from a little farther on, all of it turned.
fn disturbed(graph: &Graph, turn: f32, random: &mut ChaCha8Rng) -> Graph {
    let px_per_rad = graph.width as f32 / TAU;
    let mut around = |scale: f32| scale * (random.random::<f32>() - 0.5);
    let areas = graph.areas.iter().map(|area| Area {
        u: (area.u + (turn + around(0.2)) * px_per_rad).rem_euclid(graph.width as f32),
        v: area.v + around(0.05) * px_per_rad,
        pixels: (area.pixels as f32 * around(0.5).exp()) as u32,
        major_px: area.major_px * around(0.3).exp(),
        eccentricity: (area.eccentricity + around(0.1)).clamp(0.0, 0.99),
        orientation_rad: area.orientation_rad + around(0.3),
        ..*area
    });
    let mut graph = Graph {
        areas: areas.collect(),
        ..graph.clone()
    };
    for area in &mut graph.areas {
        // Too small to take part, as if it were missing.
        if around(1.0) > 0.4 {
            area.pixels = 1;
        }
    }
    graph
}

fn map_of(places: &[Graph], views: usize) -> Vec<Graph> {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let copies = views.div_ceil(places.len());
    let mut graphs = Vec::with_capacity(views);
    for place in 0..views {
        let (place, copy) = (place / copies, place % copies);
        // 40 copies are of one place; others lie elsewhere.
        let turn = (copy / 40) as f32 * 2.4;
        graphs.push(disturbed(&places[place % places.len()], turn, &mut random));
    }
    graphs
}

fn counts(graph: &Graph) -> Vec<u16> {
    (0..CLASSES)
        .map(|class| graph.count(class) as u16)
        .collect()
}

/// Bytes of the graphs as a table holds them: an area's seven numbers of four bytes and its class, an edge's eight bytes.
fn megabytes(graphs: &[Graph]) -> f64 {
    let bytes = |graph: &Graph| 29 * graph.areas.len() + 8 * graph.edges.len() + 9;
    graphs.iter().map(bytes).sum::<usize>() as f64 / 1e6
}

fn relocation(criterion: &mut Criterion) {
    let (places, asked) = (rendered(0), rendered(1));
    let mut group = criterion.benchmark_group("relocation");
    group
        .warm_up_time(Duration::from_millis(500))
        .measurement_time(Duration::from_secs(2));
    group.sample_size(20);
    for views in [1_300, 13_000, 130_000] {
        let graphs = map_of(&places, views);
        println!("{views} views: {:.1} MB of graphs", megabytes(&graphs));
        let map = ViewMap::new(graphs.iter(), Options::default());
        let index = ClassIndex::new(graphs.iter(), CLASSES);
        let contents = CountIndex::new(&graphs, CLASSES);
        let relations = RelationIndex::new(graphs.iter());
        let queries: Vec<(Query, Vec<u16>)> = asked
            .iter()
            .map(|graph| (map.query(graph), counts(graph)))
            .collect();
        let known: Vec<Vec<u16>> = graphs.iter().step_by(97).map(counts).collect();
        let mut next = queries.iter().cycle();
        group.bench_function(BenchmarkId::new("tree", views), |bencher| {
            bencher.iter(|| next.next().map(|(query, _)| map.search(query, 1, |_| true)));
        });
        let ahead = Options {
            headings: 1,
            ..Options::default()
        };
        let map_ahead = ViewMap::new(graphs.iter(), ahead);
        let mut next = queries.iter().cycle();
        group.bench_function(BenchmarkId::new("tree, heading known", views), |bencher| {
            bencher.iter(|| {
                let (query, _) = next.next()?;
                Some(map_ahead.search(query, 1, |_| true))
            });
        });
        let mut next = queries.iter().cycle();
        group.bench_function(BenchmarkId::new("index and tree", views), |bencher| {
            bencher.iter(|| {
                let (query, counts) = next.next()?;
                Some(map.among(query, &index.near(counts, 4, |_| true), 1))
            });
        });
        let mut next = known.iter().cycle();
        group.bench_function(BenchmarkId::new("index", views), |bencher| {
            bencher.iter(|| next.next().map(|counts| like(&index, counts)));
        });
        group.bench_function(BenchmarkId::new("two buildings", views), |bencher| {
            bencher.iter(|| black_box(contents.exactly(BUILDING, 2)).to_vec());
        });
        group.bench_function(BenchmarkId::new("no car", views), |bencher| {
            bencher.iter(|| black_box(contents.without(CAR)).to_vec());
        });
        group.bench_function(BenchmarkId::new("car on road", views), |bencher| {
            bencher.iter(|| relations.views(CAR, Relation::On, ROAD).to_vec());
        });
        group.bench_function(
            BenchmarkId::new("trees right of building", views),
            |bencher| {
                bencher.iter(|| relations.views(TREE, Relation::RightOf, BUILDING).to_vec());
            },
        );
    }
    group.finish();
}

criterion_group!(benches, relocation);
criterion_main!(benches);
