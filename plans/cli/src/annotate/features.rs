//! Drawn features, whatever program drew them.

use std::path::Path;

use evermap_algorithms::ground::boxes::area;
use evermap_algorithms::labels::shapes::{self, Outline, crossing};
use evermap_catalog::painted::ImageKey;
use evermap_schemas::Fault;
use evermap_schemas::roles::FARTHEST_M;

use super::geojson::{self, GeoJsonFile};
use super::mosaic::Picture;
use super::pixels::Program;
use super::{Losses, no_json, read_text};

/// A polygon of less than this has no area, m²: a square centimetre.
const LEAST_M2: f64 = 1e-4;

/// What is said of a feature with more than [`shapes::MOST_POINTS`].
pub(super) const TOO_MANY_POINTS: &str = "feature with more than 4096 points";

/// One feature of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct DrawnFeature {
    /// Which one, for people.
    pub place: String,
    /// The label that it is, where it says so.
    pub label: Option<String>,
    /// Of what was drawn on a picture: places nearer than this are the same, m. Other programs round, and a label that it
    /// names may be one of another map.
    pub within_m: Option<f64>,
    /// What it marks, where it says so in evermap's words.
    pub kind: Option<String>,
    /// What it marks in the words of another program, which may be any.
    pub category: Option<String>,
    /// `drawn`, `accepted`, `rejected` or `removed`, where it says so.
    pub standing: Option<String>,
    /// Its outline; `None` for one that only says something of a label.
    pub geometry: Option<Geometry>,
    /// Diameter of the brush that a line on an image was drawn with, px.
    pub brush_px: Option<f64>,
    /// The image that shows it, where it says so: it is tied to the vehicle pose of that image, and no other.
    pub image: Option<ImageKey>,
}

/// An outline in the map, m; without a height where the file has none.
#[derive(Debug, Clone, PartialEq)]
pub enum Geometry {
    /// Corners of a closed outline, each once.
    Closed(Vec<Point>),
    /// Points of a line.
    Open(Vec<Point>),
}

/// x, y and, where it is known, z.
pub type Point = ([f64; 2], Option<f64>);

/// The features of a file. What makes no sense is noted and left out.
///
/// # Errors
/// A user fault for a file that is none of the formats, of pixels without a georeference, or of other pictures.
pub fn read(
    path: &Path,
    mosaic: Option<&Picture>,
    losses: &mut Losses,
) -> Result<Vec<DrawnFeature>, Fault> {
    let at = |fault: Fault| fault.at(path.display());
    let text = read_text(path).map_err(at)?;
    if let Some(program) = Program::of(path, &text) {
        let picture = mosaic.ok_or_else(|| {
            at(Fault::user("these annotations are in pixels of a picture")
                .next("name it with --mosaic, with its world file (.pgw) beside it, or the folder of camera images with --images"))
        })?;
        return program.read(path, &text, picture, losses).map_err(at);
    }
    let file: GeoJsonFile = serde_json::from_str(&text).map_err(|error| at(no_json(&error)))?;
    drop(text);
    if file.is_on_earth() {
        let fault =
            Fault::user("expected features in the map's metres, found longitude and latitude");
        return Err(at(fault.next(
            "`evermap export --format geojson --local` writes the former",
        )));
    }
    match file.is_typed() {
        true => geojson::features(file, losses).map_err(at),
        false => Err(at(Fault::user(
            "expected GeoJSON, COCO, CVAT (XML), Label Studio (JSON) or YOLO's oriented boxes (text), found other JSON",
        ))),
    }
}

impl Geometry {
    /// `box`, `polygon` or `polyline` with its outline about its middle; heights that are not known are that of `ground` in
    /// the middle.
    ///
    /// # Errors
    /// In words, for what is no outline.
    pub fn outline(
        &self,
        ground: impl Fn([f64; 2]) -> f64,
    ) -> Result<(&'static str, Outline), &'static str> {
        let (Self::Closed(points) | Self::Open(points)) = self;
        let finite = |(at, z): &Point| at.iter().chain(z).all(|value| value.is_finite());
        if !points.iter().all(finite) {
            return Err("feature with a coordinate that is not finite");
        }
        let beyond = |(at, z): &Point| at.iter().chain(z).any(|value| value.abs() > FARTHEST_M);
        if points.iter().any(beyond) {
            return Err("feature with a coordinate too large for metres");
        }
        let count = points.len().max(1) as f64;
        let middle = [0, 1].map(|axis| points.iter().map(|(at, _)| at[axis]).sum::<f64>() / count);
        let height = ground(middle);
        let raised = |(at, z): &Point| [at[0], at[1], z.unwrap_or(height)];
        let mut points: Vec<[f64; 3]> = points.iter().map(raised).collect();
        points.dedup();
        if points.len() > shapes::MOST_POINTS {
            return Err(TOO_MANY_POINTS);
        }
        match self {
            Self::Open(_) if points.len() < 2 => Err("line of less than two points"),
            Self::Open(_) => Ok(("polyline", shapes::polyline(&points))),
            Self::Closed(_) => closed(points),
        }
    }
}

fn closed(mut corners: Vec<[f64; 3]>) -> Result<(&'static str, Outline), &'static str> {
    if corners.len() > 1 && corners.first() == corners.last() {
        corners.pop();
    }
    if corners.len() < 3 {
        return Err("polygon of less than three corners");
    }
    if crossing(&corners).is_some() {
        return Err("polygon that crosses itself");
    }
    // From the first one, as products of large coordinates are rounded.
    let from_first = |[x, y, _]: &[f64; 3]| [x - corners[0][0], y - corners[0][1]];
    if area(&corners.iter().map(from_first).collect::<Vec<_>>()) < LEAST_M2 {
        return Err("polygon of no area: its corners lie on one line, or on one another");
    }
    Ok(match shapes::oriented_box(&corners) {
        Some(found) => ("box", found),
        None => ("polygon", shapes::polygon(&corners)),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outline(points: &[[f64; 2]], z: Option<f64>) -> Result<&'static str, &'static str> {
        let points = points.iter().map(|at| (*at, z)).collect();
        let outline = Geometry::Closed(points).outline(|_| 0.0);
        outline.map(|(shape, _)| shape)
    }

    /// No run would read what is written of it.
    #[test]
    fn heights_are_bounded_as_places_are() {
        let triangle = [[0.0, 0.0], [3.0, 0.0], [0.0, 3.0]];
        assert_eq!(outline(&triangle, Some(5.0)), Ok("polygon"));
        let told = Err("feature with a coordinate too large for metres");
        for z in [1e10, -1e10, 1e308] {
            assert_eq!(outline(&triangle, Some(z)), told);
            assert_eq!(outline(&[[z, 0.0], [3.0, 0.0], [0.0, 3.0]], None), told);
        }
    }

    #[test]
    fn a_polygon_has_an_area() {
        let told = Err("polygon of no area: its corners lie on one line, or on one another");
        assert_eq!(outline(&[[0.0, 0.0], [1.0, 1.0], [3.0, 3.0]], None), told);
        let square = |x: f64, side: f64| {
            let corners = [
                [x, 5.0],
                [x + side, 5.0],
                [x + side, 5.0 + side],
                [x, 5.0 + side],
            ];
            outline(&corners, None)
        };
        assert_eq!(square(5.0, 1e-9), told);
        assert_eq!(square(5.0, 0.02), Ok("box"));
        assert_eq!(square(5e6, 0.02), Ok("box"));
    }
}
