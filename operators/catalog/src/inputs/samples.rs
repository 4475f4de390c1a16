//! Samples of a site's labelled images, as classifiers learn from them.

use std::collections::{BTreeMap, BTreeSet};

use evermap_algorithms::learning::samples::Samples;
use evermap_contract::Emit;
use evermap_schemas::Stamp;
use evermap_schemas::layers::{PixelSamples, Source, Sources};

/// All samples, side by side.
#[derive(Default)]
pub(crate) struct SiteSamples {
    dimensions: usize,
    pub(crate) classes: Vec<String>,
    /// What the features are, as JSON.
    pub(crate) features: String,
    class_pixels: Vec<u64>,
    labels: Vec<u8>,
    values: Vec<u8>,
    blocks: Vec<u32>,
    /// What each block is of.
    parts: BTreeMap<u32, Sources>,
}

impl SiteSamples {
    /// Of images that fit the first one, cut into blocks; others are counted.
    pub(crate) fn of(samples: Vec<PixelSamples>, blocks: u32, emit: &mut Emit<'_>) -> Self {
        let block = blocks_of(&samples, blocks);
        let first = &samples[0];
        let features = first.features.clone();
        let mut all = Self {
            dimensions: first.dimensions as usize,
            features,
            ..Self::default()
        };
        for row in samples {
            let fits = row.values.0.len() == row.labels.len() * all.dimensions;
            if row.features != all.features || row.dimensions as usize != all.dimensions {
                emit.skip("features are others than those of the first image", 1);
            } else if !fits || row.class_pixels.len() > row.classes.len() {
                emit.skip("samples, labels and classes do not fit each other", 1);
            } else {
                let name = (row.session.clone(), row.stamp);
                let block = block.get(&name).copied().unwrap_or(0);
                all.add(row, block, emit);
            }
        }
        all
    }

    fn add(&mut self, row: PixelSamples, block: u32, emit: &mut Emit<'_>) {
        let own: Vec<usize> = row.classes.iter().map(|name| self.class(name)).collect();
        for (class, pixels) in own.iter().zip(&row.class_pixels) {
            if let Some(sum) = self.class_pixels.get_mut(*class) {
                *sum = sum.saturating_add(*pixels);
            }
        }
        let samples = row.values.0.chunks_exact(self.dimensions.max(1));
        for (label, sample) in row.labels.iter().zip(samples) {
            let class = own.get(usize::from(*label)).copied();
            match class.and_then(|class| u8::try_from(class).ok()) {
                Some(class) => {
                    self.labels.push(class);
                    self.values.extend_from_slice(sample);
                    self.blocks.push(block);
                }
                None => emit.skip("sample has no class", 1),
            }
        }
        let parts = self.parts.entry(block).or_default();
        parts.add(&row.session, row.stamp, row.stamp);
    }

    /// Index of a class, which is new the first time.
    fn class(&mut self, name: &str) -> usize {
        let known = self.classes.iter().position(|class| class == name);
        known.unwrap_or_else(|| {
            self.classes.push(name.to_owned());
            self.class_pixels.push(0);
            self.classes.len() - 1
        })
    }

    /// As algorithms take them.
    pub(crate) fn samples(&self) -> Samples<'_> {
        Samples {
            dimensions: self.dimensions,
            classes: self.classes.len(),
            labels: &self.labels,
            values: &self.values,
            blocks: &self.blocks,
        }
    }

    /// Share of each class among the labelled pixels.
    pub(crate) fn priors(&self) -> Vec<f32> {
        let pixels = self.class_pixels.iter().sum::<u64>().max(1) as f64;
        let share = |count: &u64| (*count as f64 / pixels) as f32;
        self.class_pixels.iter().map(share).collect()
    }

    /// The parts of sessions that a block is of.
    pub(crate) fn parts(&self, block: Option<u32>) -> Vec<Source> {
        let parts = block.and_then(|block| self.parts.get(&block).cloned());
        parts.unwrap_or_default().into_rows()
    }
}

/// Block of each image: each session is cut into equal stretches of images. Where sessions are shorter than there are
/// blocks, each begins with another one.
fn blocks_of(samples: &[PixelSamples], blocks: u32) -> BTreeMap<(String, Stamp), u32> {
    let mut sessions: BTreeMap<&str, BTreeSet<Stamp>> = BTreeMap::new();
    for row in samples {
        sessions.entry(&row.session).or_default().insert(row.stamp);
    }
    let mut of = BTreeMap::new();
    for (first, (session, stamps)) in sessions.iter().enumerate() {
        for (index, stamp) in stamps.iter().enumerate() {
            let part = index * blocks as usize / stamps.len();
            let block = (first + part) % blocks as usize;
            of.insert(((*session).to_owned(), *stamp), block as u32);
        }
    }
    of
}
