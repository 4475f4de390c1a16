//! Paint on images: which pixels a polygon, or a line that a round brush follows, covers.
//!
//! Places are columns and rows in pixels from the upper left corner of the image, so that the first pixel's middle is at
//! (0.5, 0.5). A pixel is covered where its middle is.

use thiserror::Error;

use super::shapes::{MOST_POINTS, crossing};

/// The widest brush, px: what a stroke costs is bounded by it.
pub const MOST_BRUSH_PX: f64 = 256.0;

type Point = [f64; 2];

/// What is painted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Paint<'a> {
    /// All that lies within these corners.
    Polygon(&'a [Point]),
    /// All that a round brush covers on its way along a line.
    Stroke {
        /// Points of the line.
        line: &'a [Point],
        /// Diameter of the brush.
        brush_px: f64,
    },
}

/// Why something cannot be painted on an image.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum PaintError {
    /// A polygon of fewer than three corners, a line without a point, or more points than there may be.
    #[error("expected {least} to {MOST_POINTS} points, found {found}")]
    Points {
        /// Points that it needs.
        least: usize,
        /// Points that it has.
        found: usize,
    },
    /// A point that is not on the image.
    #[error("expected points within the image, {width} x {height} px, found ({x}, {y})")]
    Outside {
        /// Width of the image.
        width: usize,
        /// Height of the image.
        height: usize,
        /// The first such point.
        x: f64,
        /// The first such point.
        y: f64,
    },
    /// A polygon whose edges meet.
    #[error("expected an outline that does not cross itself, found that it does at ({x}, {y})")]
    Crossing {
        /// Where.
        x: f64,
        /// Where.
        y: f64,
    },
    /// A brush that is too small or too large.
    #[error("expected a brush of 1 to {MOST_BRUSH_PX} px, found {0}")]
    Brush(f64),
}

impl Paint<'_> {
    /// Whether it can be painted on an image of this width and height.
    ///
    /// # Errors
    /// [`PaintError`], where it cannot.
    pub fn check(&self, [width, height]: [usize; 2]) -> Result<(), PaintError> {
        let (points, least) = match self {
            Self::Polygon(corners) => (*corners, 3),
            Self::Stroke { line, .. } => (*line, 1),
        };
        let found = points.len();
        if !(least..=MOST_POINTS).contains(&found) {
            return Err(PaintError::Points { least, found });
        }
        let within =
            |[x, y]: &Point| (0.0..=width as f64).contains(x) && (0.0..=height as f64).contains(y);
        if let Some([x, y]) = points.iter().find(|point| !within(point)).copied() {
            return Err(PaintError::Outside {
                width,
                height,
                x,
                y,
            });
        }
        match self {
            Self::Polygon(corners) => {
                let flat: Vec<[f64; 3]> = corners.iter().map(|[x, y]| [*x, *y, 0.0]).collect();
                let found = crossing(&flat);
                found.map_or(Ok(()), |[x, y]| Err(PaintError::Crossing { x, y }))
            }
            Self::Stroke { brush_px, .. } => match (1.0..=MOST_BRUSH_PX).contains(brush_px) {
                true => Ok(()),
                false => Err(PaintError::Brush(*brush_px)),
            },
        }
    }

    /// Gives the pixels that it covers a value. `pixels` is row by row, of this width.
    pub fn lay(&self, pixels: &mut [u8], width: usize, value: u8) {
        match self {
            Self::Polygon(corners) => fill(pixels, width, value, corners),
            Self::Stroke { line, brush_px } => {
                let radius = brush_px / 2.0;
                for point in *line {
                    disc(pixels, width, value, *point, radius);
                }
                for ends in line.windows(2) {
                    fill(pixels, width, value, &band(ends[0], ends[1], radius));
                }
            }
        }
    }
}

/// The rectangle along a line that a brush covers between its ends.
fn band(a: Point, b: Point, radius: f64) -> [Point; 4] {
    let (x, y) = (b[0] - a[0], b[1] - a[1]);
    let length = x.hypot(y).max(f64::MIN_POSITIVE);
    let (x, y) = (-y / length * radius, x / length * radius);
    [
        [a[0] + x, a[1] + y],
        [b[0] + x, b[1] + y],
        [b[0] - x, b[1] - y],
        [a[0] - x, a[1] - y],
    ]
}

