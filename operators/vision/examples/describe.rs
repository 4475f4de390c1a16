//! The features of a folder's images in a file, for `tests/peers/places.py`.
//!
//! ```text
//! cargo run --release --example describe -p evermap-vision -- FOLDER OUT [count]
//! ```
//! Image after image, by name: how many features (u32, little endian), then 64 bytes for each.
#![allow(clippy::print_stderr)]

use std::io::Write;

use evermap_vision::{Blind, Detectors, FeatureParams, Grey, decode_grey};

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let (Some(folder), Some(out)) = (words.first(), words.get(1)) else {
        return Err("expected FOLDER OUT [count]".into());
    };
    let mut params = FeatureParams::default();
    if let Some(count) = words.get(2) {
        params.count = count.parse()?;
    }
    let entries = std::fs::read_dir(folder)?.map(|entry| entry.map(|entry| entry.path()));
    let mut paths = entries.collect::<Result<Vec<_>, _>>()?;
    paths.sort();
    let mut out = std::io::BufWriter::new(std::fs::File::create(out)?);
    let (mut grey, mut total) = (Grey::default(), 0);
    let detectors = Detectors::default();
    for path in &paths {
        decode_grey(&std::fs::read(path)?, &mut grey)?;
        let found = detectors.features(&grey, &params, &Blind::default())?;
        out.write_all(&u32::try_from(found.len())?.to_le_bytes())?;
        out.write_all(&found.descriptors)?;
        total += found.len();
    }
    eprintln!("{} images, {total} features", paths.len());
    Ok(())
}
