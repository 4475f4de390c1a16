//! What people are shown of an image: all of it as PNG; of one that they are asked about the part around a rectangle, with the
//! rectangle drawn.

use evermap_catalog::{Rgb, decode_colour, image_size};
use evermap_schemas::Fault;
use png::ColorType;

use crate::draw::encoded;

/// The longer side of what is shown, px: of a larger part every second pixel is left out, or more.
const MOST_PX: usize = 1024;
/// What is shown on each side of a rectangle: as much of its longer side, but no fewer pixels.
const MARGIN: f64 = 0.5;
const LEAST_MARGIN_PX: f64 = 16.0;
/// Bytes that a pixel takes: four values of 16 bits while it is decoded, three of eight then, and as many encoded.
const PIXEL_BYTES: usize = 14;
/// Vermilion, as the page draws what is asked about.
const COLOUR: [u8; 3] = [0xD5, 0x5E, 0x00];

/// The media type of what is shown.
pub const PNG: &str = "image/png";

/// The media type of an image that browsers and other programs show as it is; `None` for others.
pub fn kind_of(image: &[u8]) -> Option<&'static str> {
    match image.get(..4)? {
        [0xFF, 0xD8, ..] => Some("image/jpeg"),
        b"\x89PNG" => Some(PNG),
        _ => None,
    }
}

/// A rectangle of an image: least column and row, largest column and row, px; (0, 0) is the centre of the first pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rectangle([f64; 4]);

impl Rectangle {
    /// Of four numbers in this order; `None` where they are no rectangle.
    pub fn new(sides: [f64; 4]) -> Option<Self> {
        let [left, top, right, bottom] = sides;
        let is_finite = sides.iter().all(|side| side.is_finite());
        (is_finite && left <= right && top <= bottom).then_some(Self(sides))
    }

    /// Of a text with commas between the four numbers.
    ///
    /// # Errors
    /// A user fault for any other text.
    pub fn parse(text: &str) -> Result<Self, Fault> {
        let sides: Option<Vec<f64>> = text.split(',').map(|side| side.parse().ok()).collect();
        let sides = sides.and_then(|sides| <[f64; 4]>::try_from(sides).ok());
        sides.and_then(Self::new).ok_or_else(|| {
            Fault::user(format!(
                "expected a rectangle as least column, least row, largest column, largest row, found {text:?}"
            ))
        })
    }

    /// The columns and rows to show of an image, from the first to the one behind the last; `None` where none are.
    fn shown(&self, size: [usize; 2]) -> Option<[(usize, usize); 2]> {
        let Self([left, top, right, bottom]) = *self;
        let margin = (MARGIN * (right - left).max(bottom - top)).max(LEAST_MARGIN_PX);
        // Numbers that no pixel has become the nearest that one has.
        let range = |least: f64, most: f64, size: usize| {
            let first = (least - margin).floor().max(0.0) as usize;
            let end = ((most + margin).ceil().max(-1.0) + 1.0) as usize;
            let range = (first, end.min(size));
            (range.0 < range.1).then_some(range)
        };
        Some([range(left, right, size[0])?, range(top, bottom, size[1])?])
    }
}

/// Bytes of memory that it takes to show an image, by what its header claims.
///
/// # Errors
/// A data fault for bytes that are no image, or too large a one.
pub fn memory(image: &[u8]) -> Result<usize, Fault> {
    let [width, height] = image_size(image).map_err(|error| Fault::data(error.to_string()))?;
    Ok(PIXEL_BYTES * width as usize * height as usize)
}

/// An image as a PNG of eight bits.
///
/// # Errors
/// A data fault for an image that does not decode.
pub fn whole(image: &[u8]) -> Result<Vec<u8>, Fault> {
    let rgb = decoded(image)?;
    encoded(rgb.width, rgb.height, ColorType::Rgb, &rgb.data)
}

fn decoded(image: &[u8]) -> Result<Rgb, Fault> {
    let mut rgb = Rgb::default();
    decode_colour(image, &mut rgb).map_err(|error| Fault::data(error.to_string()))?;
    Ok(rgb)
}

/// The part of an image around a rectangle, which is drawn: a PNG.
///
/// # Errors
/// A data fault for an image that does not decode, a user fault for a rectangle outside of it.
pub fn part(image: &[u8], around: Rectangle) -> Result<Vec<u8>, Fault> {
    let rgb = decoded(image)?;
    let size = [rgb.width as usize, rgb.height as usize];
    let [columns, rows] = around.shown(size).ok_or_else(|| {
        let [width, height] = size;
        let sides = around.0;
        Fault::user(format!(
            "expected a rectangle in an image of {width} × {height} px, found {sides:?}"
        ))
    })?;
    let step = (columns.1 - columns.0)
        .max(rows.1 - rows.0)
        .div_ceil(MOST_PX);
    let frame = Border::new(around, [columns.0, rows.0], step);
    let shown = |(first, end): (usize, usize)| (first..end).step_by(step);
    let (pixels, _) = rgb.data.as_chunks::<3>();
    let mut part = Vec::new();
    for (y, row) in shown(rows).enumerate() {
        for (x, column) in shown(columns).enumerate() {
            let seen = pixels.get(row * size[0] + column).copied();
            let drawn = frame.covers([x, y]).then_some(COLOUR);
            part.extend(drawn.or(seen).unwrap_or_default());
        }
    }
    let [width, height] = [columns, rows].map(|range| shown(range).count() as u32);
    encoded(width, height, ColorType::Rgb, &part)
}

