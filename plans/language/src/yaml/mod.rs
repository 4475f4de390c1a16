//! YAML as a tree in which every value knows its line and column.
//!
//! [`read`] builds the tree; [`Fields`] and the methods of [`Node`] decode it, recording faults
//! and going on.
//!
//! YAML 1.2 with the core schema. Anchors and aliases work; merge keys (`<<`, YAML 1.1),
//! application tags, keys that are not scalars and second documents are faults. Text,
//! depth and number of nodes are bounded, so that no input exhausts stack or memory.

mod decode;
mod scalar;
mod tree;

pub(crate) use decode::{Fields, json_object, merge};
pub(crate) use scalar::plain;
pub(crate) use tree::{read, read_from};

use crate::fault::Location;

/// Texts longer than this many bytes are refused.
pub const LONGEST_TEXT: usize = 4 << 20;
/// Collections may be nested this deep.
pub(crate) const DEEPEST: usize = 64;
/// Nodes a tree may have, aliases counted in full.
pub(crate) const MOST_NODES: usize = 500_000;

/// A value and where it is written.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Node {
    /// Where its first character is.
    pub location: Location,
    /// The value.
    pub kind: Kind,
}

/// The value of a [`Node`].
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Kind {
    /// `null`, `~` or nothing.
    Null,
    /// `true` or `false`.
    Bool(bool),
    /// A whole number from `i64::MIN` to `u64::MAX`.
    Integer(i128),
    /// A number with a point or an exponent, `.inf` or `.nan`.
    Float(f64),
    /// Anything else that is not a collection, and everything quoted.
    Text(String),
    /// `[a, b]` or lines that start with `-`.
    Sequence(Vec<Node>),
    /// `{a: b}` or lines `a: b`, in written order, each key once.
    Mapping(Vec<Entry>),
}

/// One `key: value` of a mapping.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Entry {
    /// The key as written, without quotes.
    pub key: String,
    /// Where the key is.
    pub location: Location,
    /// The value.
    pub value: Node,
}

impl Entry {
    /// Whether it is written in the plan itself, not in one that it extends.
    pub(crate) fn is_own(&self) -> bool {
        self.location.position().source == 0
    }
}
