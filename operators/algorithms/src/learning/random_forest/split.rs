//! The best threshold of one feature over the samples of one node.

/// Counts of classes in each of the 256 bins of a feature, and which bins have any.
pub(super) struct Histogram {
    classes: usize,
    counts: Vec<u32>,
    occupied: [u64; 4],
}

/// A way to split a node.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Split {
    pub(super) feature: u16,
    pub(super) threshold: u8,
    /// `Σ_side (Σ_c w_c²n_c²) / Σ_c w_c n_c`: the greater, the less Gini impurity is left.
    pub(super) purity: f64,
}

impl Histogram {
    pub(super) fn new(classes: usize) -> Self {
        Self {
            classes,
            counts: vec![0; 256 * classes],
            occupied: [0; 4],
        }
    }

    pub(super) fn add(&mut self, bin: u8, class: u8, count: u32) {
        let bin = usize::from(bin);
        self.counts[bin * self.classes + usize::from(class)] += count;
        self.occupied[bin / 64] |= 1 << (bin % 64);
    }

    /// The purest split that leaves at least `least` samples on either side, and an empty histogram.
    pub(super) fn take_best(
        &mut self,
        totals: &[u32],
        weights: &[f64],
        least: u64,
    ) -> Option<(u8, f64)> {
        let mut sides = Sides::new(totals, weights);
        let mut best: Option<(u8, f64)> = None;
        let mut previous: Option<(usize, f64)> = None;
        for word in 0..4 {
            let mut bits = std::mem::take(&mut self.occupied[word]);
            while bits != 0 {
                let bin = 64 * word + bits.trailing_zeros() as usize;
                bits &= bits - 1;
                if let Some((before, purity)) = previous.take()
                    && best.is_none_or(|(_, best)| purity > best)
                {
                    // Half-way between values that were seen.
                    best = Some((((before + bin) / 2).min(bin - 1) as u8, purity));
                }
                let counts = &mut self.counts[bin * self.classes..(bin + 1) * self.classes];
                for (class, count) in counts.iter_mut().enumerate() {
                    match std::mem::take(count) {
                        0 => {}
                        count => sides.move_left(class, count),
                    }
                }
                if sides.left.count >= least && sides.right.count >= least {
                    previous = Some((bin, sides.left.purity() + sides.right.purity()));
                }
            }
        }
        best
    }
}

/// One side of a split.
#[derive(Default)]
struct Side {
    /// Weighted count of each class.
    classes: Vec<f64>,
    count: u64,
    sum: f64,
    squares: f64,
}

impl Side {
    fn change(&mut self, class: usize, by: f64) {
        let before = self.classes[class];
        let after = before + by;
        self.classes[class] = after;
        self.sum += by;
        self.squares += (after - before) * (after + before);
    }

    fn purity(&self) -> f64 {
        match self.sum > 0.0 {
            true => self.squares / self.sum,
            false => 0.0,
        }
    }
}

/// Both sides of a split, while samples move from right to left.
struct Sides<'a> {
    weights: &'a [f64],
    left: Side,
    right: Side,
}

impl<'a> Sides<'a> {
    fn new(totals: &[u32], weights: &'a [f64]) -> Self {
        let weighted = totals.iter().zip(weights);
        let classes: Vec<f64> = weighted.map(|(n, weight)| f64::from(*n) * weight).collect();
        Self {
            weights,
            left: Side {
                classes: vec![0.0; totals.len()],
                ..Side::default()
            },
            right: Side {
                count: totals.iter().map(|n| u64::from(*n)).sum(),
                sum: classes.iter().sum(),
                squares: classes.iter().map(|n| n * n).sum(),
                classes,
            },
        }
    }

    fn move_left(&mut self, class: usize, count: u32) {
        let by = self.weights[class] * f64::from(count);
        self.left.count += u64::from(count);
        self.right.count -= u64::from(count);
        self.left.change(class, by);
        self.right.change(class, -by);
    }
}
