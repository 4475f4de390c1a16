//! CVAT for images 1.1.

mod written;

use std::collections::BTreeSet;
use std::fmt::Write;

use evermap_schemas::Fault;
use quick_xml::escape::escape;

use self::written::pictures;
use super::described::{Canvas, OF_ANOTHER, which_are};
use super::{DrawnShape, NAME, PictureAnnotations, Pixel, Rectangle, Shape};
use crate::annotate::Losses;
use crate::annotate::mosaic::Picture;

/// The shapes on pictures: boxes, turned clockwise about their middle, polygons and polylines, and the boxes around ellipses and
/// masks.
///
/// # Errors
/// A user fault for what is no XML, no annotations of images, those of other pictures alone, or too many of them.
pub(super) fn read(
    text: &str,
    canvases: &[Canvas],
    losses: &mut Losses,
) -> Result<PictureAnnotations, Fault> {
    let (described, marked) = pictures(text)?;
    let chosen = which_are(canvases, &described, losses)?;
    let mut said = PictureAnnotations {
        drawn: Vec::new(),
        seen: chosen.iter().flatten().copied().collect(),
        unread: BTreeSet::new(),
    };
    for (shapes, at) in marked.into_iter().zip(chosen) {
        for (number, written) in shapes.into_iter().enumerate() {
            let place = format!("{} {number}", written.tag);
            let Some(at) = at else {
                losses.note(OF_ANOTHER, &place);
                continue;
            };
            match written.shape {
                Ok(shape) => {
                    if ["ellipse", "mask"].contains(&&*written.tag) {
                        losses.note(BOX_OF, &place);
                    }
                    let drawn = DrawnShape::said(place, written.label, shape);
                    said.drawn.push(drawn.called(written.name).on(at));
                }
                Err(reason) => {
                    losses.note(reason, &place);
                    // A tag is of the whole picture.
                    said.unread.extend((&*written.tag != "tag").then_some(at));
                }
            }
        }
    }
    Ok(said)
}

/// What is told of a shape whose outline is not taken.
const BOX_OF: &str = "ellipse or mask taken as the box around it";

/// One picture with its shapes.
pub(super) fn write(drawn: &[DrawnShape], picture: &Picture) -> String {
    let [width, height] = picture.size;
    let mut text = String::from(
        "<?xml version=\"1.0\" encoding=\"utf-8\"?>\n<annotations>\n  <version>1.1</version>\n",
    );
    let name = escape(&picture.name);
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
        let kind = escape(drawn.kind.as_deref().unwrap_or_default());
        let name = escape(drawn.name.as_deref().unwrap_or_default());
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