/// The line around a rectangle in what is shown, two pixels wide: it hides nothing of what the rectangle has.
struct Border {
    /// Columns and rows of the line's middle.
    first: [f64; 2],
    last: [f64; 2],
}

impl Border {
    fn new(
        Rectangle([left, top, right, bottom]): Rectangle,
        first: [usize; 2],
        step: usize,
    ) -> Self {
        let shown = |at: f64, first: usize| (at - first as f64) / step as f64;
        Self {
            first: [
                shown(left, first[0]).floor() - 1.0,
                shown(top, first[1]).floor() - 1.0,
            ],
            last: [
                shown(right, first[0]).ceil() + 1.0,
                shown(bottom, first[1]).ceil() + 1.0,
            ],
        }
    }

    fn covers(&self, pixel: [usize; 2]) -> bool {
        let within = |by: f64| {
            (0..2).all(|axis| {
                let at = pixel[axis] as f64;
                self.first[axis] - by <= at && at <= self.last[axis] + by
            })
        };
        within(1.0) && !within(-1.0)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// A grey image of this size.
    fn image(width: usize, height: usize) -> Vec<u8> {
        let mut file = format!("P6\n{width} {height}\n255\n").into_bytes();
        file.extend(vec![100; 3 * width * height]);
        file
    }

    fn part_of(width: usize, height: usize, around: [f64; 4]) -> Rgb {
        decoded(&part(&image(width, height), Rectangle::new(around).unwrap()).unwrap()).unwrap()
    }

    fn at(part: &Rgb, [x, y]: [usize; 2]) -> [u8; 3] {
        let first = 3 * (y * part.width as usize + x);
        part.data[first..first + 3].try_into().unwrap()
    }

    #[test]
    fn what_is_asked_about_is_shown_with_what_is_around_it_and_a_line() {
        // 16 px on each side of 20 by 10.
        let part = part_of(100, 80, [40.0, 30.0, 60.0, 40.0]);
        assert_eq!([part.width, part.height], [53, 43]);
        let grey = [100; 3];
        // Of the rectangle itself nothing is hidden.
        for x in 16..=36 {
            assert_eq!([at(&part, [x, 16]), at(&part, [x, 26])], [grey; 2], "{x}");
        }
        for by in [1, 2] {
            assert_eq!(at(&part, [16 - by, 20]), COLOUR);
            assert_eq!(at(&part, [36 + by, 20]), COLOUR);
            assert_eq!(at(&part, [20, 16 - by]), COLOUR);
            assert_eq!(at(&part, [20, 26 + by]), COLOUR);
        }
        assert_eq!([at(&part, [13, 20]), at(&part, [39, 20])], [grey; 2]);
    }

    #[test]
    fn what_is_shown_ends_with_the_image_and_is_no_larger_than_a_screen() {
        let corner = part_of(100, 80, [-30.0, -30.0, 4.0, 4.0]);
        assert_eq!([corner.width, corner.height], [22, 22]);
        let large = part_of(3000, 1500, [0.0, 0.0, 2999.0, 1499.0]);
        assert_eq!([large.width, large.height], [1000, 500]);
        let huge = part_of(100, 80, [-1e300, 0.0, 1e300, 1.0]);
        assert_eq!([huge.width, huge.height], [100, 80]);
    }

    #[test]
    fn what_is_no_rectangle_of_the_image_is_refused() {
        for text in [
            "",
            "1,2,3",
            "1,2,3,4,5",
            "3,2,1,4",
            "1,4,3,2",
            "1,2,inf,4",
            "1,2,NaN,4",
            "a,b,c,d",
        ] {
            let said = Rectangle::parse(text).unwrap_err().to_string();
            assert!(said.contains("expected a rectangle as"), "{text}: {said}");
        }
        let file = image(100, 80);
        for text in [
            "200,10,210,20",
            "-60,10,-50,20",
            "10,200,20,210",
            "1e308,1,1e308,2",
        ] {
            let said = part(&file, Rectangle::parse(text).unwrap())
                .unwrap_err()
                .to_string();
            assert!(
                said.contains("in an image of 100 × 80 px"),
                "{text}: {said}"
            );
        }
    }

    #[test]
    fn a_whole_image_is_the_same_as_png() {
        let file = image(7, 5);
        let png = whole(&file).unwrap();
        assert_eq!(png.get(..4), Some(&b"\x89PNG"[..]));
        assert_eq!(decoded(&png).unwrap(), decoded(&file).unwrap());
    }

    #[test]
    fn the_memory_of_an_image_is_told_before_it_is_decoded() {
        assert_eq!(memory(&image(100, 80)).unwrap(), 14 * 8000);
        assert!(memory(b"P6\n1000000 1000000\n255\n").is_err());
        assert!(memory(b"no image").is_err());
    }
}
