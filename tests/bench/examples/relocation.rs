//! `relocation [LENGTH_M [SEED [OPTIONS]]]`: how well views of a simulated street are found by their semantic graphs; with
//! options as JSON by these alone.
//!
//! The experiments of paper 2 (metric-topological-semantic map), section V-B, on its distances: a database of every 40th
//! of views 0.123 m apart (one every 4.9 m), and queries half-way between (paper: distant images), a quarter of the
//! panorama's width (paper: monocular images), without cars, on another visit, and looking the other way there. Beside the
//! trees a bag of words, as `word_relocations` makes one, whose words are areas by class, size, elevation and shape: the
//! images that ORB or BRISK would describe are not drawn.
//!
//! Then how sure of another visit one may be, with each setting of the pairwise relations.

use std::error::Error;
use std::f64::consts::FRAC_PI_2;
use std::io::Write;

use evermap_algorithms::metric_map::features::{DESCRIPTOR_BYTES, Descriptor};
use evermap_algorithms::metric_map::places::{Bag, PlaceIndex, Vocabulary, VocabularyOptions};
use evermap_algorithms::semantic_map::relocation::{
    CalibrationOptions, Hit, Options, ShapeLimits, TreeKind, ViewMap, are_apart, distinctness,
    self_search,
};
use evermap_algorithms::semantic_map::semantic_graph::{Area, Graph, GraphOptions, Labels};
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
    /// By [`Look`].
    graphs: [Graph; 4],
    position: Vector3<f64>,
}

/// What is seen of a view.
#[derive(Clone, Copy)]
enum Look {
    /// All around.
    Around,
    /// All around, by one who drives the other way: half a turn from the others.
    Turned,
    /// A camera that looks ahead.
    Ahead,
    /// A camera that looks back.
    Back,
}

