//! How well pixels of CamVid are classified by forest and random field, cross-validated within its sequences.
//!
//! ```text
//! cargo run --release --example camvid -p evermap-bench -- ../shared/data/camvid --folds 5
//! cargo run --release --example camvid -p evermap-bench -- TRAINING_FOLDER --test TEST_FOLDER
//! ```
//! `--network` learns perceptrons, as `scene_labels` does, instead of a forest (with `--features opencv`).
//! `--dump FOLDER` only writes the samples, for `tests/peers/pixel_forest.py`. Folds are contiguous parts of each
//! sequence, or every n-th frame with `--interleaved`. The prior power, unless it is given (`--prior-power`), and the kernels are
//! those that do best on training frames, each scored by trees or members that have not seen its part of the drive: no test
//! frame is looked at.
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    clippy::unwrap_used,
    clippy::expect_used
)]

use std::path::{Path, PathBuf};
use std::time::Instant;

use evermap_algorithms::learning::dense_crf::{
    ColourView, Example, Kernels, MeanField, RandomField, SearchOptions, Unary, search,
};
use evermap_algorithms::learning::perceptron::{self, NetworkOptions};
use evermap_algorithms::learning::pixel_classifier::PixelClassifier;
use evermap_algorithms::learning::pixel_features::{
    Backbone, FeatureDescription, SamplingOptions, labelled_features,
};
use evermap_algorithms::learning::random_forest::{
    ForestOptions, prior_factors, train, with_priors,
};
use evermap_algorithms::learning::samples::Samples;
use evermap_bench::Failure;
use rayon::prelude::*;

const CLASSES: [&str; 11] = [
    "sky",
    "building",
    "pole",
    "road",
    "pavement",
    "tree",
    "sign",
    "fence",
    "car",
    "pedestrian",
    "bicyclist",
];
const POWERS: [f64; 9] = [-0.5, -0.4, -0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.4];
/// The most training frames on which prior power and kernels are chosen.
const CHOSEN_ON: usize = 24;

struct Arguments {
    folder: PathBuf,
    test: Option<PathBuf>,
    dump: Option<PathBuf>,
    folds: usize,
    interleaved: bool,
    only: Vec<usize>,
    stride: u32,
    blocks: usize,
    field: bool,
    prior_power: Option<f64>,
    sampling: SamplingOptions,
    forest: ForestOptions,
    features: FeatureDescription,
    network: Option<NetworkOptions>,
}

fn arguments() -> Result<Arguments, Failure> {
    let mut parsed = Arguments {
        folder: PathBuf::new(),
        test: None,
        dump: None,
        folds: 5,
        interleaved: false,
        only: Vec::new(),
        stride: 2,
        blocks: 5,
        field: true,
        prior_power: None,
        sampling: SamplingOptions::default(),
        forest: ForestOptions::default(),
        features: FeatureDescription::default(),
        network: None,
    };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut value = || words.next().ok_or(format!("{word} needs a value"));
        match word.as_str() {
            "--test" => parsed.test = Some(value()?.into()),
            "--dump" => parsed.dump = Some(value()?.into()),
            "--folds" => parsed.folds = value()?.parse()?,
            "--only" => parsed.only.push(value()?.parse()?),
            "--interleaved" => parsed.interleaved = true,
            "--no-field" => parsed.field = false,
            "--prior-power" => parsed.prior_power = Some(value()?.parse()?),
            "--no-mirror" => parsed.sampling.mirror = false,
            "--stride" => parsed.stride = value()?.parse()?,
            "--blocks" => parsed.blocks = value()?.parse()?,
            "--samples" => parsed.sampling.samples = value()?.parse()?,
            "--sample-balance" => parsed.sampling.balance = value()?.parse()?,
            "--trees" => parsed.forest.trees = value()?.parse()?,
            "--tried" => parsed.forest.tried_features = value()?.parse()?,
            "--min-leaf" => parsed.forest.min_leaf = value()?.parse()?,
            "--balance" => parsed.forest.balance = value()?.parse()?,
            "--network" => parsed.network = Some(serde_json::from_str(&value()?)?),
            "--features" => parsed.features = serde_json::from_str(&value()?)?,
            _ => parsed.folder = word.into(),
        }
    }
    Ok(parsed)
}

/// What EfficientNet-Lite0 sees.
#[cfg(feature = "opencv")]
const BACKBONE: Backbone = |image, area_px| {
    use evermap_algorithms::learning::pixel_features::FeatureMap;
    let size = [image.width(), image.height()].map(|side| side as u32);
    let found = evermap_vision::activations(size, image.pixels().as_flattened(), area_px);
    let map = |stage: evermap_vision::Activation| FeatureMap {
        channels: stage.channels,
        size: stage.size,
        cells_per_px: stage.cells_per_px,
        values: stage.values,
    };
    let found = found.map_err(|error| error.to_string())?;
    Ok(found.into_iter().map(map).collect())
};
#[cfg(not(feature = "opencv"))]
const BACKBONE: Backbone = evermap_algorithms::learning::pixel_features::NO_BACKBONE;