fn disc(pixels: &mut [u8], width: usize, value: u8, [x, y]: Point, radius: f64) {
    let height = pixels.len() / width.max(1);
    for row in middles(y - radius, y + radius, height) {
        let away = row as f64 + 0.5 - y;
        let half = (radius * radius - away * away).max(0.0).sqrt();
        span(pixels, width, value, row, [x - half, x + half]);
    }
}

fn fill(pixels: &mut [u8], width: usize, value: u8, corners: &[Point]) {
    let height = pixels.len() / width.max(1);
    let top = corners.iter().map(|at| at[1]).fold(f64::MAX, f64::min);
    let bottom = corners.iter().map(|at| at[1]).fold(f64::MIN, f64::max);
    let mut met = Vec::new();
    for row in middles(top, bottom, height) {
        let y = row as f64 + 0.5;
        met.clear();
        let next = corners.iter().cycle().skip(1);
        for (a, b) in corners.iter().zip(next) {
            if (a[1] <= y) != (b[1] <= y) {
                met.push(a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]));
            }
        }
        met.sort_by(f64::total_cmp);
        for [from, to] in met.as_chunks::<2>().0 {
            span(pixels, width, value, row, [*from, *to]);
        }
    }
}

fn span(pixels: &mut [u8], width: usize, value: u8, row: usize, [from, to]: [f64; 2]) {
    let columns = middles(from, to, width);
    let begin = row * width;
    if let Some(found) = pixels.get_mut(begin + columns.start..begin + columns.end) {
        found.fill(value);
    }
}

