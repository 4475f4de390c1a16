//! Solves a problem of the field's benchmarks and reports as JSON, for `tests/peers/least_squares.py`.
//!
//! ```text
//! cargo run --release --example solve -p evermap-bench -- sphere2500.g2o --threads 1 --repeat 5
//! ```
//!
//! It begins at the file's poses, or where all edges say together if that costs less; `--edges-only` leaves the file's
//! poses out. The time is that of the start and the solver; the certificate has its own.
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    clippy::unwrap_used,
    clippy::expect_used
)]

use std::path::Path;

use evermap_algorithms::metric_map::pose_graph::certificate::{certify, lower_bound};
use evermap_algorithms::metric_map::pose_graph::chordal::{Chordal, start};
use evermap_algorithms::metric_map::pose_graph::g2o::write_spatial;
use evermap_algorithms::metric_map::pose_graph::{Graph, options, relax};
use evermap_bench::timing::shortest;
use evermap_bench::{Failure, g2o};

struct Arguments {
    path: String,
    threads: usize,
    repeat: usize,
    edges_only: bool,
    out: Option<String>,
}

fn arguments() -> Result<Arguments, Failure> {
    let mut parsed = Arguments {
        path: String::new(),
        threads: 1,
        repeat: 1,
        edges_only: false,
        out: None,
    };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut value = || words.next().ok_or(format!("{word} needs a value"));
        match word.as_str() {
            "--threads" => parsed.threads = value()?.parse()?,
            "--repeat" => parsed.repeat = value()?.parse()?,
            "--edges-only" => parsed.edges_only = true,
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
        g2o::File::Planar(file) => {
            let (graph, ids) = solve(arguments, file)?;
            g2o::write_planar(&graph, &ids)
        }
        g2o::File::Spatial(file) => {
            let (graph, ids) = solve(arguments, file)?;
            write_spatial(&graph, &ids)
        }
    };
    if let Some(out) = &arguments.out {
        std::fs::write(out, written)?;
    }
    Ok(())
}

/// A graph, and the number of each pose in its file.
type Solved<M, const D: usize> = (Graph<M, D>, Vec<u64>);

fn solve<M, const D: usize, const R: usize, const H: usize>(
    arguments: &Arguments,
    file: g2o::Numbered<M, D>,
) -> Result<Solved<M, D>, Failure>
where
    M: Chordal<D, R, H>,
{
    let mut given = file.graph;
    if arguments.edges_only {
        given.poses.fill(M::identity());
    }
    let (seconds, result) = shortest(arguments.repeat, || {
        let mut graph = given.clone();
        let from_edges = start(&mut graph)?;
        let summary = relax(&mut graph, &options())?;
        Ok::<_, Failure>((graph, from_edges, summary))
    });
    let (graph, from_edges, summary) = result?;
    let (certificate_seconds, bound) = shortest(1, || lower_bound(&graph));
    println!(
        "{}",
        serde_json::json!({
            "poses": graph.poses.len(),
            "edges": graph.edges.len(),
            "indefinite_lines": file.indefinite,
            "given_cost": given.cost(),
            "begins": if from_edges { "edges" } else { "poses" },
            "initial_cost": summary.initial_cost,
            "final_cost": summary.final_cost,
            "iterations": summary.accepted + summary.refused,
            "stop": format!("{:?}", summary.stop),
            "seconds": seconds,
            "optimality": certify(&graph)?.name(),
            "lower_bound": bound?,
            "certificate_seconds": certificate_seconds,
        })
    );
    Ok((graph, file.ids))
}
