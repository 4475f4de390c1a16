//! Which classes move, and which are far away.

use thiserror::Error;

use crate::semantic_map::semantic_graph::MOST_CLASSES;

/// More classes than labels have values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error("expected at most {MOST_CLASSES} classes, found {0}")]
pub struct TooManyClasses(pub usize);

/// What classes are like, by number.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Kinds {
    dynamic: Vec<bool>,
    far: Vec<bool>,
}

impl Kinds {
    /// Of classes by name: those that move, and those that are so far away that no range can be measured, as the sky is.
    ///
    /// # Errors
    /// [`TooManyClasses`] where there are more than [`MOST_CLASSES`].
    pub fn new(
        classes: &[String],
        dynamic: &[String],
        far: &[String],
    ) -> Result<Self, TooManyClasses> {
        if classes.len() > MOST_CLASSES {
            return Err(TooManyClasses(classes.len()));
        }
        let named = |names: &[String]| classes.iter().map(|class| names.contains(class)).collect();
        Ok(Self {
            dynamic: named(dynamic),
            far: named(far),
        })
    }

    /// Whether things of the class may be elsewhere the next time.
    pub fn is_dynamic(&self, class: u8) -> bool {
        self.dynamic
            .get(usize::from(class))
            .copied()
            .unwrap_or(false)
    }

    /// Whether it is a class, and one that stays where it is.
    pub fn is_static(&self, class: u8) -> bool {
        self.dynamic
            .get(usize::from(class))
            .is_some_and(|dynamic| !dynamic)
    }

    /// Whether its pixels have no range because it is too far away.
    pub fn is_far(&self, class: u8) -> bool {
        self.far.get(usize::from(class)).copied().unwrap_or(false)
    }

    /// Number of classes.
    pub fn len(&self) -> usize {
        self.dynamic.len()
    }

    /// True without classes.
    pub fn is_empty(&self) -> bool {
        self.dynamic.is_empty()
    }
}
