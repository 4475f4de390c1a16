//! What CVAT's XML has of pictures, read from its beginning to its end. The rest is passed over, and held by nobody.

use std::collections::BTreeMap;
use std::fmt::Display;

use evermap_schemas::Fault;
use quick_xml::Reader;
use quick_xml::escape::resolve_predefined_entity;
use quick_xml::events::{BytesRef, BytesStart, Event};

use crate::annotate::features::TOO_MANY_POINTS;
use crate::annotate::pixels::described::DescribedPicture;
use crate::annotate::pixels::outline::PixelOutline;
use crate::annotate::pixels::{NAME, NO_SHAPE, Rectangle, Shape, TURNED};
use crate::annotate::reading::not_more;

/// What is marked on a picture.
#[derive(Debug)]
pub(super) struct WrittenShape {
    /// What it is: `box`, `polygon` …
    pub(super) tag: Box<str>,
    pub(super) label: Option<String>,
    /// The name of a label, if it has one among its attributes.
    pub(super) name: Option<String>,
    /// The shape, turned as it says.
    ///
    /// # Errors
    /// In words, for what is none.
    pub(super) shape: Result<Shape, &'static str>,
}

/// The pictures, and what is marked on each.
///
/// # Errors
/// A user fault for what is no XML, no annotations of images, or too many of them.
pub(super) fn pictures(
    text: &str,
) -> Result<(Vec<DescribedPicture>, Vec<Vec<WrittenShape>>), Fault> {
    let mut reader = Reader::from_str(text);
    reader.config_mut().expand_empty_elements = true;
    let mut reading = Reading::default();
    loop {
        let event = reader.read_event().map_err(|error| {
            let before = text.bytes().zip(0..reader.error_position());
            let line = 1 + before.filter(|(byte, _)| *byte == b'\n').count();
            no_xml(format!("{error}, in line {line}"))
        })?;
        match event {
            Event::Start(element) => reading.begin(&element)?,
            Event::End(_) => reading.end(),
            Event::Text(text) if reading.is_name => reading.add(&text.decode().map_err(no_xml)?),
            Event::CData(text) if reading.is_name => reading.add(&text.decode().map_err(no_xml)?),
            Event::GeneralRef(one) if reading.is_name => reading.add(&meant(&one)?),
            Event::DocType(_) => return Err(no_xml("a document type, which may say anything")),
            Event::Eof => return reading.all(),
            _ => {}
        }
    }
}

fn no_xml(found: impl Display) -> Fault {
    Fault::user(format!("expected XML of CVAT, found {found}"))
}

/// What `&amp;` and its like stand for.
fn meant(reference: &BytesRef<'_>) -> Result<String, Fault> {
    if let Some(letter) = reference.resolve_char_ref().map_err(no_xml)? {
        return Ok(letter.into());
    }
    let name = reference.decode().map_err(no_xml)?;
    let text = resolve_predefined_entity(&name);
    let text = text.ok_or_else(|| no_xml(format!("&{name};, which stands for nothing")))?;
    Ok(text.to_owned())
}

/// How deep a picture is in the document, and what else is.
const ROOT: usize = 1;
const PICTURE: usize = 2;
const SHAPE: usize = 3;
const ATTRIBUTE: usize = 4;

#[derive(Default)]
struct Reading {
    /// Elements that are open.
    depth: usize,
    has_root: bool,
    /// Whether the element of the root that is open is a picture.
    is_picture: bool,
    /// Whether the element of a shape that is open has the name of a label.
    is_name: bool,
    shapes: usize,
    pictures: Vec<DescribedPicture>,
    marked: Vec<Vec<WrittenShape>>,
}

impl Reading {
    fn begin(&mut self, element: &BytesStart<'_>) -> Result<(), Fault> {
        self.depth += 1;
        match (self.depth, element.local_name().as_ref()) {
            (ROOT, b"annotations") => self.has_root = true,
            (ROOT, other) => {
                let other = String::from_utf8_lossy(other);
                return Err(Fault::user(format!(
                    "expected annotations of CVAT for images 1.1, found XML of <{other}>"
                )));
            }
            (PICTURE, b"track") => {
                return Err(Fault::user(
                    "expected annotations of CVAT for images 1.1, found tracks of CVAT for video 1.1",
                )
                .next("export from CVAT as `CVAT for images 1.1`"));
            }
            (PICTURE, tag) => {
                self.is_picture = tag == b"image";
                if self.is_picture {
                    self.add_picture(element)?;
                }
            }
            (SHAPE, tag) if self.is_picture => {
                let tag = String::from_utf8_lossy(tag).into();
                self.add_shape(tag, element)?;
            }
            (ATTRIBUTE, _) if self.is_picture => self.add_attribute(element)?,
            _ => {}
        }
        Ok(())
    }

    fn end(&mut self) {
        if self.is_name && self.depth == ATTRIBUTE {
            self.is_name = false;
            let name = self.shape().and_then(|shape| shape.name.as_mut());
            name.into_iter()
                .for_each(|name| *name = name.trim().to_owned());
        }
        self.depth = self.depth.saturating_sub(1);
    }

