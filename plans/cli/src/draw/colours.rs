//! The palette.

/// Behind everything.
pub const BACKGROUND: &str = "#14171c";
/// The grid, and frames around boxes.
pub const FAINT: &str = "#ffffff";
/// Scale bar, letters.
pub const INK: &str = "#e8ebf0";
/// Lanes.
pub const LANE: &str = "#38bdf8";
/// Arrows of lanes.
pub const ARROW: &str = "#f0f9ff";
/// Intersections.
pub const INTERSECTION: &str = "#fde047";

/// Parking spaces that are free, and those that are taken: apart for people with any kind of colour vision.
pub const FREE: &str = "#34d3a0";
/// See [`FREE`].
pub const TAKEN: &str = "#ff7a45";
/// Parking spaces of which nobody knows.
pub const UNSEEN: &str = "#9aa5b5";
/// Labels of other kinds.
pub const LABEL: &str = "#e9c5ff";

/// Boxes that a person is asked about.
pub const ASKED: &str = "#ffe14d";
/// Cells to be driven over slowly, and lanes with such cells: the slower, the denser.
pub const SLOW: &str = "#ff3b6b";
/// People who were seen.
pub const PERSON: &str = "#ffffff";

/// Landmarks.
pub const LANDMARK: &str = "#c7d2e0";
/// Loop closures that the map agrees with; told apart from the others as [`FREE`] is from [`TAKEN`].
pub const ACCEPTED: &str = FREE;
/// Loop closures that it does not agree with.
pub const REJECTED: &str = TAKEN;

/// What is new since an earlier version, what is gone, and what moved: told apart as [`FREE`] is from [`TAKEN`].
pub const NEW: &str = FREE;
/// See [`NEW`].
pub const GONE: &str = TAKEN;
/// See [`NEW`].
pub const MOVED: &str = "#f4f06a";

/// Told apart by people with any kind of colour vision (after Okabe and Ito), light enough for a dark ground.
const SESSIONS: [&str; 8] = [
    "#ff9f1c", "#2ee6a6", "#ff6fae", "#b7a0ff", "#f4f06a", "#ff5d5d", "#7fd8ff", "#d0a070",
];

/// The colour of the session with this number: the palette first, then hues a golden angle apart.
pub fn session(index: usize) -> String {
    match SESSIONS.get(index) {
        Some(colour) => (*colour).to_owned(),
        None => {
            let hue = (index as f64 * 137.508) % 360.0;
            format!("hsl({hue:.0}, 80%, 68%)")
        }
    }
}

/// As [`SESSIONS`], for classes: trees green, sky blue, roads grey, buildings brown, cars red in the usual order.
const CLASSES: [&str; 12] = [
    "#3ca03c", "#6eaae6", "#8a8a8a", "#ffd400", "#b45fc8", "#fa9614", "#a5673f", "#e63232",
    "#c8c8a0", "#00c8b4", "#ff78b4", "#7850ff",
];

/// The colour of the class with this number, as `#rrggbb`; classes beyond the palette begin it anew.
pub fn class(index: usize) -> String {
    CLASSES[index % CLASSES.len()].to_owned()
}

/// The colour of a class by its name among all, as `#rrggbb`.
pub fn class_of(name: &str, classes: &[String]) -> String {
    let index = classes.iter().position(|known| known == name);
    class(index.unwrap_or(usize::MAX - 1))
}

/// Red, green, blue and alpha of each value of an image with these classes, by their names among all; transparent where a
/// value is no class.
pub fn palette(named: &[String], classes: &[String]) -> [[u8; 4]; 256] {
    let mut palette = [[0; 4]; 256];
    for (entry, name) in palette.iter_mut().zip(named) {
        *entry = rgba(&class_of(name, classes));
    }
    palette
}

/// A colour that is given as `#rrggbb`, opaque.
pub fn rgba(colour: &str) -> [u8; 4] {
    let [red, green, blue] = [1, 3, 5].map(|at| {
        let hex = colour.get(at..at + 2);
        hex.and_then(|hex| u8::from_str_radix(hex, 16).ok())
            .unwrap_or(128)
    });
    [red, green, blue, 255]
}
