//! The renderer of all worlds: which face of which solid each pixel of a camera sees, and how far away.
//!
//! Every pixel's ray is known in the vehicle's frame once and for all, so an image costs one rotation per ray and an
//! exact intersection with what surrounds it all and with the few solids that can show in its tile. Tiles of 16 × 16
//! pixels keep all of that in the first-level cache and let the compiler use vector instructions. What a face looks like
//! is the world's own.

mod cast;
mod lens;
mod solid;

pub use cast::{Eye, FAR, Scratch, VisibleSolid, cast, nearest_first, seen_from};
#[cfg(test)]
pub use cast::{meet_solid, meet_solids};
#[cfg(test)]
pub use lens::Window;
pub use lens::{Lanes, Lens, PIXELS, looking};
pub use solid::{Side, Solid, box_sides};