struct Frame {
    sequence: usize,
    width: u32,
    height: u32,
    rgb: Vec<u8>,
    labels: Vec<u8>,
}

impl Frame {
    fn image(&self) -> ColourView<'_> {
        ColourView::new(self.width, self.height, &self.rgb).unwrap()
    }
}

fn png(path: &Path) -> Result<(u32, u32, Vec<u8>), Failure> {
    let decoder = png::Decoder::new(std::io::BufReader::new(std::fs::File::open(path)?));
    let mut reader = decoder.read_info()?;
    let mut data = vec![0; reader.output_buffer_size().ok_or("too large")?];
    let info = reader.next_frame(&mut data)?;
    data.truncate(info.buffer_size());
    Ok((info.width, info.height, data))
}

fn frames(folder: &Path) -> Result<Vec<Frame>, Failure> {
    let mut frames = Vec::new();
    for (sequence, name) in ["0001TP", "0006R0"].into_iter().enumerate() {
        let listed = std::fs::read_dir(folder.join("images"))?;
        let mut names: Vec<_> = listed.map(|entry| entry.unwrap().file_name()).collect();
        names.retain(|file| file.to_string_lossy().starts_with(name));
        names.sort();
        for file in names {
            let (width, height, rgb) = png(&folder.join("images").join(&file))?;
            let labels = png(&folder.join("labels11").join(&file))?.2;
            frames.push(Frame {
                sequence,
                width,
                height,
                rgb,
                labels,
            });
        }
    }
    Ok(frames)
}

/// Contiguous part of its sequence that each frame belongs to.
fn parts(frames: &[&Frame], parts: usize) -> Vec<usize> {
    let of = |sequence| {
        frames
            .iter()
            .filter(|frame| frame.sequence == sequence)
            .count()
    };
    let parts = |count: usize| (0..count).map(move |i| i * parts / count);
    parts(of(0)).chain(parts(of(1))).collect()
}

/// A classifier, and the block of each training frame.
struct Model {
    classifier: PixelClassifier,
    blocks: Vec<u32>,
    frequencies: Vec<f32>,
}

/// Samples of all frames, side by side.
#[derive(Default)]
struct Gathered {
    labels: Vec<u8>,
    values: Vec<u8>,
    /// Block of each sample.
    blocks: Vec<u32>,
    /// Labelled pixels of each class.
    class_pixels: [u64; 11],
}

fn gather(frames: &[&Frame], blocks: &[u32], arguments: &Arguments) -> Gathered {
    let sample = |(index, frame): (usize, &&Frame)| {
        let options = SamplingOptions {
            seed: index as u64,
            ..arguments.sampling
        };
        let (what, classes) = (&arguments.features, CLASSES.len());
        labelled_features(
            what,
            &frame.image(),
            &frame.labels,
            classes,
            &options,
            BACKBONE,
        )
        .unwrap()
    };
    let parts: Vec<_> = frames.par_iter().enumerate().map(sample).collect();
    let mut all = Gathered::default();
    for (part, block) in parts.into_iter().zip(blocks) {
        for (sum, count) in all.class_pixels.iter_mut().zip(&part.class_pixels) {
            *sum += count;
        }
        all.blocks
            .resize(all.blocks.len() + part.labels.len(), *block);
        all.labels.extend(part.labels);
        all.values.extend(part.values);
    }
    all
}

fn learn(frames: &[&Frame], arguments: &Arguments) -> Model {
    let what = &arguments.features;
    let blocks: Vec<u32> = parts(frames, arguments.blocks)
        .into_iter()
        .map(|part| part as u32)
        .collect();
    let gathered = gather(frames, &blocks, arguments);
    let samples = Samples {
        dimensions: what.dimensions(),
        classes: CLASSES.len(),
        labels: &gathered.labels,
        values: &gathered.values,
        blocks: &gathered.blocks,
    };
    let start = Instant::now();
    let classifier = match &arguments.network {
        Some(options) => {
            let members = perceptron::train(&samples, options);
            PixelClassifier::of_network(what.clone(), members, CLASSES.len()).unwrap()
        }
        None => {
            let trees = train(&samples, &arguments.forest);
            PixelClassifier::of_trees(what.clone(), &trees, CLASSES.len()).unwrap()
        }
    };
    eprintln!(
        "learnt from {} samples in {:.1} s",
        gathered.labels.len(),
        start.elapsed().as_secs_f64()
    );
    let all = gathered.class_pixels.iter().sum::<u64>() as f32;
    Model {
        classifier,
        blocks,
        frequencies: gathered
            .class_pixels
            .iter()
            .map(|count| *count as f32 / all)
            .collect(),
    }
}

