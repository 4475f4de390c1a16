//! Samples that classifiers learn from, and which of several models may score them.

/// What a classifier of bytes learns from.
#[derive(Debug, Clone, Copy)]
pub struct Samples<'a> {
    /// Number of features of a sample.
    pub dimensions: usize,
    /// Number of classes.
    pub classes: usize,
    /// Class of each sample, below `classes`.
    pub labels: &'a [u8],
    /// Features of one sample after the other, `dimensions` each.
    pub values: &'a [u8],
    /// Block of each sample, or empty for none. Each tree or member in turn sees no sample of one block, unless there is
    /// only one: its scores of those are as of samples never seen. Samples that are alike (of one image, one stretch of a drive) belong in
    /// one block.
    pub blocks: &'a [u32],
}

impl Samples<'_> {
    /// The block that each of so many models holds out in turn; of fewer than two blocks none does. No models where there are
    /// no samples, or labels, values and blocks do not fit each other.
    pub(crate) fn held_out(&self, models: u32) -> Vec<Option<u32>> {
        let count = self.labels.len();
        let fits = self.values.len() == count * self.dimensions
            && (self.blocks.is_empty() || self.blocks.len() == count);
        if count == 0 || !fits {
            return Vec::new();
        }
        let mut blocks = self.blocks.to_vec();
        blocks.sort_unstable();
        blocks.dedup();
        let of = |model: u32| (blocks.len() > 1).then(|| blocks[model as usize % blocks.len()]);
        (0..models).map(of).collect()
    }
}

/// The models that score a sample: of a block that some have held out those, else all.
pub(crate) fn voters<M>(
    models: &[M],
    block: Option<u32>,
    held_out: impl Fn(&M) -> Option<u32>,
) -> Vec<&M> {
    let own = |model: &&M| block.is_some() && held_out(model) == block;
    let voters: Vec<&M> = models.iter().filter(own).collect();
    match voters.is_empty() {
        true => models.iter().collect(),
        false => voters,
    }
}
