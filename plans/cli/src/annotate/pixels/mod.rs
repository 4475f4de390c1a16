//! Boxes and outlines drawn on a mosaic, or on camera images, with programs that know pixels, read and written.

mod boxes;
mod coco;
mod cvat;
mod described;
mod form;
mod label_studio;
mod outline;
mod yolo;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use clap::ValueEnum;
use evermap_schemas::Fault;
use evermap_schemas::layers::{BoxHypothesis, PlacedLabel};
use evermap_schemas::roles::annotations::is_word;

pub(super) use boxes::{Boxes, PictureBox};
pub(super) use described::Canvas;

use form::JsonForm;

use super::features::{DrawnFeature, Geometry, TOO_MANY_POINTS};
use super::mosaic::Picture;
use super::reading::{AnyJson, Member};
use super::{Losses, is_blank};
use crate::ending::Failure;
use crate::scene::corners;

/// A place in a picture, px from its upper left corner.
pub(super) type Pixel = [f64; 2];

/// The word with which the name of a label goes through programs that keep such things.
const NAME: &str = "evermap_label";

/// What was drawn is where it was if no point of it has moved by more, px: programs round, and the way to a picture and back
/// does.
const SAME_PX: f64 = 0.5;

/// A program's way to write annotations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Program {
    /// Common Objects in Context.
    Coco,
    /// CVAT for images 1.1.
    Cvat,
    /// A task of Label Studio, with what the map proposes as predictions.
    LabelStudio,
    /// YOLO's oriented boxes, with the names of their classes in classes.txt beside; classes that it has keep their numbers.
    YoloObb,
}

impl Program {
    /// That of a file, by what it holds; `None` where it is none of them. Text that is nothing else, and may be empty, is
    /// YOLO's if it is called so.
    pub(super) fn of(path: &Path, text: &str) -> Option<Self> {
        if text.trim_start().starts_with('<') {
            return Some(Self::Cvat);
        }
        let is_text = path.extension().is_some_and(|extension| extension == "txt");
        match serde_json::from_str(text) {
            Ok(AnyJson(JsonForm::List)) => Some(Self::LabelStudio),
            Ok(AnyJson(JsonForm::Object { has_images })) => has_images.then_some(Self::Coco),
            _ => (is_text || yolo::begins(text)).then_some(Self::YoloObb),
        }
    }

    /// The features of a file; what makes no sense is noted and left out.
    ///
    /// # Errors
    /// A user fault for a file of another form, or of other pictures.
    pub(super) fn read(
        self,
        path: &Path,
        text: &str,
        picture: &Picture,
        losses: &mut Losses,
    ) -> Result<Vec<DrawnFeature>, Fault> {
        let canvas = Canvas {
            name: picture.name.clone(),
            size: picture.size,
        };
        let mut drawn = self.said(path, text, &[canvas], losses)?.drawn;
        drawn.retain(|drawn| {
            let is_long = matches!(drawn.shape, Shape::Around(_));
            if is_long {
                losses.note(TOO_MANY_POINTS, &drawn.place);
            }
            !is_long
        });
        disown_copies(&mut drawn);
        Ok(drawn
            .into_iter()
            .map(|drawn| drawn.feature(picture))
            .collect())
    }

    fn said(
        self,
        path: &Path,
        text: &str,
        canvases: &[Canvas],
        losses: &mut Losses,
    ) -> Result<PictureAnnotations, Fault> {
        match self {
            Self::Coco => coco::read(text, canvases, losses),
            Self::Cvat => cvat::read(text, canvases, losses),
            Self::LabelStudio => label_studio::read(text, canvases, losses),
            Self::YoloObb => {
                let size = canvases.first().map(|canvas| canvas.size);
                let size = size.unwrap_or_default();
                let drawn = yolo::read(text, &yolo::classes(path)?, size, losses);
                Ok(PictureAnnotations {
                    drawn,
                    seen: BTreeSet::from([0]),
                    unread: BTreeSet::new(),
                })
            }
        }
    }

    /// What the file of a picture says of these labels and, where the program knows such, of what was proposed. What it
    /// has no form for is noted and left out.
    ///
    /// # Errors
    /// As [`write_file`](crate::output::write_file), of the classes' file, and a user fault for a file in its place.
    pub fn write(
        self,
        path: &Path,
        picture: &Picture,
        (labels, proposed): (&[PlacedLabel], &[BoxHypothesis]),
        losses: &mut Losses,
    ) -> Result<String, Failure> {
        let labels = labels.iter().filter(|label| label.standing != "rejected");
        let mut drawn = Vec::new();
        for label in labels {
            let seen = DrawnShape::of_label(label, picture);
            match self.lacks(&seen) {
                None if seen.is_in(picture.size) => drawn.push(seen),
                None => losses.note("label outside of the picture", &seen.place),
                Some(reason) => losses.note(reason, &seen.place),
            }
        }
        let proposed = proposed.iter();
        let proposed = proposed.filter_map(|found| DrawnShape::of_hypothesis(found, picture));
        let proposed: Vec<DrawnShape> =
            proposed.filter(|drawn| drawn.is_in(picture.size)).collect();
        match self {
            Self::Coco => Ok(coco::write(&drawn, picture)),
            Self::Cvat => Ok(cvat::write(&drawn, picture)),
            Self::LabelStudio => Ok(label_studio::write(&drawn, &proposed, picture)),
            Self::YoloObb => yolo::write(&drawn, picture, path),
        }
    }

