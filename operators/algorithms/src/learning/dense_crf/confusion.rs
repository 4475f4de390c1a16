//! How many pixels of each class were found to be what.

/// Which classes were found where: pixels by true and found class.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Confusion {
    classes: usize,
    pixels: Vec<u64>,
}

impl Confusion {
    /// Of no pixels.
    pub fn new(classes: usize) -> Self {
        Self {
            classes,
            pixels: vec![0; classes * classes],
        }
    }

    /// Counts pixels; those whose truth is no class are left out.
    pub fn add(&mut self, truth: &[u8], found: &[u8]) {
        for (truth, found) in truth.iter().zip(found) {
            self.add_as(std::slice::from_ref(truth), *found);
        }
    }

    /// Counts pixels that were found to be of one class.
    pub fn add_as(&mut self, truth: &[u8], found: u8) {
        let found = usize::from(found);
        for truth in truth.iter().map(|truth| usize::from(*truth)) {
            if truth < self.classes && found < self.classes {
                self.pixels[truth * self.classes + found] += 1;
            }
        }
    }

    /// Adds another's counts, of as many classes.
    pub fn merge(&mut self, other: &Self) {
        for (own, other) in self.pixels.iter_mut().zip(&other.pixels) {
            *own += other;
        }
    }

    /// These counts without those of another, which are a part of them.
    pub fn without(&self, part: &Self) -> Self {
        let counts = self.pixels.iter().zip(&part.pixels);
        Self {
            classes: self.classes,
            pixels: counts
                .map(|(all, part)| all.saturating_sub(*part))
                .collect(),
        }
    }

    /// The share of the pixels that are right; 0 without pixels.
    pub fn pixel_accuracy(&self) -> f64 {
        let right: u64 = (0..self.classes)
            .map(|class| self.pixels[class * self.classes + class])
            .sum();
        right as f64 / self.pixels.iter().sum::<u64>().max(1) as f64
    }

    /// The mean, over the classes that there are, of the share of their pixels that are right; 0 without pixels.
    pub fn class_accuracy(&self) -> f64 {
        let of_class = |(class, row): (usize, &[u64])| {
            let all = row.iter().sum::<u64>();
            (all > 0).then(|| row[class] as f64 / all as f64)
        };
        let rows = self.pixels.chunks_exact(self.classes.max(1));
        let shares: Vec<f64> = rows.enumerate().filter_map(of_class).collect();
        shares.iter().sum::<f64>() / shares.len().max(1) as f64
    }

    /// What pixel accuracy and class accuracy gain on another's, whichever gains less: neither pays for the other.
    pub fn gain_on(&self, other: &Self) -> f64 {
        let pixels = self.pixel_accuracy() - other.pixel_accuracy();
        pixels.min(self.class_accuracy() - other.class_accuracy())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;

    #[test]
    fn accuracies_are_shares() {
        let mut confusion = Confusion::new(3);
        confusion.add(&[0, 0, 0, 0, 1, 1, 255], &[0, 0, 0, 1, 1, 0, 0]);
        assert!((confusion.pixel_accuracy() - 4.0 / 6.0).abs() < 1e-12);
        assert!((confusion.class_accuracy() - 0.5 * (0.75 + 0.5)).abs() < 1e-12);
        assert_eq!(Confusion::new(2).class_accuracy(), 0.0);
    }

    #[test]
    fn a_part_is_taken_out() {
        let (mut all, mut part) = (Confusion::new(2), Confusion::new(2));
        part.add(&[0, 1], &[1, 1]);
        all.add(&[0, 0], &[0, 1]);
        let rest = all.clone();
        all.merge(&part);
        assert_eq!(all.without(&part), rest);
    }

    /// More pixels at the cost of a class are no gain.
    #[test]
    fn the_lesser_gain_counts() {
        let of = |found: &[u8]| {
            let mut confusion = Confusion::new(2);
            confusion.add(&[0, 0, 0, 0, 0, 0, 1, 1], found);
            confusion
        };
        let (before, swallowed) = (of(&[0, 0, 0, 0, 1, 1, 1, 1]), of(&[0; 8]));
        assert!(swallowed.pixel_accuracy() >= before.pixel_accuracy());
        assert!(swallowed.gain_on(&before) < 0.0);
        assert!((of(&[0, 0, 0, 0, 0, 1, 1, 1]).gain_on(&before) - 1.0 / 12.0).abs() < 1e-12);
    }
}