    fn add_picture(&mut self, element: &BytesStart<'_>) -> Result<(), Fault> {
        let mut said = attributes(element, &["id", "name", "width", "height"])?;
        let mut one = |name| said.remove(name);
        self.pictures.push(DescribedPicture {
            id: one("id"),
            name: one("name"),
            size: ["width", "height"].map(one),
        });
        self.marked.push(Vec::new());
        // No more is held than is believed.
        not_more(self.pictures.len(), "pictures")
    }

    fn add_shape(&mut self, tag: Box<str>, element: &BytesStart<'_>) -> Result<(), Fault> {
        self.shapes += 1;
        not_more(self.shapes, "annotations")?;
        let mut said = attributes(element, &OF_SHAPES)?;
        let label = said.remove("label");
        let shape = shape(&tag, &said);
        if let Some(marked) = self.marked.last_mut() {
            marked.push(WrittenShape {
                tag,
                label,
                name: None,
                shape,
            });
        }
        Ok(())
    }

    fn add_attribute(&mut self, element: &BytesStart<'_>) -> Result<(), Fault> {
        let said = attributes(element, &["name"])?;
        if said.get("name").map(String::as_str) == Some(NAME)
            && let Some(shape) = self.shape()
        {
            // The first one counts.
            let is_first = shape.name.is_none();
            shape.name.get_or_insert_default();
            self.is_name = is_first;
        }
        Ok(())
    }

    /// More of a label's name.
    fn add(&mut self, text: &str) {
        if let (ATTRIBUTE, Some(shape)) = (self.depth, self.shape()) {
            shape.name.get_or_insert_default().push_str(text);
        }
    }

    fn shape(&mut self) -> Option<&mut WrittenShape> {
        self.marked.last_mut()?.last_mut()
    }

    fn all(self) -> Result<(Vec<DescribedPicture>, Vec<Vec<WrittenShape>>), Fault> {
        if self.depth > 0 || !self.has_root {
            return Err(no_xml("its end before that of <annotations>"));
        }
        Ok((self.pictures, self.marked))
    }
}

/// What shapes are written with.
const OF_SHAPES: [&str; 15] = [
    "label", "rotation", "points", "xtl", "ytl", "xbr", "ybr", "cx", "cy", "rx", "ry", "left",
    "top", "width", "height",
];

/// Attributes of an element of these names.
///
/// # Errors
/// A user fault for what is no XML.
fn attributes(
    element: &BytesStart<'_>,
    names: &[&'static str],
) -> Result<BTreeMap<&'static str, String>, Fault> {
    let mut said = BTreeMap::new();
    // That a name is there once would be asked of each with all others.
    for attribute in element.attributes().with_checks(false) {
        let attribute = attribute.map_err(no_xml)?;
        let name = attribute.key.local_name();
        if let Some(name) = names.iter().find(|one| one.as_bytes() == name.as_ref()) {
            let value = attribute.unescape_value().map_err(no_xml)?;
            said.insert(*name, value.into_owned());
        }
    }
    Ok(said)
}

/// A shape, turned as it says.
///
/// # Errors
/// In words, for what is none.
fn shape(tag: &str, said: &BTreeMap<&str, String>) -> Result<Shape, &'static str> {
    let degrees = match said.get("rotation") {
        None => 0.0,
        Some(degrees) => degrees.parse().map_err(|_| TURNED)?,
    };
    let points = || outline(said.get("points").map_or("", String::as_str));
    match tag {
        "polygon" => points(),
        "polyline" => match points()? {
            Shape::Closed(points) => Ok(Shape::Open(points)),
            _ => Err(TOO_MANY_POINTS),
        },
        _ => sides(tag, said, degrees).ok_or(NO_SHAPE),
    }
}

/// The box that an element is, or that is around it.
fn sides(tag: &str, said: &BTreeMap<&str, String>, degrees: f64) -> Option<Shape> {
    let number = |name: &str| said.get(name)?.parse::<f64>().ok();
    let (corner, size) = match tag {
        "box" => {
            let [left, top] = [number("xtl")?, number("ytl")?];
            ([left, top], [number("xbr")? - left, number("ybr")? - top])
        }
        "ellipse" => {
            let [across, down] = [number("rx")?, number("ry")?];
            let corner = [number("cx")? - across, number("cy")? - down];
            (corner, [2.0 * across, 2.0 * down])
        }
        "mask" => {
            let size = [number("width")?, number("height")?];
            ([number("left")?, number("top")?], size)
        }
        _ => return None,
    };
    Some(Shape::Box(Rectangle::about_middle(corner, size, degrees)))
}

/// `x,y;x,y`.
///
/// # Errors
/// In words, for what is no outline.
fn outline(points: &str) -> Result<Shape, &'static str> {
    let mut outline = PixelOutline::default();
    for point in points.split(';') {
        let (x, y) = point.split_once(',').ok_or(NO_SHAPE)?;
        let number = |text: &str| text.trim().parse::<f64>().map_err(|_| NO_SHAPE);
        outline.add([number(x)?, number(y)?]);
    }
    outline.shape()
}
