//! Another visit to a street is found, whichever way one looks.
//!
//! Figures are printed with `-- --nocapture`.
#![allow(clippy::unwrap_used, clippy::print_stderr)]

use evermap_algorithms::semantic_map::relocation::{Options, ViewMap};
use evermap_algorithms::semantic_map::semantic_graph::{Graph, GraphOptions, Labels};
use evermap_worlds::{LabelKind, LabelView, STREET_CLASSES, Street, StreetLabels, street_labels};
use rayon::prelude::*;

/// A small view of every 4 m of 400 m: of 100 views of the map at most three are within 5 m.
fn labels(seed: u64, repeated_mistakes: f64) -> StreetLabels {
    street_labels(&Street {
        seed,
        repeated_mistakes,
        length_m: 400.0,
        spacing_m: 4.0,
        width_px: 512,
        height_px: 166,
        ..Street::default()
    })
    .unwrap()
}

/// The graph of a panorama that looks farther to the right by some columns.
fn graph(view: &LabelView, columns: usize) -> Graph {
    let rows = view.labels.chunks_exact(view.width as usize);
    let turned = rows.flat_map(|row| row[columns..].iter().chain(&row[..columns]).copied());
    let values: Vec<u8> = turned.collect();
    let labels = Labels {
        width: view.width,
        height: view.height,
        values: &values,
    };
    let options = GraphOptions {
        classes: STREET_CLASSES.len() as u8,
        wraps: true,
        min_px: GraphOptions::share_px(0.0001, view.width, view.height),
    };
    Graph::from_labels(&labels, &options).unwrap()
}

#[test]
fn another_visit_is_found_at_any_heading_wherever_labels_err() {
    for repeated_mistakes in [0.0, 1.0] {
        let labels = labels(21, repeated_mistakes);
        let [map, queries] = [0, 1].map(|visit| {
            let views = labels.views(visit, LabelKind::Noisy);
            views.collect::<Vec<LabelView>>()
        });
        let graphs: Vec<Graph> = map.par_iter().map(|view| graph(view, 0)).collect();
        let views = ViewMap::new(graphs.iter(), Options::default());
        let right = |turned: usize| {
            let found = queries.par_iter().enumerate().filter(|(at, query)| {
                let columns = turned * at * 197 % query.width as usize;
                let asked = views.query(&graph(query, columns));
                let hits = views.search(&asked, 1, |_| true);
                let Some(hit) = hits.first() else {
                    return false;
                };
                let place = |view: &LabelView| view.map_from_vehicle.to_array();
                let (here, there) = (place(query), place(&map[hit.view as usize]));
                let looked = columns as f64 / f64::from(query.width) * std::f64::consts::TAU;
                let yaw = here[5].atan2(here[6]) - there[5].atan2(there[6]);
                let wrong = hit.turn_rad - looked + 2.0 * yaw;
                (here[0] - there[0]).hypot(here[1] - there[1]) <= 5.0 && wrong.cos() > 0.9
            });
            found.count() as f64 / queries.len() as f64
        };
        let (ahead, anyhow) = (right(0), right(1));
        eprintln!("{repeated_mistakes} of mistakes repeated: {ahead:.3} ahead, {anyhow:.3} turned");
        assert!(ahead >= 0.85 && anyhow >= 0.85, "{ahead} {anyhow}");
    }
}