/// Right and all pixels of each class.
#[derive(Clone, Copy, Default)]
struct Tally([[u64; 2]; 11]);

impl Tally {
    fn add(&mut self, frame: &Frame, labels: &[u8]) {
        for (label, found) in frame
            .labels
            .iter()
            .zip(labels)
            .filter(|(label, _)| **label < 11)
        {
            self.0[usize::from(*label)][0] += u64::from(label == found);
            self.0[usize::from(*label)][1] += 1;
        }
    }

    fn pixels(&self) -> f64 {
        let sum = |n: usize| self.0.iter().map(|class| class[n]).sum::<u64>() as f64;
        100.0 * sum(0) / sum(1).max(1.0)
    }

    fn shares(&self) -> Vec<f64> {
        let present = self.0.iter().filter(|class| class[1] > 0);
        present
            .map(|class| 100.0 * class[0] as f64 / class[1] as f64)
            .collect()
    }

    fn classes(&self) -> f64 {
        let shares = self.shares();
        shares.iter().sum::<f64>() / shares.len().max(1) as f64
    }

    fn row(&self, name: &str) -> String {
        let shares: Vec<String> = self
            .shares()
            .iter()
            .map(|share| format!("{share:.0}"))
            .collect();
        format!(
            "| {name} | {:.2} | {:.2} | {} |",
            self.pixels(),
            self.classes(),
            shares.join(" ")
        )
    }
}

/// Probabilities of every pixel, from cells of a stride, with other priors.
fn probabilities(frame: &Frame, scores: &[f32], stride: u32, factors: &[f32]) -> Vec<f32> {
    let n = CLASSES.len();
    let columns = frame.width.div_ceil(stride);
    let cells = of_cells(scores, factors);
    let pixels = (0..frame.height).flat_map(|v| (0..frame.width).map(move |u| (u, v)));
    let cell = |(u, v): (u32, u32)| (v / stride * columns + u / stride) as usize;
    pixels
        .flat_map(|pixel| &cells[cell(pixel) * n..][..n])
        .copied()
        .collect()
}

fn of_cells(scores: &[f32], factors: &[f32]) -> Vec<f32> {
    let mut cells = scores.to_vec();
    cells
        .chunks_exact_mut(CLASSES.len())
        .for_each(|cell| with_priors(cell, factors));
    cells
}

fn likeliest(probabilities: &[f32]) -> Vec<u8> {
    let best = |p: &[f32]| {
        (0..p.len()).fold(
            0,
            |best, class| if p[class] > p[best] { class } else { best },
        )
    };
    probabilities
        .chunks_exact(CLASSES.len())
        .map(|p| best(p) as u8)
        .collect()
}

fn by_field(frame: &Frame, probabilities: &[f32], kernels: &Kernels) -> Vec<u8> {
    let unary = Unary::from_probabilities(CLASSES.len(), probabilities).unwrap();
    let field = RandomField::new(&frame.image(), kernels, false).unwrap();
    let found = field.infer(&unary, MeanField::default().iterations);
    found.unwrap().labels()
}

/// Training frames, evenly from all, and their scores by members that have not seen them.
fn held_out<'a>(
    frames: &[&'a Frame],
    model: &Model,
    arguments: &Arguments,
) -> Vec<(&'a Frame, Vec<f32>)> {
    let step = frames.len().div_ceil(CHOSEN_ON);
    let each: Vec<_> = frames
        .iter()
        .zip(&model.blocks)
        .step_by(step.max(1))
        .collect();
    let scored = each.into_par_iter().map(|(frame, block)| {
        let image = frame.image();
        let scores = model
            .classifier
            .scores(&image, Some(*block), arguments.stride, BACKBONE);
        (*frame, scores.unwrap())
    });
    scored.collect()
}

/// The prior power with which pixels and classes together come out best.
fn best_power(held_out: &[(&Frame, Vec<f32>)], model: &Model, stride: u32) -> f64 {
    let value = |power: f64| {
        let factors = prior_factors(&model.frequencies, power);
        let mut tally = Tally::default();
        for (frame, scores) in held_out {
            tally.add(
                frame,
                &likeliest(&probabilities(frame, scores, stride, &factors)),
            );
        }
        tally.pixels() + tally.classes()
    };
    let values = POWERS.map(|power| (value(power), power));
    values
        .into_iter()
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .unwrap()
        .1
}

