//! What a place looks like without what moves: the stable map, from any number of visits.
//!
//! ```text
//!   visits ──► registration ──► links ──► warp: what others saw behind moving things ──► occlusion: counts, model
//!                                         └──► inference: what nobody saw ◄──────────────────────┘
//! ```
//!
//! Paper 3 (map update with an occlusion model).
//!
//! | module | what it knows |
//! |---|---|
//! | [`classes`] | which classes move, and which are far away |
//! | [`sphere`] | panoramas with range |
//! | [`registration`] | where one panorama was taken, seen from another |
//! | [`links`] | where views are seen from others, along links |
//! | [`warp`] | what other views saw behind moving things |
//! | [`occlusion`] | what moving things hide, in numbers |
//! | [`surroundings`] | what is around a pixel, as a forest sees it |
//! | [`inference`] | what nobody saw, from what is around it |

pub mod classes;
pub mod inference;
pub mod links;
pub mod occlusion;
pub mod registration;
pub mod sphere;
pub mod surroundings;
pub mod warp;

#[cfg(test)]
mod tests;
