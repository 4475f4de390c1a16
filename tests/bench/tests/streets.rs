//! Another visit to a street is found, whichever way one looks.
//!
//! Figures are printed with `-- --nocapture`.
#![allow(clippy::unwrap_used, clippy::print_stderr)]

use evermap_algorithms::semantic_map::relocation::{
    CalibrationOptions, Options, ViewMap, are_apart, distinctness, self_search,
};
use evermap_algorithms::semantic_map::semantic_graph::{Graph, GraphOptions, Labels};
use evermap_worlds::{LabelKind, LabelView, STREET_CLASSES, Street, StreetLabels, street_labels};
use nalgebra::Vector3;
use rayon::prelude::*;

/// Small views of 400 m of street. Of one every 4 m at most three of the 100 in the map are within 5 m.
fn labels(seed: u64, spacing_m: f64, repeated_mistakes: f64) -> StreetLabels {
    street_labels(&Street {
        seed,
        repeated_mistakes,
        length_m: 400.0,
        spacing_m,
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
        let labels = labels(21, 4.0, repeated_mistakes);
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

/// What the map's own drive says that a hit is worth holds for another visit, whose place is in the map or is not.
#[test]
fn another_visit_is_seldom_wrong_when_it_is_sure() {
    // How often a probability of at least so much was said, and how often wrongly.
    let least = [0.5, 0.8, 0.9, 0.95, 0.99];
    let (mut said, mut wrong, mut asked) = ([0_u32; 5], [0_u32; 5], 0);
    for (seed, spacing_m, repeated) in [(22, 4.0, 0.0), (23, 3.0, 0.5), (24, 1.5, 0.5)] {
        let labels = labels(seed, spacing_m, repeated);
        let [map, queries] = [0, 1].map(|visit| {
            let views = labels.views(visit, LabelKind::Noisy);
            views.collect::<Vec<LabelView>>()
        });
        let place = |view: &LabelView| {
            let [x, y, z, ..] = view.map_from_vehicle.to_array();
            Vector3::new(x, y, z)
        };
        let graphs: Vec<Graph> = map.par_iter().map(|view| graph(view, 0)).collect();
        let places: Vec<Vector3<f64>> = map.iter().map(place).collect();
        let options = CalibrationOptions::default();
        let views = ViewMap::new(graphs.iter(), Options::default());
        let learnt = self_search(&views, &graphs, &places, &options).unwrap();
        let curve = learnt.calibration.unwrap();
        let answer = |query: &LabelView, mapped: bool| {
            let (at, query) = (place(query), views.query(&graph(query, 0)));
            let apart = |a: &Vector3<f64>, view: u32| are_apart(a, &places[view as usize], 5.0);
            let allowed = |view: u32| mapped || apart(&at, view);
            let hit = views.search(&query, 1, allowed)[0];
            let there = &places[hit.view as usize];
            let elsewhere = |view: u32| allowed(view) && apart(there, view);
            let best = |allowed: &dyn Fn(u32) -> bool| views.search(&query, 1, allowed);
            let distinctness = distinctness(&hit, 0..views.len() as u32, elsewhere, best).unwrap();
            let right = (at - there).norm() <= options.within_m;
            (curve.probability(distinctness), right)
        };
        let answers: Vec<(f64, bool)> = queries
            .par_iter()
            .flat_map_iter(|query| [answer(query, true), answer(query, false)])
            .collect();
        asked += answers.len();
        for (least, (said, wrong)) in least.iter().zip(said.iter_mut().zip(&mut wrong)) {
            let sure = answers.iter().filter(|(chance, _)| chance >= least);
            *said += sure.clone().count() as u32;
            *wrong += sure.filter(|(_, right)| !right).count() as u32;
        }
        eprintln!("street {seed}: {learnt:?}");
    }
    for (least, (said, wrong)) in least.iter().zip(said.iter().zip(&wrong)) {
        eprintln!("at least {least}: said of {said} of {asked}, wrong of {wrong}");
        let allowed = (1.0 - least) * f64::from(*said);
        assert!(f64::from(*wrong) <= allowed.max(1.0), "{wrong} of {said}");
    }
    // Half of the questions have no right answer.
    assert!(said[1] as usize > asked / 3, "{said:?} of {asked}");
}
