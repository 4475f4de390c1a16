//! What people say about a map: acts that come together to labels, their outlines, and the vehicle poses that they are
//! tied to, so that they move with the map; which points lie where; and the pixels of images that people paint.

pub mod anchors;
pub mod folding;
pub mod painting;
pub mod points;
pub mod shapes;
