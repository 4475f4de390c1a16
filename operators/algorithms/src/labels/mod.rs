//! What people say about a map: acts that come together to labels, their outlines, and the vehicle poses that they are
//! tied to, so that they move with the map; and the pixels of images that they paint.

pub mod anchors;
pub mod folding;
pub mod painting;
pub mod shapes;
