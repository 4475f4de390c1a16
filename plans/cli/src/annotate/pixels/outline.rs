//! Numbers of JSON as the places in a picture that they are.

use serde::de::SeqAccess;

use super::{NO_SHAPE, Pixel, Shape};
use crate::annotate::features::TOO_MANY_POINTS;
use crate::annotate::reading::{AnyJson, Lenient, Member, OutlinePoints};

/// A list of so many numbers, and nothing else.
#[derive(Debug)]
pub(super) struct Numbers<const N: usize> {
    first: [f64; N],
    count: usize,
    has_others: bool,
}

impl<const N: usize> Default for Numbers<N> {
    fn default() -> Self {
        Self {
            first: [0.0; N],
            count: 0,
            has_others: false,
        }
    }
}

impl<const N: usize> Lenient for Numbers<N> {
    fn element<'de, A: SeqAccess<'de>>(&mut self, list: &mut A) -> Result<Option<()>, A::Error> {
        let Some(AnyJson(element)) = list.next_element::<AnyJson<Member>>()? else {
            return Ok(None);
        };
        match (element.number(), self.first.get_mut(self.count)) {
            (Some(number), Some(place)) => *place = number,
            _ => self.has_others = true,
        }
        self.count += 1;
        Ok(Some(()))
    }
}

impl<const N: usize> Numbers<N> {
    pub(super) fn all(&self) -> Option<[f64; N]> {
        (self.count == N && !self.has_others).then_some(self.first)
    }
}

/// An outline in a picture, of as many corners as a label may have; of more, the box around them.
#[derive(Debug)]
pub(super) struct PixelOutline {
    corners: OutlinePoints<Pixel>,
    /// Least and largest column and row.
    bounds: [Pixel; 2],
}

impl Default for PixelOutline {
    fn default() -> Self {
        Self {
            corners: OutlinePoints::default(),
            bounds: [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]],
        }
    }
}

impl PixelOutline {
    pub(super) fn add(&mut self, corner: Pixel) {
        let [least, largest] = &mut self.bounds;
        for (axis, value) in corner.into_iter().enumerate() {
            least[axis] = least[axis].min(value);
            largest[axis] = largest[axis].max(value);
        }
        self.corners.add(corner);
    }

    /// Something in it is no corner.
    pub(super) fn end(&mut self) {
        self.corners.end(NO_SHAPE);
    }

    /// # Errors
    /// In words, for what is none.
    pub(super) fn shape(self) -> Result<Shape, &'static str> {
        let [[left, top], [right, bottom]] = self.bounds;
        match self.corners.all() {
            Err(TOO_MANY_POINTS) => Ok(Shape::Around([
                [left, top],
                [right, top],
                [right, bottom],
                [left, bottom],
            ])),
            corners => corners.map(Shape::Closed),
        }
    }
}
