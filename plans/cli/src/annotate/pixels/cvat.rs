//! CVAT for images 1.1.

use std::collections::BTreeSet;
use std::fmt::Write;

use evermap_schemas::Fault;
use roxmltree::{Document, Node};

use super::described::{Canvas, DescribedPicture, OF_ANOTHER, which_are};
use super::{DrawnShape, NAME, PictureAnnotations, Pixel, Rectangle, Shape, TURNED};
use crate::annotate::Losses;
use crate::annotate::mosaic::Picture;

/// The shapes on pictures: boxes, turned clockwise about their middle, polygons and polylines, and the boxes around ellipses and
/// masks.
///
/// # Errors
/// A user fault for what is no XML, no annotations of images, or those of other pictures alone.
pub(super) fn read(
    text: &str,
    canvases: &[Canvas],
    losses: &mut Losses,
) -> Result<PictureAnnotations, Fault> {
    let document = Document::parse(text)
        .map_err(|error| Fault::user(format!("expected XML of CVAT, found {error}")))?;
    let root = document.root_element();
    if !root.has_tag_name("annotations") {
        let found = root.tag_name().name();
        return Err(Fault::user(format!(
            "expected annotations of CVAT for images 1.1, found XML of <{found}>"
        )));
    }
    if root.children().any(|node| node.has_tag_name("track")) {
        return Err(Fault::user(
            "expected annotations of CVAT for images 1.1, found tracks of CVAT for video 1.1",
        )
        .next("export from CVAT as `CVAT for images 1.1`"));
    }
    let pictures = root.children().filter(|node| node.has_tag_name("image"));
    let pictures: Vec<Node<'_, '_>> = pictures.collect();
    let described: Vec<DescribedPicture> = pictures.iter().map(described).collect();
    let chosen = which_are(canvases, &described, losses)?;
    let mut said = PictureAnnotations {
        drawn: Vec::new(),
        seen: chosen.iter().flatten().copied().collect(),
        unread: BTreeSet::new(),
    };
    for (picture, at) in pictures.iter().zip(chosen) {
        let shapes = picture.children().filter(Node::is_element);
        for (number, node) in shapes.enumerate() {
            let place = format!("{} {number}", node.tag_name().name());
            let Some(at) = at else {
                losses.note(OF_ANOTHER, &place);
                continue;
            };
            match shape(node) {
                Ok(shape) => {
                    if is_coarse(node) {
                        losses.note(BOX_OF, &place);
                    }
                    let kind = node.attribute("label").map(str::to_owned);
                    let drawn = DrawnShape::said(place, kind, shape);
                    said.drawn.push(drawn.called(name(node)).on(at));
                }
                Err(reason) => {
                    losses.note(reason, &place);
                    // A tag is of the whole picture.
                    said.unread
                        .extend((!node.has_tag_name("tag")).then_some(at));
                }
            }
        }
    }
    Ok(said)
}

/// Why a shape is left out.
const NO_SHAPE: &str = "annotation that is neither box nor outline nor line";
/// What is told of a shape whose outline is not taken.
const BOX_OF: &str = "ellipse or mask taken as the box around it";

fn is_coarse(shape: Node<'_, '_>) -> bool {
    ["ellipse", "mask"].contains(&shape.tag_name().name())
}

/// The name of a label, if a shape has one among its attributes.
fn name(shape: Node<'_, '_>) -> Option<String> {
    let mut attributes = shape.children();
    let found = attributes.find(|node| node.attribute("name") == Some(NAME))?;
    Some(found.text()?.trim().to_owned())
}

fn described(picture: &Node<'_, '_>) -> DescribedPicture {
    let attribute = |name: &str| picture.attribute(name).map(str::to_owned);
    DescribedPicture {
        id: attribute("id"),
        name: attribute("name"),
        size: ["width", "height"].map(attribute),
    }
}

