//! The boxes around what is drawn on several pictures.

use std::collections::BTreeSet;
use std::path::Path;

use evermap_schemas::Fault;

use super::{Canvas, DrawnShape, PictureAnnotations, Pixel, Program};
use crate::annotate::Losses;

/// Boxes on several pictures.
#[derive(Debug)]
pub(in crate::annotate) struct Boxes {
    pub(in crate::annotate) boxes: Vec<PictureBox>,
    /// The pictures that somebody looked at, also where no box is on them.
    pub(in crate::annotate) seen: BTreeSet<usize>,
    /// Those with a shape that could not be read: there may be more on them than these boxes.
    pub(in crate::annotate) unread: BTreeSet<usize>,
}

/// The box around what is drawn on one of several pictures.
#[derive(Debug)]
pub(in crate::annotate) struct PictureBox {
    /// Which one, for people.
    pub(in crate::annotate) place: String,
    /// What it marks, where it says so.
    pub(in crate::annotate) kind: Option<String>,
    /// The number of its picture.
    pub(in crate::annotate) picture: usize,
    /// Least and largest column and row.
    pub(in crate::annotate) bounds: [Pixel; 2],
}

impl Program {
    /// The boxes around what is drawn on several pictures, and which of these somebody looked at; what makes no sense is noted
    /// and left out.
    ///
    /// # Errors
    /// As [`Program::read`], and for YOLO's boxes, which do not name their picture.
    pub(in crate::annotate) fn boxes(
        self,
        path: &Path,
        text: &str,
        canvases: &[Canvas],
        losses: &mut Losses,
    ) -> Result<Boxes, Fault> {
        if self == Self::YoloObb {
            return Err(Fault::user(
                "expected COCO, CVAT or Label Studio, found YOLO's boxes, which do not name their image",
            ));
        }
        let PictureAnnotations {
            drawn,
            seen,
            mut unread,
        } = self.said(path, text, canvases, losses)?;
        let mut boxes = Vec::with_capacity(drawn.len());
        for drawn in drawn {
            if is_somewhere(&drawn) {
                boxes.push(PictureBox {
                    bounds: drawn.shape.bounds(),
                    place: drawn.place,
                    kind: drawn.kind,
                    picture: drawn.picture,
                });
            } else {
                losses.note("annotation without a place of finite pixels", &drawn.place);
                unread.insert(drawn.picture);
            }
        }
        Ok(Boxes {
            boxes,
            seen,
            unread,
        })
    }
}

/// Whether there are points, all of them finite.
fn is_somewhere(drawn: &DrawnShape) -> bool {
    let points = drawn.shape.points();
    !points.is_empty() && points.iter().flatten().all(|value| value.is_finite())
}