    /// Why a label cannot be said.
    fn lacks(self, drawn: &DrawnShape) -> Option<&'static str> {
        let mut words = [&drawn.kind, &drawn.name].into_iter().flatten();
        // An older evermap took any text.
        if words.any(|word| !is_word(word)) {
            return Some("label whose kind or name has a control character");
        }
        match (self, &drawn.shape) {
            (Self::YoloObb, Shape::Closed(_)) => {
                Some("polygon, which YOLO's oriented boxes are not")
            }
            (Self::Cvat, Shape::Open(_))
            | (_, Shape::Box(_) | Shape::Closed(_) | Shape::Around(_)) => None,
            (_, Shape::Open(_)) => Some("line, which the format has no form for"),
        }
    }
}

/// What a file says of pictures.
#[derive(Debug, Default)]
struct PictureAnnotations {
    drawn: Vec<DrawnShape>,
    /// Those that somebody looked at, also where nothing is drawn on them.
    seen: BTreeSet<usize>,
    /// Those with a shape that could not be read.
    unread: BTreeSet<usize>,
}

/// What is drawn on a picture.
#[derive(Debug, Clone, PartialEq)]
struct DrawnShape {
    /// Which one, for people.
    place: String,
    /// The label that it is, where it says so.
    name: Option<String>,
    /// What it marks, where it says so.
    kind: Option<String>,
    shape: Shape,
    /// The number of its picture.
    picture: usize,
    /// How likely it is, where it is only proposed.
    probability: Option<f64>,
}

#[derive(Debug, Clone, PartialEq)]
enum Shape {
    Box(Rectangle),
    /// Corners of an outline.
    Closed(Vec<Pixel>),
    /// Corners of the box around an outline that has more of them than a label may have.
    Around([Pixel; 4]),
    /// Points of a line.
    Open(Vec<Pixel>),
}

/// A rectangle that is turned clockwise, as seen (rows grow downward), about its first corner.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Rectangle {
    corner: Pixel,
    /// Along its own axes.
    size: [f64; 2],
    degrees: f64,
}

impl Rectangle {
    /// As programs have it that turn about the middle.
    fn about_middle([left, top]: Pixel, size: [f64; 2], degrees: f64) -> Self {
        let middle = [left + size[0] / 2.0, top + size[1] / 2.0];
        Self {
            corner: turned([left, top], middle, degrees),
            size,
            degrees,
        }
    }

    /// The upper left corner that it has when it is turned back about its middle.
    fn turned_back(&self) -> Pixel {
        turned(self.corner, self.middle(), -self.degrees)
    }

    fn middle(&self) -> Pixel {
        let [x, y] = self.corner;
        let opposite = [x + self.size[0] / 2.0, y + self.size[1] / 2.0];
        turned(opposite, self.corner, self.degrees)
    }

    fn corners(&self) -> [Pixel; 4] {
        let ([x, y], [width, height]) = (self.corner, self.size);
        let corners = [
            [x, y],
            [x + width, y],
            [x + width, y + height],
            [x, y + height],
        ];
        corners.map(|at| turned(at, self.corner, self.degrees))
    }

    /// Of a label's corners: ahead left, behind left, behind right, ahead right. Its width is the label's length.
    fn of([ahead_left, left, right, ahead_right]: [Pixel; 4]) -> Self {
        let from = |a: Pixel, b: Pixel| [b[0] - a[0], b[1] - a[1]];
        let (along, across) = (from(left, ahead_left), from(left, right));
        // In a picture that is mirrored the right side is the left one.
        let mirrored = along[0] * across[1] - along[1] * across[0] < 0.0;
        let (corner, along) = match mirrored {
            true => (right, from(right, ahead_right)),
            false => (left, along),
        };
        Self {
            corner,
            size: [along, across].map(|[x, y]| x.hypot(y)),
            degrees: along[1].atan2(along[0]).to_degrees(),
        }
    }
}

/// A pixel turned clockwise, as seen, about another: rows grow downward.
fn turned(at: Pixel, about: Pixel, degrees: f64) -> Pixel {
    let (sin, cos) = degrees.to_radians().sin_cos();
    let (x, y) = (at[0] - about[0], at[1] - about[1]);
    [about[0] + cos * x - sin * y, about[1] + sin * x + cos * y]
}

