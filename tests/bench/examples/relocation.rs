//! `relocation [LENGTH_M [SEED]]`: how well views of a simulated street are found by their semantic graphs.
//!
//! The experiments of paper 2 (metric-topological-semantic map), section V-B, on its distances: a database of every 40th
//! of views 0.123 m apart (one every 4.9 m), and queries half-way between (paper: distant images), a quarter of the
//! panorama's width (paper: monocular images), without cars, and on another visit.

use std::error::Error;
use std::f64::consts::FRAC_PI_2;
use std::io::Write;

use evermap_algorithms::semantic_map::relocation::{Hit, Options, Scales, ViewMap};
use evermap_algorithms::semantic_map::semantic_graph::{Graph, GraphOptions, Labels};
use evermap_bench::relocation::{Distances, EvaluationOptions, estimate_scales, evaluate};
use evermap_worlds::{LabelKind, LabelView, STREET_CLASSES, Street, StreetLabels, street_labels};
use nalgebra::Vector3;
use rayon::prelude::*;

/// Of views 0.123 m apart every 20th: the database and the queries between in turn.
const SPACING_M: f64 = 0.123 * 20.0;
/// As in the plan `relocate`.
const MIN_AREA_SHARE: f64 = 0.0001;
/// Class of cars.
const CAR: u8 = 7;

type Outcome<T> = Result<T, Box<dyn Error>>;

/// A view with the truth.
struct Seen {
    graph: Graph,
    /// A quarter of the width, in the middle.
    crop: Graph,
    position: Vector3<f64>,
}

fn graph(width: u32, values: &[u8], wraps: bool) -> Outcome<Graph> {
    let height = values.len() as u32 / width.max(1);
    let labels = Labels {
        width,
        height,
        values,
    };
    let options = GraphOptions {
        classes: STREET_CLASSES.len() as u8,
        wraps,
        min_px: GraphOptions::share_px(MIN_AREA_SHARE, width, height),
    };
    Ok(Graph::from_labels(&labels, &options)?)
}

/// A camera that looks ahead: a quarter of the columns, and rows for four to three.
fn crop(view: &LabelView) -> Outcome<Graph> {
    let (width, height) = (view.width as usize, view.height as usize);
    let (wide, high) = (width / 4, (width / 4 * 3 / 4).min(height));
    let (left, top) = ((width - wide) / 2, (height - high) / 2);
    let rows = view.labels.chunks_exact(width).skip(top).take(high);
    let values: Vec<u8> = rows
        .flat_map(|row| &row[left..left + wide])
        .copied()
        .collect();
    graph(wide as u32, &values, false)
}

fn seen(labels: &StreetLabels, visit: usize, kind: LabelKind) -> Outcome<Vec<Seen>> {
    let views = (0..labels.len()).into_par_iter().map(|index| {
        let view = labels.view(visit, index, kind).ok_or("no such view")?;
        let [x, y, z, ..] = view.map_from_vehicle.to_array();
        Ok(Seen {
            graph: graph(view.width, &view.labels, true).map_err(|error| error.to_string())?,
            crop: crop(&view).map_err(|error| error.to_string())?,
            position: Vector3::new(x, y, z),
        })
    });
    let views: Result<Vec<Seen>, String> = views.collect();
    Ok(views?)
}

/// Every second of a visit's views, from the first or from the second on.
fn every_second(views: &[Seen], from: usize) -> Vec<&Seen> {
    views.iter().skip(from).step_by(2).collect()
}

struct Experiment<'a> {
    name: &'a str,
    queries: Vec<&'a Seen>,
    crops: bool,
    options: Options,
}

