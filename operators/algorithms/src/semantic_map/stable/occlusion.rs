//! What stands behind moving things, in numbers: the occlusion model.
//!
//! Paper 3, equation 4: `P(static | dynamic) = O(static, dynamic) / N(dynamic)`, over all pixels that were relabelled. N is
//! per dynamic class.

use super::classes::Kinds;

/// How many pixels of a dynamic class turned out to hide a static one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Occlusion {
    /// What was in front.
    pub dynamic: u8,
    /// What is behind.
    pub class: u8,
    /// Pixels.
    pub pixels: u64,
}

/// Counts what changed from one label image to the next, ordered by class, and how many dynamic pixels are left.
pub fn count(before: &[u8], after: &[u8], kinds: &Kinds) -> (Vec<Occlusion>, u64) {
    let classes = kinds.len();
    let mut counts = vec![0_u64; classes * classes];
    let mut left = 0;
    for (before, after) in before
        .iter()
        .zip(after)
        .filter(|(before, _)| kinds.is_dynamic(**before))
    {
        if kinds.is_static(*after) {
            counts[usize::from(*before) * classes + usize::from(*after)] += 1;
        } else if kinds.is_dynamic(*after) {
            left += 1;
        }
    }
    let found = counts.iter().enumerate().filter(|(_, pixels)| **pixels > 0);
    let found = found.map(|(at, pixels)| Occlusion {
        dynamic: (at / classes) as u8,
        class: (at % classes) as u8,
        pixels: *pixels,
    });
    (found.collect(), left)
}

/// How probably a static class is behind a dynamic one.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    classes: usize,
    /// By dynamic class, then static class.
    probabilities: Vec<f64>,
}

impl Model {
    /// Of counts; a class that was never seen to hide anything has no probabilities.
    pub fn new(classes: usize, counts: impl IntoIterator<Item = Occlusion>) -> Self {
        let mut probabilities = vec![0.0; classes * classes];
        for count in counts {
            let (dynamic, class) = (usize::from(count.dynamic), usize::from(count.class));
            if dynamic < classes && class < classes {
                probabilities[dynamic * classes + class] += count.pixels as f64;
            }
        }
        for of_dynamic in probabilities.chunks_mut(classes.max(1)) {
            let all: f64 = of_dynamic.iter().sum();
            if all > 0.0 {
                of_dynamic.iter_mut().for_each(|count| *count /= all);
            }
        }
        Self {
            classes,
            probabilities,
        }
    }

    /// `P(class | dynamic)`; 0 where nothing is known.
    pub fn probability(&self, class: u8, dynamic: u8) -> f64 {
        let (dynamic, class) = (usize::from(dynamic), usize::from(class));
        let known = dynamic < self.classes && class < self.classes;
        if known {
            self.probabilities[dynamic * self.classes + class]
        } else {
            0.0
        }
    }

    /// The class that is most probably behind a dynamic one, and how probably; the first of equal ones, `None` where
    /// nothing is known.
    pub fn most_probable(&self, dynamic: u8) -> Option<(u8, f64)> {
        let classes = (0..self.classes).map(|class| class as u8);
        let known = classes.map(|class| (class, self.probability(class, dynamic)));
        let best = known.fold(None, |best: Option<(u8, f64)>, found| match best {
            Some(best) if best.1 >= found.1 => Some(best),
            _ => Some(found),
        });
        best.filter(|(_, probability)| *probability > 0.0)
    }
}