impl Shape {
    fn points(&self) -> Vec<Pixel> {
        match self {
            Self::Box(found) => found.corners().to_vec(),
            Self::Closed(points) | Self::Open(points) => points.clone(),
            Self::Around(corners) => corners.to_vec(),
        }
    }

    /// Least and largest column and row.
    fn bounds(&self) -> [Pixel; 2] {
        let points = self.points();
        let of = |axis: usize, fold: fn(f64, f64) -> f64| {
            let values = points.iter().map(|point| point[axis]);
            values.reduce(fold).unwrap_or(0.0)
        };
        [
            [of(0, f64::min), of(1, f64::min)],
            [of(0, f64::max), of(1, f64::max)],
        ]
    }
}

impl DrawnShape {
    /// What is there, and not only proposed.
    fn said(place: String, kind: Option<String>, shape: Shape) -> Self {
        Self {
            place,
            name: None,
            kind: kind.filter(|kind| !is_blank(kind)),
            shape,
            picture: 0,
            probability: None,
        }
    }

    /// Drawn on the picture of this number.
    fn on(self, picture: usize) -> Self {
        Self { picture, ..self }
    }

    /// With the name of the label that it is.
    fn called(self, name: Option<String>) -> Self {
        Self { name, ..self }
    }

    fn of_label(label: &PlacedLabel, picture: &Picture) -> Self {
        let points = label.points.iter();
        let points: Vec<Pixel> = points.map(|[x, y, _]| picture.pixel([*x, *y])).collect();
        let shape = match (
            label.shape.as_str(),
            <[Pixel; 4]>::try_from(points.as_slice()),
        ) {
            ("box", Ok(corners)) => Shape::Box(Rectangle::of(corners)),
            ("polyline", _) => Shape::Open(points),
            _ => Shape::Closed(points),
        };
        let place = format!("label {}", label.label);
        Self::said(place, Some(label.kind.clone()), shape).called(Some(label.label.clone()))
    }

    fn of_hypothesis(found: &BoxHypothesis, picture: &Picture) -> Option<Self> {
        let corners = corners(&found.map_from_label, [found.length_m, found.width_m])?;
        let corners = corners.map(|[x, y, _]| picture.pixel([x, y]));
        Some(Self {
            place: format!("hypothesis {}", found.hypothesis),
            name: None,
            kind: Some(found.kind.clone()),
            shape: Shape::Box(Rectangle::of(corners)),
            picture: 0,
            probability: Some(found.probability),
        })
    }

    /// Whether any point lies in a picture.
    fn is_in(&self, [width, height]: [u32; 2]) -> bool {
        let most = [f64::from(width), f64::from(height)];
        let points = self.shape.points();
        let mut points = points.iter();
        points.any(|point| (0..2).all(|axis| (0.0..=most[axis]).contains(&point[axis])))
    }

    fn feature(self, picture: &Picture) -> DrawnFeature {
        let points = self.shape.points().into_iter();
        let points = points.map(|pixel| (picture.place(pixel), None)).collect();
        DrawnFeature {
            place: self.place,
            label: self.name,
            within_m: Some(SAME_PX * picture.pixel_m()),
            kind: None,
            category: self.kind,
            standing: None,
            geometry: Some(match self.shape {
                Shape::Open(_) => Geometry::Open(points),
                _ => Geometry::Closed(points),
            }),
            brush_px: None,
            image: None,
        }
    }
}

/// Takes a name from all that have it, where several do: who copies a shape copies its name.
fn disown_copies(drawn: &mut [DrawnShape]) {
    let mut times: BTreeMap<String, usize> = BTreeMap::new();
    for name in drawn.iter().filter_map(|drawn| drawn.name.as_ref()) {
        *times.entry(name.clone()).or_default() += 1;
    }
    let is_copied = |name: &String| times.get(name).is_some_and(|times| *times > 1);
    for drawn in drawn {
        if drawn.name.as_ref().is_some_and(is_copied) {
            drawn.name = None;
        }
    }
}

/// What is marked, each kind once, ascending.
fn kinds(drawn: &[DrawnShape]) -> Vec<&str> {
    let kinds = drawn.iter().filter_map(|drawn| drawn.kind.as_deref());
    kinds.collect::<BTreeSet<&str>>().into_iter().collect()
}

/// Degrees by which a shape is turned; 0 where nothing is said.
///
/// # Errors
/// In words, for what is no number: the shape lies otherwise than it would be read.
fn degrees(member: &Member) -> Result<f64, &'static str> {
    match member {
        Member::Nothing => Ok(0.0),
        member => member.number().ok_or(TURNED),
    }
}

/// Why a shape is left out.
const TURNED: &str = "annotation whose rotation is no number of degrees";
const NO_SHAPE: &str = "annotation that is neither box, outline nor line";

#[cfg(test)]
mod tests;
