//! Where one area lies with respect to another.

use std::fmt;

use thiserror::Error;

/// A relation between two areas: one of eight directions (paper 2, section V-C), or contact.
///
/// Directions are of the centres, each an eighth of the full circle wide: "right" reaches from 22.5° below to 22.5° above
/// the horizontal. In a panorama they are seen from where it was taken, the shorter way around.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Relation {
    /// The first is left of the second.
    LeftOf,
    /// Above and left.
    AboveLeftOf,
    /// Above.
    Above,
    /// Above and right.
    AboveRightOf,
    /// Right.
    RightOf,
    /// Below and right.
    BelowRightOf,
    /// Below.
    Below,
    /// Below and left.
    BelowLeftOf,
    /// They touch, and the first one's centre is higher: a car on the road.
    On,
    /// They touch.
    Touches,
}

/// Each relation with its word and the paper's.
const WORDS: [(Relation, &str, &str); 10] = [
    (Relation::LeftOf, "left of", "left"),
    (Relation::AboveLeftOf, "above left of", "top left"),
    (Relation::Above, "above", "top"),
    (Relation::AboveRightOf, "above right of", "top right"),
    (Relation::RightOf, "right of", "right"),
    (Relation::BelowRightOf, "below right of", "bottom right"),
    (Relation::Below, "below", "bottom"),
    (Relation::BelowLeftOf, "below left of", "bottom left"),
    (Relation::On, "on", "on"),
    (Relation::Touches, "touches", "touches"),
];

/// A word that is no relation.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("expected a relation ({}), found '{found}'", Relation::words().join(", "))]
pub struct UnknownRelation {
    /// What was found.
    pub found: String,
}

impl Relation {
    /// All relations: the paper's eight directions in its order, then contact.
    pub const ALL: [Self; 10] = [
        Self::LeftOf,
        Self::AboveLeftOf,
        Self::Above,
        Self::AboveRightOf,
        Self::RightOf,
        Self::BelowRightOf,
        Self::Below,
        Self::BelowLeftOf,
        Self::On,
        Self::Touches,
    ];

    /// The relation of a word: `right of`, `above left of`, `on`, `touches` and so on, or the paper's `top left`. Case,
    /// underscores and repeated spaces do not matter.
    ///
    /// # Errors
    /// [`UnknownRelation`], which lists the words.
    pub fn parse(text: &str) -> Result<Self, UnknownRelation> {
        let words: Vec<String> = text
            .split(|c: char| c.is_whitespace() || c == '_')
            .filter(|word| !word.is_empty())
            .map(str::to_lowercase)
            .collect();
        let text_plain = words.join(" ");
        let known = WORDS
            .iter()
            .find(|(_, word, paper)| text_plain == *word || text_plain == *paper);
        known
            .map(|(relation, _, _)| *relation)
            .ok_or_else(|| UnknownRelation {
                found: text.to_owned(),
            })
    }

    /// The words, in the order of [`Relation::ALL`].
    pub fn words() -> Vec<&'static str> {
        WORDS.iter().map(|(_, word, _)| *word).collect()
    }

    /// The word.
    pub fn word(self) -> &'static str {
        WORDS[self as usize].1
    }

    /// The direction, of the eight, in which an offset (right, down) points; none for no or no finite offset.
    pub fn direction([right, down]: [f32; 2]) -> Option<Self> {
        if !(right.is_finite() && down.is_finite()) || (right == 0.0 && down == 0.0) {
            return None;
        }
        /// The tangent of 22.5°.
        const STEEP: f32 = std::f32::consts::SQRT_2 - 1.0;
        let level = down.abs() < STEEP * right.abs();
        let upright = right.abs() < STEEP * down.abs();
        Some(match (level, upright, right < 0.0, down < 0.0) {
            (true, _, true, _) => Self::LeftOf,
            (true, _, false, _) => Self::RightOf,
            (_, true, _, true) => Self::Above,
            (_, true, _, false) => Self::Below,
            (_, _, true, true) => Self::AboveLeftOf,
            (_, _, false, true) => Self::AboveRightOf,
            (_, _, false, false) => Self::BelowRightOf,
            (_, _, true, false) => Self::BelowLeftOf,
        })
    }

    /// Whether only areas that touch can be so related.
    pub fn needs_contact(self) -> bool {
        matches!(self, Self::On | Self::Touches)
    }

    /// Whether two areas are so related, given how far right and down the first one's centre lies of the second's (px)
    /// and, where contact matters, that they touch.
    pub fn fits(self, [right, down]: [f32; 2]) -> bool {
        match self {
            Self::Touches => true,
            Self::On => down < 0.0,
            direction => Self::direction([right, down]) == Some(direction),
        }
    }
}

impl fmt::Display for Relation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}
