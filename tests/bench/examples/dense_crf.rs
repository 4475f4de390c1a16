//! Labels an image by a dense random field and reports as JSON, for `tests/peers/dense_crf.py`.
//!
//! ```text
//! cargo run --release --example dense_crf -p evermap-bench -- \
//!     --width 1024 --height 333 --classes 9 --iterations 10 --repeat 5 --image im.rgb --costs unary.f32 --out q.f32
//! ```
//! The image is interleaved bytes; costs and the resulting probabilities are little-endian floats, pixel after pixel,
//! classes innermost. The kernels are the default ones.
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    clippy::unwrap_used,
    clippy::expect_used
)]

use std::collections::BTreeMap;

use evermap_algorithms::learning::dense_crf::{ColourView, Kernels, RandomField, Unary};
use evermap_bench::Failure;
use evermap_bench::timing::processor_seconds;

struct Arguments(BTreeMap<String, String>);

impl Arguments {
    fn text(&self, name: &str) -> Result<&str, Failure> {
        let found = self.0.get(name).ok_or(format!("expected --{name}"))?;
        Ok(found)
    }

    fn number(&self, name: &str) -> Result<u32, Failure> {
        Ok(self.text(name)?.parse()?)
    }
}

fn arguments() -> Result<Arguments, Failure> {
    let mut found = BTreeMap::new();
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let value = words.next().ok_or(format!("{word} needs a value"))?;
        found.insert(word.trim_start_matches("--").to_owned(), value);
    }
    Ok(Arguments(found))
}

fn main() -> Result<(), Failure> {
    let given = arguments()?;
    let bytes = std::fs::read(given.text("image")?)?;
    let image = ColourView::new(given.number("width")?, given.number("height")?, &bytes)
        .ok_or("expected an image of width × height × 3 bytes")?;
    let costs = std::fs::read(given.text("costs")?)?;
    let costs: Vec<f32> = costs
        .as_chunks()
        .0
        .iter()
        .map(|bytes| f32::from_le_bytes(*bytes))
        .collect();
    let unary = Unary::new(given.number("classes")? as usize, costs)?;
    let iterations = given.number("iterations")?;
    let mut best = (f64::INFINITY, 0.0);
    for _ in 0..given.number("repeat")? {
        let start = processor_seconds()?;
        let field = RandomField::new(&image, &Kernels::default(), false)?;
        let prepared = processor_seconds()? - start;
        let found = field.infer(&unary, iterations)?;
        let seconds = processor_seconds()? - start;
        if seconds < best.0 {
            best = (seconds, prepared);
        }
        let floats = found
            .probabilities
            .iter()
            .flat_map(|value| value.to_le_bytes());
        std::fs::write(given.text("out")?, floats.collect::<Vec<u8>>())?;
    }
    println!("{{\"seconds\": {}, \"prepared\": {}}}", best.0, best.1);
    Ok(())
}
