//! Labels: what people say about a map, tied to the poses that it was seen from, and placed in each version.

use crate::roles::Anchor;
use crate::{Pose, Stamp, Wkb, record};

record! {
    /// A label as its latest acts made it, and what holds it when the map moves: a vehicle pose, or else a map frame.
    #[layer("label_anchors", key(site, label))]
    pub struct LabelAnchor {
        /// Site of the map.
        site: String,
        /// The label.
        label: String,
        /// What it marks.
        kind: String,
        /// `drawn`, `accepted`, or `rejected`: there is no such thing here.
        standing: String,
        /// Who said the latest of it.
        author: String,
        /// When the latest of it was said.
        said: Stamp ["ns"],
        /// The session, a log of annotations, whose act says where it is.
        log: String,
        /// `box`, `polygon` or `polyline`.
        shape: String,
        /// Its outline, as annotations give it.
        points: Vec<[f64; 3]> ["m", "label"],
        /// Its frame in the map that was looked at when it was drawn or moved.
        map_from_label: Pose ["", "map"],
        /// The vehicle pose that it is tied to, chosen once; null where none was within reach.
        anchor: Option<Anchor>,
        /// Number of the map frame that holds it where its session is gone, when that was chosen, once; null where the map had
        /// none.
        frame: Option<u32>,
        /// The session whose pose that frame was made from. With its instant it says which frame it is, whatever frame has
        /// the number later; null where the map had none.
        frame_session: Option<String>,
        /// Instant of that pose; null where the map had none.
        frame_stamp: Option<Stamp> ["ns"],
        /// Its own frame in that map frame; null where the map had none.
        frame_from_label: Option<Pose>,
    }
}

record! {
    /// A label where it is in this version of the map.
    #[layer("placed_labels", key(site, label), geometry(geometry))]
    pub struct PlacedLabel {
        /// Site of the map.
        site: String,
        /// The label.
        label: String,
        /// What it marks.
        kind: String,
        /// `drawn`, `accepted`, or `rejected`: there is no such thing here.
        standing: String,
        /// Who said the latest of it.
        author: String,
        /// When the latest of it was said.
        said: Stamp ["ns"],
        /// What placed it: the `pose` of its anchor, its `frame`, the version `before`, or the `drawing` itself, as if the map had
        /// not moved.
        placed_by: String,
        /// The vehicle pose that it is tied to; null where there is none.
        anchor: Option<Anchor>,
        /// `box`, `polygon` or `polyline`.
        shape: String,
        /// Its frame in the map: the middle of the outline; x lies along the length of a box.
        map_from_label: Pose ["", "map"],
        /// Length of a box; null for other shapes.
        length_m: Option<f64> ["m"],
        /// Width of a box; null for other shapes.
        width_m: Option<f64> ["m"],
        /// Its outline.
        points: Vec<[f64; 3]> ["m", "map"],
        /// The outline from above, a polygon, or a line string.
        geometry: Wkb ["m", "map"],
    }
}
