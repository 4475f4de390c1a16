//! Finds places again by their words and reports as JSON, for `tests/peers/places.py`.
//!
//! ```text
//! cargo run --release --example relocate -p evermap-bench -- MAP QUERIES --branching 10 --depth 5 --repeat 3
//! ```
//! `MAP.features` and `QUERIES.features` are files of the example `describe`, beside them `MAP.positions` and
//! `QUERIES.positions` with `x y z` on a line for each view. `--out FILE` gets the distances, f32, a row for each
//! query. On one thread.
#![allow(clippy::print_stdout)]

use evermap_algorithms::metric_map::features::{DESCRIPTOR_BYTES, Descriptor};
use evermap_algorithms::metric_map::places::{Bag, PlaceIndex, Vocabulary, VocabularyOptions};
use evermap_bench::Failure;
use evermap_bench::relocation::{Distances, EvaluationOptions, evaluate};
use evermap_bench::timing::processor_seconds;
use nalgebra::Vector3;

struct Arguments {
    paths: Vec<String>,
    vocabulary: VocabularyOptions,
    evaluation: EvaluationOptions,
    repeat: usize,
    out: Option<String>,
}

fn arguments() -> Result<Arguments, Failure> {
    let mut parsed = Arguments {
        paths: Vec::new(),
        vocabulary: VocabularyOptions {
            leaf: 1,
            max_depth: 5,
            max_training: 1_000_000,
            ..Default::default()
        },
        evaluation: EvaluationOptions::default(),
        repeat: 1,
        out: None,
    };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut value = || words.next().ok_or(format!("{word} needs a value"));
        match word.as_str() {
            "--branching" => parsed.vocabulary.branching = value()?.parse()?,
            "--depth" => parsed.vocabulary.max_depth = value()?.parse()?,
            "--leaf" => parsed.vocabulary.leaf = value()?.parse()?,
            "--within-m" => parsed.evaluation.within_m = value()?.parse()?,
            "--repeat" => parsed.repeat = value()?.parse()?,
            "--out" => parsed.out = Some(value()?),
            _ => parsed.paths.push(word),
        }
    }
    Ok(parsed)
}

/// What was seen, and where from.
struct Views {
    descriptors: Vec<Vec<Descriptor>>,
    positions: Vec<Vector3<f64>>,
}

impl Views {
    fn read(name: &str) -> Result<Self, Failure> {
        let bytes = std::fs::read(format!("{name}.features"))?;
        let mut rest = bytes.as_slice();
        let mut descriptors = Vec::new();
        while let Some((count, after)) = rest.split_first_chunk::<4>() {
            let size = u32::from_le_bytes(*count) as usize * DESCRIPTOR_BYTES;
            let (own, after) = after.split_at_checked(size).ok_or("a torn file")?;
            let (own, _) = own.as_chunks::<DESCRIPTOR_BYTES>();
            descriptors.push(own.iter().copied().map(Descriptor).collect());
            rest = after;
        }
        let text = std::fs::read_to_string(format!("{name}.positions"))?;
        let position = |line: &str| {
            let numbers = line.split_whitespace().map(str::parse);
            let numbers = numbers.collect::<Result<Vec<f64>, _>>()?;
            match numbers.as_slice() {
                [x, y, z] => Ok(Vector3::new(*x, *y, *z)),
                _ => Err(Failure::from("expected x y z")),
            }
        };
        let positions = text.lines().map(position).collect::<Result<Vec<_>, _>>()?;
        if positions.len() != descriptors.len() {
            return Err("as many positions as views are needed".into());
        }
        Ok(Self {
            descriptors,
            positions,
        })
    }
}

/// The mean of several runs, whose sum is well above what the kernel's clock resolves (some ms).
fn mean<T>(repeat: usize, mut run: impl FnMut() -> T) -> Result<(f64, T), Failure> {
    let start = processor_seconds()?;
    let mut result = run();
    for _ in 1..repeat {
        result = run();
    }
    let seconds = processor_seconds()? - start;
    Ok((seconds / repeat.max(1) as f64, result))
}

fn main() -> Result<(), Failure> {
    let arguments = arguments()?;
    let [map, queries] = arguments.paths.as_slice() else {
        return Err("expected MAP QUERIES".into());
    };
    let (map, queries) = (Views::read(map)?, Views::read(queries)?);
    let threads = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    threads.install(|| report(&arguments, &map, &queries))
}

fn report(arguments: &Arguments, map: &Views, queries: &Views) -> Result<(), Failure> {
    let all: Vec<_> = map.descriptors.iter().flatten().collect();
    let (training_s, vocabulary) = mean(1, || {
        Vocabulary::train(all.iter().copied(), &arguments.vocabulary)
    })?;
    let (indexing_s, index) = mean(1, || {
        let bags: Vec<Bag> = map
            .descriptors
            .iter()
            .map(|seen| vocabulary.bag(seen))
            .collect();
        PlaceIndex::new(vocabulary.words(), &bags)
    })?;
    let (words_s, bags) = mean(arguments.repeat, || {
        let bags = queries.descriptors.iter().map(|seen| vocabulary.bag(seen));
        bags.collect::<Vec<Bag>>()
    })?;
    let (search_s, _) = mean(arguments.repeat, || {
        let best = bags.iter().map(|bag| index.best(bag, 10, |_| true));
        best.collect::<Vec<_>>()
    })?;
    let (views, asked) = (map.positions.len(), queries.positions.len());
    let distances = Distances::new(asked, views, |query| {
        let scores = index.scores(&bags[query], views);
        scores
            .into_iter()
            .map(|score| 1.0 - f64::from(score))
            .collect()
    });
    let found = evaluate(
        &distances,
        &queries.positions,
        &map.positions,
        &arguments.evaluation,
    );
    let figures = found.map(|found| {
        serde_json::json!({
            "recall": found.recall, "possible": found.possible, "d_true": found.d_true, "d_false": found.d_false,
            "power": found.power, "power_of_matrix": found.power_of_matrix,
        })
    });
    let each_us = |seconds: f64| 1e6 * seconds / asked.max(1) as f64;
    let line = serde_json::json!({
        "views": views, "queries": asked, "words": vocabulary.words(), "training_s": training_s,
        "indexing_s": indexing_s, "words_us": each_us(words_s), "search_us": each_us(search_s), "found": figures,
    });
    println!("{line}");
    if let Some(out) = &arguments.out {
        let rows = (0..asked).flat_map(|query| distances.row(query));
        let bytes: Vec<u8> = rows
            .flat_map(|value| (*value as f32).to_le_bytes())
            .collect();
        std::fs::write(out, bytes)?;
    }
    Ok(())
}
