//! Solves a problem of the field's benchmarks and reports as JSON, for `tests/peers/least_squares.py`.
//!
//! ```text
//! cargo run --release --example solve -p evermap-bench -- sphere2500.g2o --threads 1 --repeat 5
//! ```
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    clippy::unwrap_used,
    clippy::expect_used
)]

use std::path::Path;

use evermap_algorithms::metric_map::pose_graph::g2o::write_spatial;
use evermap_algorithms::metric_map::pose_graph::relaxation::Relaxation;
use evermap_algorithms::metric_map::pose_graph::{Graph, Motion, options};
use evermap_algorithms::solving::least_squares::{Summary, minimise};
use evermap_bench::timing::shortest;
use evermap_bench::{Failure, g2o};

struct Arguments {
    path: String,
    threads: usize,
    repeat: usize,
    out: Option<String>,
}

fn arguments() -> Result<Arguments, Failure> {
    let mut parsed = Arguments {
        path: String::new(),
        threads: 1,
        repeat: 1,
        out: None,
    };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut value = || words.next().ok_or(format!("{word} needs a value"));
        match word.as_str() {
            "--threads" => parsed.threads = value()?.parse()?,
            "--repeat" => parsed.repeat = value()?.parse()?,
            "--out" => parsed.out = Some(value()?),
            _ => parsed.path = word,
        }
    }
    Ok(parsed)
}

fn main() -> Result<(), Failure> {
    let arguments = arguments()?;
    let threads = rayon::ThreadPoolBuilder::new().num_threads(arguments.threads);
    let text = std::fs::read_to_string(&arguments.path)?;
    match Path::new(&arguments.path)
        .extension()
        .and_then(|e| e.to_str())
    {
        Some("g2o") => threads.build()?.install(|| pose_graph(&arguments, &text)),
        other => Err(format!("expected a .g2o file, found {other:?}").into()),
    }
}

fn pose_graph(arguments: &Arguments, text: &str) -> Result<(), Failure> {
    let written = match g2o::read(text)? {
        g2o::File::Planar(mut file) => {
            file.graph = relax(arguments, file.graph)?;
            g2o::write_planar(&file.graph, &file.ids)
        }
        g2o::File::Spatial(mut file) => {
            file.graph = relax(arguments, file.graph)?;
            write_spatial(&file.graph, &file.ids)
        }
    };
    if let Some(out) = &arguments.out {
        std::fs::write(out, written)?;
    }
    Ok(())
}

fn relax<M: Motion<D>, const D: usize>(
    arguments: &Arguments,
    mut graph: Graph<M, D>,
) -> Result<Graph<M, D>, Failure> {
    let (seconds, result) = shortest(arguments.repeat, || {
        let mut relaxation = Relaxation::new(&graph)?;
        let summary = minimise(&mut relaxation, &options());
        Ok::<_, Failure>((summary, relaxation.into_poses()))
    });
    let (summary, poses) = result?;
    report(seconds, &summary);
    graph.poses = poses;
    Ok(graph)
}

fn report(seconds: f64, summary: &Summary) {
    println!(
        "{}",
        serde_json::json!({
            "initial_cost": summary.initial_cost,
            "final_cost": summary.final_cost,
            "iterations": summary.accepted + summary.refused,
            "stop": format!("{:?}", summary.stop),
            "seconds": seconds,
        })
    );
}