/// The pixels of a row of so many whose middles lie from one place on, and before another.
fn middles(from: f64, to: f64, count: usize) -> std::ops::Range<usize> {
    let first = |place: f64| (place - 0.5).ceil().clamp(0.0, count as f64) as usize;
    let (from, to) = (first(from), first(to));
    from..to.max(from)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// What is painted on an image of this size, row by row.
    fn painted(paint: &Paint<'_>, [width, height]: [usize; 2]) -> Vec<String> {
        let mut pixels = vec![b'.'; width * height];
        paint.lay(&mut pixels, width, b'#');
        let rows = pixels.chunks(width);
        rows.map(|row| String::from_utf8_lossy(row).into_owned())
            .collect()
    }

    #[test]
    fn a_polygon_covers_the_pixels_whose_middles_it_holds() {
        let hook = [
            [1.0, 1.0],
            [5.0, 1.0],
            [5.0, 4.0],
            [4.0, 4.0],
            [4.0, 2.0],
            [1.4, 2.0],
        ];
        let rows = painted(&Paint::Polygon(&hook), [6, 5]);
        assert_eq!(rows, ["......", ".####.", "....#.", "....#.", "......"]);
        let reversed: Vec<Point> = hook.iter().rev().copied().collect();
        assert_eq!(painted(&Paint::Polygon(&reversed), [6, 5]), rows);
        let sliver = [[0.6, 0.0], [1.4, 0.0], [1.4, 3.0], [0.6, 3.0]];
        assert_eq!(painted(&Paint::Polygon(&sliver), [3, 2]), ["...", "..."]);
    }

    #[test]
    fn polygons_side_by_side_share_no_pixel_and_leave_none() {
        let [a, b, c, d] = [[0.0, 0.0], [7.0, 0.0], [7.0, 5.0], [0.0, 5.0]];
        let middle = [3.5, 2.5];
        let mut counts = vec![0; 35];
        for part in [
            [a, b, middle],
            [b, c, middle],
            [c, d, middle],
            [d, a, middle],
        ] {
            let mut pixels = vec![0; 35];
            Paint::Polygon(&part).lay(&mut pixels, 7, 1);
            counts
                .iter_mut()
                .zip(pixels)
                .for_each(|(sum, one)| *sum += one);
        }
        assert_eq!(counts, vec![1; 35]);
    }

    #[test]
    fn a_stroke_covers_what_its_brush_does() {
        let stroke = |line, brush_px| Paint::Stroke { line, brush_px };
        let dot = painted(&stroke(&[[2.5, 2.5]], 3.2), [5, 5]);
        assert_eq!(dot, [".....", ".###.", ".###.", ".###.", "....."]);
        let line = painted(&stroke(&[[0.5, 0.5], [5.5, 0.5], [5.5, 3.5]], 1.2), [7, 4]);
        assert_eq!(line, ["######.", ".....#.", ".....#.", ".....#."]);
        // Beyond the edge there is nothing.
        let edge = painted(&stroke(&[[0.0, 0.0], [0.0, 3.0]], 4.0), [4, 3]);
        assert_eq!(edge, ["##..", "##..", "##.."]);
    }

    #[test]
    fn later_paint_lies_over_earlier() {
        let mut pixels = vec![255; 9];
        Paint::Polygon(&[[0.0, 0.0], [3.0, 0.0], [3.0, 3.0], [0.0, 3.0]]).lay(&mut pixels, 3, 0);
        let line = [[1.5, 0.5], [1.5, 2.5]];
        let stroke = Paint::Stroke {
            line: &line,
            brush_px: 1.2,
        };
        stroke.lay(&mut pixels, 3, 1);
        assert_eq!(pixels, [0, 1, 0, 0, 1, 0, 0, 1, 0]);
    }

    #[test]
    fn what_cannot_be_painted_is_refused_with_what_was_found() {
        let refused = |paint: Paint<'_>| paint.check([4, 3]).map_err(|error| error.to_string());
        let said = |text: &str| Err(text.to_owned());
        let square = [[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0]];
        assert_eq!(refused(Paint::Polygon(&square)), Ok(()));
        let two = refused(Paint::Polygon(&square[..2]));
        assert_eq!(two, said("expected 3 to 4096 points, found 2"));
        let many = refused(Paint::Polygon(&vec![[1.0, 1.0]; 4097]));
        assert_eq!(many, said("expected 3 to 4096 points, found 4097"));
        let far = refused(Paint::Polygon(&[[0.0, 0.0], [4.5, 0.0], [4.0, 3.0]]));
        let text = "expected points within the image, 4 x 3 px, found (4.5, 0)";
        assert_eq!(far, said(text));
        let tie = refused(Paint::Polygon(&[
            [0.0, 0.0],
            [2.0, 2.0],
            [2.0, 0.0],
            [0.0, 2.0],
        ]));
        let text = "expected an outline that does not cross itself, found that it does at (1, 1)";
        assert_eq!(tie, said(text));
        let stroke = |brush_px| Paint::Stroke {
            line: &square[..1],
            brush_px,
        };
        assert_eq!(refused(stroke(9.0)), Ok(()));
        for brush_px in [0.0, -3.0, 1e9, f64::NAN] {
            assert!(refused(stroke(brush_px)).is_err(), "{brush_px}");
        }
        let lost = Paint::Polygon(&[[0.0, f64::NAN], [4.0, 0.0], [4.0, 3.0]]);
        assert!(refused(lost).is_err());
    }

    proptest! {
        /// A pixel is covered where its middle is no farther from the line than half the brush, whatever the line.
        #[test]
        fn a_stroke_is_all_that_is_near_its_line(
            line in prop::collection::vec(prop::array::uniform2(0.0..20.0_f64), 1..5), brush_px in 1.0..12.0_f64
        ) {
            let mut pixels = vec![0; 400];
            Paint::Stroke { line: &line, brush_px }.lay(&mut pixels, 20, 1);
            for (index, found) in pixels.iter().enumerate() {
                let at = [(index % 20) as f64 + 0.5, (index / 20) as f64 + 0.5];
                let near = |ends: &[Point]| away(at, ends[0], *ends.last().unwrap_or(&ends[0]));
                let nearest = line.windows(2.min(line.len())).map(near).fold(f64::MAX, f64::min);
                if (nearest - brush_px / 2.0).abs() > 1e-6 {
                    prop_assert_eq!(*found == 1, nearest < brush_px / 2.0, "{:?}: {}", at, nearest);
                }
            }
        }
    }

    /// Distance from a place to a line between two others.
    fn away(at: Point, a: Point, b: Point) -> f64 {
        let (x, y) = (b[0] - a[0], b[1] - a[1]);
        let squared = (x * x + y * y).max(f64::MIN_POSITIVE);
        let share = ((at[0] - a[0]) * x + (at[1] - a[1]) * y) / squared;
        let share = share.clamp(0.0, 1.0);
        (at[0] - a[0] - share * x).hypot(at[1] - a[1] - share * y)
    }
}