fn run(experiment: &Experiment<'_>, database: &[&Seen], out: &mut impl Write) -> Outcome<()> {
    let map = ViewMap::new(
        database.iter().map(|seen| &seen.graph),
        experiment.options.clone(),
    );
    let row = |query: usize, value: fn(&Hit) -> f64| -> Vec<f64> {
        let seen = experiment.queries[query];
        let asked = map.query(if experiment.crops {
            &seen.crop
        } else {
            &seen.graph
        });
        let hits = (0..map.len() as u32).map(|view| map.compare(&asked, view));
        hits.map(|hit| 1.0 - hit.as_ref().map_or(0.0, value))
            .collect()
    };
    let positions = |views: &[&Seen]| views.iter().map(|seen| seen.position).collect::<Vec<_>>();
    let (queries, views) = (positions(&experiment.queries), positions(database));
    write!(out, "| {} |", experiment.name)?;
    for value in [|hit: &Hit| hit.score, |hit: &Hit| hit.similarity] {
        let distances = Distances::new(queries.len(), views.len(), |query| row(query, value));
        match evaluate(&distances, &queries, &views, &EvaluationOptions::default()) {
            Some(found) => write!(
                out,
                " {:.1} % | {:.2} | {:.2} |",
                100.0 * found.recall,
                found.power,
                found.power_of_matrix
            )?,
            None => write!(out, " | | |")?,
        }
    }
    writeln!(out)?;
    Ok(())
}

fn experiments<'a>(first: &'a [Seen], second: &'a [Seen]) -> Vec<Experiment<'a>> {
    let plain = Options::default();
    let experiment = |name, queries, crops, options| Experiment {
        name,
        queries,
        crops,
        options,
    };
    let between = || every_second(first, 1);
    let no_cars = Options {
        ignored: vec![CAR],
        ..plain.clone()
    };
    let crop = Options {
        field_of_view_rad: FRAC_PI_2,
        ..plain.clone()
    };
    let crop_no_cars = Options {
        ignored: vec![CAR],
        ..crop.clone()
    };
    // The paper's unary constraint: class, eccentricity and orientation, wherever the area is and however large it looks.
    let shape_only = Scales {
        bearing_rad: f64::INFINITY,
        elevation_rad: f64::INFINITY,
        log_size: f64::INFINITY,
        ..Scales::default()
    };
    let paper = Options {
        scales: shape_only,
        limit: 2.0,
        max_bearing_rad: 4.0,
        direction_steps: 1,
        size_power: 0.0,
        headings: 1,
        candidates: 0,
        ..plain.clone()
    };
    vec![
        experiment("distant", between(), false, plain.clone()),
        experiment("distant, cars ignored", between(), false, no_cars.clone()),
        experiment(
            "distant, the paper's constraints alone",
            between(),
            false,
            paper,
        ),
        experiment("one camera", every_second(first, 0), true, crop),
        experiment(
            "one camera, cars ignored",
            every_second(first, 0),
            true,
            crop_no_cars.clone(),
        ),
        experiment(
            "one camera, distant, cars ignored",
            between(),
            true,
            crop_no_cars,
        ),
        experiment("another visit", every_second(second, 0), false, plain),
        experiment(
            "another visit, cars ignored",
            every_second(second, 0),
            false,
            no_cars,
        ),
    ]
}

fn main() -> Outcome<()> {
    let mut arguments = std::env::args().skip(1);
    let length_m: f64 = arguments.next().map_or(Ok(1600.0), |text| text.parse())?;
    let seed: u64 = arguments.next().map_or(Ok(1), |text| text.parse())?;
    let street = Street {
        seed,
        length_m,
        spacing_m: SPACING_M,
        ..Street::default()
    };
    let labels = street_labels(&street)?;
    let mut out = std::io::stdout().lock();
    writeln!(
        out,
        "Street {seed} of {length_m} m, {} views in each visit.",
        labels.len()
    )?;
    for (kind, name) in [(LabelKind::Exact, "exact"), (LabelKind::Noisy, "noisy")] {
        let (first, second) = (seen(&labels, 0, kind)?, seen(&labels, 1, kind)?);
        let pairs: Vec<[&Graph; 2]> = first
            .windows(2)
            .map(|pair| [&pair[0].graph, &pair[1].graph])
            .collect();
        writeln!(
            out,
            "\nLabels: {name}. {:?}\n",
            estimate_scales(&pairs, &Options::default())
        )?;
        writeln!(
            out,
            "| | recall@1 | power | of matrix | by similarity: recall@1 | power | of matrix |"
        )?;
        writeln!(out, "|---|---|---|---|---|---|---|")?;
        let database = every_second(&first, 0);
        for experiment in experiments(&first, &second) {
            run(&experiment, &database, &mut out)?;
        }
    }
    Ok(())
}