/// The kernels that `crf_settings` would choose.
fn best_kernels(held_out: &[(&Frame, Vec<f32>)], factors: &[f32], stride: u32) -> Kernels {
    let example = |(frame, scores): &(&Frame, Vec<f32>)| {
        let own = of_cells(scores, factors);
        let unary = Unary::from_probabilities(CLASSES.len(), &own).unwrap();
        Example::new(&frame.image(), stride, unary, false, frame.labels.clone()).unwrap()
    };
    let examples: Vec<Example> = held_out.iter().map(example).collect();
    let trials = search(&examples, &SearchOptions::default(), |_| ()).unwrap();
    let labelled: usize = trials.iter().map(|trial| trial.examples).sum();
    let best = &trials[0];
    let (pixels, classes) = (
        best.confusion.pixel_accuracy(),
        best.confusion.class_accuracy(),
    );
    eprintln!(
        "{} trials, {labelled} labellings; {pixels:.4} {classes:.4} {:?}",
        trials.len(),
        best.kernels
    );
    best.kernels
}

#[derive(Clone, Default)]
struct Results {
    powers: [Tally; POWERS.len()],
    alone: Tally,
    with_field: Tally,
}

fn judge(training: &[&Frame], test: &[&Frame], arguments: &Arguments, results: &mut [Results; 3]) {
    let model = learn(training, arguments);
    let held_out = held_out(training, &model, arguments);
    let power = arguments.prior_power;
    let power = power.unwrap_or_else(|| best_power(&held_out, &model, arguments.stride));
    eprintln!("prior power {power}");
    let factors = prior_factors(&model.frequencies, power);
    let searching = Instant::now();
    let kernels = (arguments.field).then(|| best_kernels(&held_out, &factors, arguments.stride));
    eprintln!(
        "kernels found in {:.0} s",
        searching.elapsed().as_secs_f64()
    );
    let scoring = Instant::now();
    let scores: Vec<_> = test
        .par_iter()
        .map(|frame| {
            model
                .classifier
                .scores(&frame.image(), None, arguments.stride, BACKBONE)
                .unwrap()
        })
        .collect();
    let seconds = scoring.elapsed().as_secs_f64() / test.len().max(1) as f64;
    eprintln!("scored in {seconds:.3} s per frame");
    let found: Vec<_> = test
        .par_iter()
        .zip(&scores)
        .map(|(frame, scores)| {
            let of = |power| {
                let factors = prior_factors(&model.frequencies, power);
                probabilities(frame, scores, arguments.stride, &factors)
            };
            let own = of(power);
            let field = kernels.map(|kernels| by_field(frame, &own, &kernels));
            (
                POWERS.map(|power| likeliest(&of(power))),
                likeliest(&own),
                field,
            )
        })
        .collect();
    for (frame, (powers, alone, field)) in test.iter().zip(found) {
        for of in [frame.sequence, 2] {
            let results = &mut results[of];
            for (tally, labels) in results.powers.iter_mut().zip(&powers) {
                tally.add(frame, labels);
            }
            results.alone.add(frame, &alone);
            if let Some(labels) = &field {
                results.with_field.add(frame, labels);
            }
        }
    }
}

fn main() -> Result<(), Failure> {
    let arguments = arguments()?;
    let given = frames(&arguments.folder)?;
    let given: Vec<&Frame> = given.iter().collect();
    if let Some(folder) = &arguments.dump {
        let blocks = vec![0; given.len()];
        let gathered = gather(&given, &blocks, &arguments);
        std::fs::write(folder.join("labels.bin"), gathered.labels)?;
        std::fs::write(folder.join("values.bin"), gathered.values)?;
        return Ok(());
    }
    let mut results: [Results; 3] = Default::default();
    if let Some(folder) = &arguments.test {
        let test = frames(folder)?;
        judge(
            &given,
            &test.iter().collect::<Vec<_>>(),
            &arguments,
            &mut results,
        );
    } else {
        let folds = arguments.folds.max(1);
        let fold_of = match arguments.interleaved {
            true => (0..given.len()).map(|index| index % folds).collect(),
            false => parts(&given, folds),
        };
        for fold in
            (0..folds).filter(|fold| arguments.only.is_empty() || arguments.only.contains(fold))
        {
            let of = |inside: bool| -> Vec<&Frame> {
                let frames = given
                    .iter()
                    .zip(&fold_of)
                    .filter(|(_, of)| (**of == fold) == inside);
                frames.map(|(frame, _)| *frame).collect()
            };
            judge(&of(false), &of(true), &arguments, &mut results);
        }
    }
    for (name, results) in ["0001TP", "0006R0", "both"].iter().zip(&results) {
        println!(
            "\n| {name} | pixels % | class average % | {} |\n|---|---|---|---|",
            CLASSES.join(" ")
        );
        for (power, tally) in POWERS.iter().zip(&results.powers) {
            println!("{}", tally.row(&format!("prior power {power}")));
        }
        println!(
            "{}",
            results
                .alone
                .row("the prior power that was given or chosen")
        );
        println!("{}", results.with_field.row("and random field"));
    }
    Ok(())
}