/// A shape, turned as it says.
///
/// # Errors
/// In words, for what is none.
fn shape(node: Node<'_, '_>) -> Result<Shape, &'static str> {
    let degrees = match node.attribute("rotation") {
        None => 0.0,
        Some(degrees) => degrees.parse().map_err(|_| TURNED)?,
    };
    turned(node, degrees).ok_or(NO_SHAPE)
}

fn turned(node: Node<'_, '_>, degrees: f64) -> Option<Shape> {
    let number = |name: &str| node.attribute(name)?.parse::<f64>().ok();
    let turned =
        |corner: Pixel, size: [f64; 2]| Shape::Box(Rectangle::about_middle(corner, size, degrees));
    match node.tag_name().name() {
        "box" => {
            let [left, top] = [number("xtl")?, number("ytl")?];
            let size = [number("xbr")? - left, number("ybr")? - top];
            Some(turned([left, top], size))
        }
        "ellipse" => {
            let [x, y] = [number("cx")?, number("cy")?];
            let [across, down] = [number("rx")?, number("ry")?];
            Some(turned([x - across, y - down], [2.0 * across, 2.0 * down]))
        }
        "mask" => {
            let corner = [number("left")?, number("top")?];
            Some(turned(corner, [number("width")?, number("height")?]))
        }
        "polygon" => points(node).map(Shape::Closed),
        "polyline" => points(node).map(Shape::Open),
        _ => None,
    }
}

/// `x,y;x,y`.
fn points(node: Node<'_, '_>) -> Option<Vec<Pixel>> {
    let pixel = |text: &str| {
        let (x, y) = text.split_once(',')?;
        Some([x.trim().parse().ok()?, y.trim().parse().ok()?])
    };
    node.attribute("points")?.split(';').map(pixel).collect()
}

/// One picture with its shapes.
pub(super) fn write(drawn: &[DrawnShape], picture: &Picture) -> String {
    let [width, height] = picture.size;
    let mut text = String::from(
        "<?xml version=\"1.0\" encoding=\"utf-8\"?>\n<annotations>\n  <version>1.1</version>\n",
    );
    let name = escaped(&picture.name);
    // Writing to a text does not fail.
    let _ = writeln!(
        text,
        "  <image id=\"0\" name=\"{name}\" width=\"{width}\" height=\"{height}\">"
    );
    for drawn in drawn {
        let (tag, place) = match &drawn.shape {
            Shape::Box(found) => ("box", placed(found)),
            Shape::Closed(points) => ("polygon", listed(points)),
            Shape::Around(corners) => ("polygon", listed(corners)),
            Shape::Open(points) => ("polyline", listed(points)),
        };
        let kind = escaped(drawn.kind.as_deref().unwrap_or_default());
        let name = escaped(drawn.name.as_deref().unwrap_or_default());
        let _ = writeln!(
            text,
            "    <{tag} label=\"{kind}\" source=\"manual\" occluded=\"0\" {place} z_order=\"0\"><attribute name=\"{NAME}\">{name}</attribute></{tag}>"
        );
    }
    text.push_str("  </image>\n</annotations>\n");
    text
}

fn placed(found: &Rectangle) -> String {
    let ([left, top], [along, across]) = (found.turned_back(), found.size);
    let (right, bottom, turn) = (left + along, top + across, found.degrees.rem_euclid(360.0));
    format!("xtl=\"{left}\" ytl=\"{top}\" xbr=\"{right}\" ybr=\"{bottom}\" rotation=\"{turn}\"")
}

fn listed(points: &[Pixel]) -> String {
    let points = points.iter().map(|[x, y]| format!("{x},{y}"));
    format!("points=\"{}\"", points.collect::<Vec<_>>().join(";"))
}

fn escaped(text: &str) -> String {
    let escaped = text.replace('&', "&amp;").replace('<', "&lt;");
    escaped.replace('>', "&gt;").replace('"', "&quot;")
}
