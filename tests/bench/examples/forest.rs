//! Predicts with a forest that another program learnt, for `tests/peers/pixel_forest.py`.
//!
//! ```text
//! cargo run --release --example forest -p evermap-bench -- FOLDER --repeat 5
//! ```
//! `FOLDER/forest.json` has `dimensions`, `classes` and, per tree, lists of each node's `feature`, `threshold` (a sample
//! goes left at or below it), `left`, `right` (-1 for a leaf) and `value`; `FOLDER/values.bin` the samples, a byte per feature. Scores go
//! to `FOLDER/scores.bin` (little endian, 4 bytes each), the processor time of the fastest of several runs on one thread to stdout.
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    clippy::unwrap_used,
    clippy::expect_used
)]

use std::path::PathBuf;

use evermap_algorithms::learning::random_forest::{Forest, Node, Tree};
use evermap_bench::Failure;
use evermap_bench::timing::processor_seconds;
use serde::Deserialize;

#[derive(Deserialize)]
struct Given {
    dimensions: usize,
    classes: usize,
    trees: Vec<GivenTree>,
}

#[derive(Deserialize)]
struct GivenTree {
    feature: Vec<i64>,
    threshold: Vec<f64>,
    left: Vec<i64>,
    right: Vec<i64>,
    value: Vec<Vec<f64>>,
}

impl GivenTree {
    /// The same tree, breadth first and with children side by side.
    fn tree(&self) -> Tree {
        let mut tree = Tree {
            nodes: vec![Node::default()],
            ..Tree::default()
        };
        let mut order = vec![0_usize];
        let mut leaves = 0;
        let mut next = 0;
        while let Some(&given) = order.get(next) {
            let left = tree.nodes.len() as u32;
            if self.left[given] < 0 {
                tree.nodes[next].leaf = leaves;
                leaves += 1;
                let sum: f64 = self.value[given].iter().sum();
                let shares = self.value[given].iter().map(|value| (value / sum) as f32);
                tree.distributions.extend(shares);
            } else {
                tree.nodes[next] = Node {
                    feature: self.feature[given] as u16,
                    // Bytes are whole numbers.
                    threshold: self.threshold[given].floor() as u8,
                    left,
                    leaf: 0,
                };
                order.extend([self.left[given] as usize, self.right[given] as usize]);
                tree.nodes.extend([Node::default(); 2]);
            }
            next += 1;
        }
        tree
    }
}

fn main() -> Result<(), Failure> {
    let mut words = std::env::args().skip(1);
    let folder = PathBuf::from(words.next().ok_or("expected a folder")?);
    let repeat: usize = match words.next().as_deref() {
        Some("--repeat") => words.next().ok_or("--repeat needs a value")?.parse()?,
        _ => 1,
    };
    let given: Given = serde_json::from_slice(&std::fs::read(folder.join("forest.json"))?)?;
    let trees: Vec<Tree> = given.trees.iter().map(GivenTree::tree).collect();
    let forest = Forest::new(&trees, given.dimensions, given.classes)?;
    let values = std::fs::read(folder.join("values.bin"))?;
    let samples = values.len() / given.dimensions;
    let mut scores = vec![0.0_f32; samples * given.classes];
    let mut fastest = f64::INFINITY;
    // As the classifier does it: a row of an image at a time.
    let row = 480;
    for _ in 0..repeat.max(1) {
        let start = processor_seconds()?;
        let rows = values.chunks(row * given.dimensions);
        for (values, scores) in rows.zip(scores.chunks_mut(row * given.classes)) {
            forest.predict(values, None, scores);
        }
        fastest = fastest.min(processor_seconds()? - start);
    }
    let bytes: Vec<u8> = scores
        .iter()
        .flat_map(|score| score.to_le_bytes())
        .collect();
    std::fs::write(folder.join("scores.bin"), bytes)?;
    println!("{{\"samples\": {samples}, \"seconds\": {fastest}}}");
    Ok(())
}