impl Seen {
    fn graph(&self, look: Look) -> &Graph {
        &self.graphs[look as usize]
    }
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

/// A panorama that looks farther to the right by some columns.
fn turned(view: &LabelView, columns: usize) -> Vec<u8> {
    let rows = view.labels.chunks_exact(view.width as usize);
    let turned = rows.flat_map(|row| row[columns..].iter().chain(&row[..columns]).copied());
    turned.collect()
}

/// A camera that looks ahead: a quarter of the columns, and rows for four to three.
fn crop(width: u32, height: u32, labels: &[u8]) -> Outcome<Graph> {
    let (width, height) = (width as usize, height as usize);
    let (wide, high) = (width / 4, (width / 4 * 3 / 4).min(height));
    let (left, top) = ((width - wide) / 2, (height - high) / 2);
    let rows = labels.chunks_exact(width).skip(top).take(high);
    let values: Vec<u8> = rows
        .flat_map(|row| &row[left..left + wide])
        .copied()
        .collect();
    graph(wide as u32, &values, false)
}

fn graphs(view: &LabelView) -> Outcome<[Graph; 4]> {
    let (width, height) = (view.width, view.height);
    let back = turned(view, width as usize / 2);
    Ok([
        graph(width, &view.labels, true)?,
        graph(width, &back, true)?,
        crop(width, height, &view.labels)?,
        crop(width, height, &back)?,
    ])
}

fn seen(labels: &StreetLabels, visit: usize, kind: LabelKind) -> Outcome<Vec<Seen>> {
    let views = (0..labels.len()).into_par_iter().map(|index| {
        let view = labels.view(visit, index, kind).ok_or("no such view")?;
        let [x, y, z, ..] = view.map_from_vehicle.to_array();
        Ok(Seen {
            graphs: graphs(&view).map_err(|error| error.to_string())?,
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

/// How views are compared.
#[derive(Clone)]
enum Method {
    Tree(Options),
    Words,
}

struct Experiment<'a> {
    name: String,
    queries: Vec<&'a Seen>,
    look: Look,
    method: Method,
}

/// What speaks for each view of the database, by up to two measures.
type Rows = [Vec<Vec<f64>>; 2];

/// By the tree's score, which is the count of matches where it counts, and by similarity.
fn by_tree(experiment: &Experiment<'_>, options: &Options, database: &[&Seen]) -> Rows {
    let graphs = database.iter().map(|seen| seen.graph(Look::Around));
    let map = ViewMap::new(graphs, options.clone());
    let hits = experiment.queries.par_iter().map(|seen| {
        let asked = map.query(seen.graph(experiment.look));
        let views = 0..map.len() as u32;
        views.map(|view| map.compare(&asked, view)).collect()
    });
    let hits: Vec<Vec<Option<Hit>>> = hits.collect();
    let score = |hit: &Hit| match options.tree {
        TreeKind::Weighted => hit.score,
        TreeKind::Interpretation => f64::from(hit.matched),
    };
    let values = |value: &dyn Fn(&Hit) -> f64| {
        let row = |row: &Vec<Option<Hit>>| {
            let values = row.iter().map(|hit| hit.as_ref().map_or(0.0, value));
            values.collect()
        };
        hits.iter().map(row).collect()
    };
    [values(&score), values(&|hit| hit.similarity)]
}

/// By a bag of words, of at most 10^5 (paper 2, section V).
fn by_words(experiment: &Experiment<'_>, database: &[&Seen]) -> Rows {
    let options = VocabularyOptions {
        branching: 10,
        max_depth: 5,
        leaf: 1,
        max_training: 1_000_000,
        ..VocabularyOptions::default()
    };
    let described = database.iter().map(|seen| words(seen.graph(Look::Around)));
    let described: Vec<Vec<Descriptor>> = described.collect();
    let all: Vec<&Descriptor> = described.iter().flatten().collect();
    let vocabulary = Vocabulary::train(all.into_iter(), &options);
    let bags: Vec<Bag> = described.iter().map(|seen| vocabulary.bag(seen)).collect();
    let index = PlaceIndex::new(vocabulary.words(), &bags);
    let scores = experiment.queries.iter().map(|seen| {
        let bag = vocabulary.bag(&words(seen.graph(experiment.look)));
        let scores = index.scores(&bag, database.len()).into_iter();
        scores.map(f64::from).collect()
    });
    [scores.collect(), Vec::new()]
}

/// Each area as a word would have it: class, size, elevation, elongation and orientation, all that the trees know of an area
/// but its bearing. Bits differ by as many as values do.
fn words(graph: &Graph) -> Vec<Descriptor> {
    let rad_per_px = graph.rad_per_px(FRAC_PI_2 as f32);
    let described = |area: &Area| {
        let mut bits = vec![false; 12 * STREET_CLASSES.len()];
        let class = 12 * usize::from(area.class);
        bits[class..class + 12].fill(true);
        let elevation = (area.v - (graph.height as f32 - 1.0) / 2.0) * rad_per_px;
        let size = (area.pixels.max(1) as f32 * rad_per_px * rad_per_px).ln();
        let (sin, cos) = (2.0 * area.orientation_rad).sin_cos();
        let stretch = area.eccentricity * area.eccentricity;
        for (value, range, number) in [
            (size, [-8.0, 2.0], 128),
            (elevation, [-1.0, 1.0], 96),
            (area.log_elongation(), [0.0, 4.0], 72),
            (stretch * cos, [-1.0, 1.0], 48),
            (stretch * sin, [-1.0, 1.0], 48),
        ] {
            let share = (value - range[0]) / (range[1] - range[0]);
            bits.extend((0..number).map(|bit| share * number as f32 > bit as f32));
        }
        bits.resize(8 * DESCRIPTOR_BYTES, false);
        let mut descriptor = [0; DESCRIPTOR_BYTES];
        for (at, _) in bits.iter().enumerate().filter(|(_, bit)| **bit) {
            descriptor[at / 8] |= 1 << (at % 8);
        }
        Descriptor(descriptor)
    };
    graph.areas.iter().map(described).collect()
}

fn run(experiment: &Experiment<'_>, database: &[&Seen], out: &mut impl Write) -> Outcome<()> {
    let rows = match &experiment.method {
        Method::Tree(options) => by_tree(experiment, options, database),
        Method::Words => by_words(experiment, database),
    };
    let positions = |views: &[&Seen]| views.iter().map(|seen| seen.position).collect::<Vec<_>>();
    let (queries, views) = (positions(&experiment.queries), positions(database));
    write!(out, "| {} |", experiment.name)?;
    for rows in rows.iter().filter(|rows| !rows.is_empty()) {
        let row = |query: usize| rows[query].iter().map(|value| 1.0 - value).collect();
        let distances = Distances::new(queries.len(), views.len(), row);
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

/// What each question is asked by.
fn methods() -> Vec<(&'static str, Method)> {
    let plain = Options {
        field_of_view_rad: FRAC_PI_2,
        ..Options::default()
    };
    let no_cars = Options {
        ignored: vec![CAR],
        ..plain.clone()
    };
    let paper = Options {
        tree: TreeKind::Interpretation,
        ..plain.clone()
    };
    let ratio = Options {
        shapes: ShapeLimits {
            max_eccentricity: 1.0,
            max_length_over_width: 1.0,
            ..ShapeLimits::default()
        },
        ..paper.clone()
    };
    vec![
        ("weighted", Method::Tree(plain)),
        ("weighted, cars ignored", Method::Tree(no_cars)),
        ("interpretation", Method::Tree(paper)),
        ("interpretation by length over width", Method::Tree(ratio)),
        ("words", Method::Words),
    ]
}

fn experiments<'a>(
    first: &'a [Seen],
    second: &'a [Seen],
    methods: &[(&str, Method)],
) -> Vec<Experiment<'a>> {
    let questions = [
        ("distant", every_second(first, 1), Look::Around),
        ("one camera", every_second(first, 0), Look::Ahead),
        ("one camera, distant", every_second(first, 1), Look::Ahead),
        ("another visit", every_second(second, 0), Look::Around),
        (
            "another visit, turned half round",
            every_second(second, 0),
            Look::Turned,
        ),
        (
            "another visit, one camera",
            every_second(second, 0),
            Look::Ahead,
        ),
        (
            "another visit, one camera that looks back",
            every_second(second, 0),
            Look::Back,
        ),
    ];
    let mut experiments = Vec::new();
    for (question, queries, look) in &questions {
        for (name, method) in methods {
            experiments.push(Experiment {
                name: format!("{question}: {name}"),
                queries: queries.clone(),
                look: *look,
                method: method.clone(),
            });
        }
    }
    experiments
}

/// What may be asked of pairs of matches.
fn relations() -> Vec<(&'static str, Options)> {
    let with = |contact_rad, fused| Options {
        contact_rad,
        fused,
        ..Options::default()
    };
    vec![
        ("as it ships", with(None, false)),
        ("contact_rad 0", with(Some(0.0), false)),
        ("contact_rad 0.1", with(Some(0.1), false)),
        ("contact_rad 0.5", with(Some(0.5), false)),
        ("fused", with(None, true)),
        ("fused, contact_rad 0.5", with(Some(0.5), true)),
    ]
}

/// The probability that each view of another visit was found, and whether it was: with its place in the map, and without.
fn answers(options: &Options, first: &[Seen], second: &[Seen]) -> Option<Vec<[(f64, bool); 2]>> {
    let graphs: Vec<Graph> = first
        .iter()
        .map(|seen| seen.graph(Look::Around).clone())
        .collect();
    let places: Vec<Vector3<f64>> = first.iter().map(|seen| seen.position).collect();
    let learning = CalibrationOptions::default();
    let map = ViewMap::new(graphs.iter(), options.clone());
    let learnt = self_search(&map, &graphs, &places, &learning)?.calibration?;
    let apart =
        |a: &Vector3<f64>, view: u32| are_apart(a, &places[view as usize], learning.within_m);
    let answer = |seen: &Seen, mapped: bool| {
        let asked = map.query(seen.graph(Look::Around));
        let allowed = |view: u32| mapped || apart(&seen.position, view);
        let hit = map.search(&asked, 1, allowed).first().copied();
        let Some(hit) = hit else {
            return (0.0, false);
        };
        let there = &places[hit.view as usize];
        let elsewhere = |view: u32| allowed(view) && apart(there, view);
        let best = |allowed: &dyn Fn(u32) -> bool| map.search(&asked, 1, allowed);
        let told = distinctness(&hit, 0..map.len() as u32, elsewhere, best);
        let right = (seen.position - there).norm() <= learning.within_m;
        (told.map_or(0.0, |told| learnt.probability(told)), right)
    };
    let each = second.par_iter();
    Some(
        each.map(|seen| [answer(seen, true), answer(seen, false)])
            .collect(),
    )
}

fn certainties(
    first: &[Seen],
    second: &[Seen],
    relations: &[(&str, Options)],
    out: &mut impl Write,
) -> Outcome<()> {
    writeln!(
        out,
        "\n| another visit: relations | found | at least 0.9 said of, wrong | 0.95 | 0.99 |"
    )?;
    writeln!(out, "|---|---|---|---|---|")?;
    for (name, options) in relations {
        let Some(answers) = answers(options, first, second) else {
            writeln!(out, "| {name} | nothing is learnt | | | |")?;
            continue;
        };
        let found = answers.iter().filter(|[mapped, _]| mapped.1).count();
        write!(out, "| {name} | {found} of {} |", answers.len())?;
        for least in [0.9, 0.95, 0.99] {
            let said = answers.iter().flatten().filter(|(sure, _)| *sure >= least);
            let wrong = said.clone().filter(|(_, right)| !right).count();
            write!(out, " {}, {wrong} |", said.count())?;
        }
        writeln!(out)?;
    }
    Ok(())
}

fn main() -> Outcome<()> {
    let mut arguments = std::env::args().skip(1);
    let length_m: f64 = arguments.next().map_or(Ok(1600.0), |text| text.parse())?;
    let seed: u64 = arguments.next().map_or(Ok(1), |text| text.parse())?;
    let options: Option<Options> = match arguments.next() {
        Some(text) => Some(serde_json::from_str(&text)?),
        None => None,
    };
    let methods = match &options {
        Some(options) => vec![("these", Method::Tree(options.clone()))],
        None => methods(),
    };
    let relations = options.map_or_else(relations, |options| vec![("these", options)]);
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
            .map(|pair| [pair[0].graph(Look::Around), pair[1].graph(Look::Around)])
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
        for experiment in experiments(&first, &second, &methods) {
            run(&experiment, &database, &mut out)?;
        }
        certainties(&first, &second, &relations, &mut out)?;
    }
    Ok(())
}
