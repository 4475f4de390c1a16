//! Where a view was taken: views found by what they show.
//!
//! ```text
//!   Graph ──► ViewMap   all views' areas by class, elevation and size ──► bound on every view ──► interpretation trees, best first
//!        └──► ClassIndex views by which classes they show, and how many areas of each
//! ```
//!
//! Paper 2 (metric-topological-semantic map), sections IV and V. Two views are compared by an interpretation tree
//! ([`ViewMap::compare`]): areas of one class and similar shape are matched, one after the other, as long as they fit what
//! is matched already. Searching all views ([`ViewMap::search`]) gives the same answer as comparing with each, but most
//! are ruled out by a bound: what each area of the query could at best be matched with, regardless of all others. The paper's
//! own tree, which counts matches, is [`TreeKind::Interpretation`].

mod again;
mod alike;
mod bounds;
mod calibration;
mod class_index;
mod counted;
mod description;
mod fused;
mod headings;
mod interpretation;
mod level;
mod options;
mod tree;
mod view_map;

#[cfg(test)]
pub(super) mod tests;

pub use calibration::{CalibrationOptions, SelfSearch, are_apart, distinctness, self_search};
pub use class_index::ClassIndex;
pub use options::{Options, Scales, ShapeLimits, TreeKind};
pub use view_map::{Hit, Query, ViewMap, matched_areas};

/// The paper's similarity of two graphs: `σ = exp(1 - N / Nm)` of `areas` N in the query, of which `matched` Nm were found
/// in the other; 1 when all were, 0 when none was.
pub fn similarity(areas: u32, matched: u32) -> f64 {
    if matched == 0 {
        return 0.0;
    }
    (1.0 - f64::from(areas) / f64::from(matched)).exp()
}
