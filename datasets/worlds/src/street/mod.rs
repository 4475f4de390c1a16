//! A street with houses, trees, signs and cars, seen in panoramas.
//!
//! ```text
//! course ── stretch ── ground ─┐
//!                └──── town ───┴─ sight ─┬─ labels ── labeller
//! visit ─┬─ traffic ───────────────┘     └─ paint
//!        └─ session, truth
//! ```

mod classes;
mod course;
mod ground;
mod labeller;
mod labels;
mod paint;
mod params;
mod session;
mod sight;
mod stretch;
#[cfg(test)]
mod tests;
mod things;
mod town;
mod traffic;
mod truth;
mod views;
mod visit;

pub use classes::{STREET_CLASSES, STREET_COLOURS};
pub use params::Street;
pub use session::street;
pub use views::{LabelKind, LabelView, StreetLabels, street_labels};
