//! The black outside of a fisheye's image circle, found in the image itself.

use crate::Grey;

/// What is darker than this, and reaches in from a corner, may be the outside of the image circle (grey values).
/// A black level and JPEG's ringing stay well below.
const BLACK: u8 = 28;

/// How much brighter than its corner the outside may be.
const RIPPLE: u8 = 10;

/// Which part of each row the lens lights: from the first to behind the last column that is not outside.
///
/// Outside is what is as dark as the corner and joined to it: runs from the image's left and right borders, in rows
/// that follow each other from the top or the bottom. An image whose corners are lit is lit everywhere.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Vignette {
    rows: Vec<[u32; 2]>,
}

impl Vignette {
    /// Of an image.
    pub fn of(image: &Grey) -> Self {
        let height = image.height as usize;
        let mut rows = vec![[0, image.width]; height];
        let from_top: Vec<usize> = (0..height).collect();
        let from_bottom: Vec<usize> = (0..height).rev().collect();
        for order in [&from_top, &from_bottom] {
            for right in [false, true] {
                for (row, run) in order.iter().zip(dark_runs(image, order, right)) {
                    let [first, end] = &mut rows[*row];
                    if right {
                        *end = (*end).min(image.width - run);
                    } else {
                        *first = (*first).max(run);
                    }
                }
            }
        }
        Self { rows }
    }

    /// Whether a pixel and all around it within `margin` pixels, sideways, up and down, are lit. The image's own
    /// borders do not count.
    pub fn lit(&self, [u, v]: [f64; 2], margin: f64, width: u32) -> bool {
        let row = |v: f64| (v.round().max(0.0) as usize).min(self.rows.len().saturating_sub(1));
        [row(v - margin), row(v), row(v + margin)]
            .into_iter()
            .all(|row| {
                self.rows.get(row).is_some_and(|[first, end]| {
                    let left = *first == 0 || u - margin >= f64::from(*first);
                    let right = *end == width || u + margin < f64::from(*end);
                    left && right && first < end
                })
            })
    }
}

/// Lengths of the dark runs at one side, row after row until a row has none.
fn dark_runs(image: &Grey, order: &[usize], right: bool) -> Vec<u32> {
    let width = image.width as usize;
    let pixels = |row: usize| &image.data[row * width..][..width];
    let Some(corner) = order.first().map(|row| {
        let row = pixels(*row);
        if right { row[width - 1] } else { row[0] }
    }) else {
        return Vec::new();
    };
    if corner > BLACK {
        return Vec::new();
    }
    let dark = |pixel: &&u8| **pixel <= corner.saturating_add(RIPPLE);
    let runs = order.iter().map(|row| {
        let row = pixels(*row);
        let run = if right {
            row.iter().rev().take_while(dark).count()
        } else {
            row.iter().take_while(dark).count()
        };
        run as u32
    });
    runs.take_while(|run| *run > 0).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A disc of light on black.
    fn disc(radius: f64, level: u8, black: u8) -> Grey {
        let (width, height) = (80_u32, 60_u32);
        let lit = |at: u32| {
            let (u, v) = (f64::from(at % width) - 39.5, f64::from(at / width) - 29.5);
            if u.hypot(v) < radius { level } else { black }
        };
        let data = (0..width * height).map(lit).collect();
        Grey {
            width,
            height,
            data,
        }
    }

    #[test]
    fn the_outside_of_a_circle_is_not_lit() {
        let vignette = Vignette::of(&disc(38.0, 120, 6));
        for (pixel, margin, lit) in [
            ([39.5, 29.5], 5.0, true),
            ([0.0, 0.0], 0.0, false),
            ([79.0, 59.0], 0.0, false),
            ([39.0, 0.0], 0.0, true),
            ([39.0, 59.0], 2.0, true),
            ([17.0, 0.0], 0.0, true),
            ([17.0, 0.0], 3.0, false),
            ([5.0, 29.0], 3.0, true),
        ] {
            assert_eq!(vignette.lit(pixel, margin, 80), lit, "{pixel:?} {margin}");
        }
    }

    #[test]
    fn a_lit_or_an_even_image_has_no_outside_but_darkness() {
        let lit = Vignette::of(&disc(38.0, 120, 60));
        assert!(lit.lit([0.0, 0.0], 5.0, 80) && lit.lit([79.0, 59.0], 5.0, 80));
        let black = Vignette::of(&disc(38.0, 0, 0));
        assert!(!black.lit([39.0, 29.0], 0.0, 80));
    }
}
