//! The matrix of a relocation run: how much each query looks like each view of the map.

use askama::Template;
use evermap_schemas::Fault;
use png::ColorType;

use crate::draw::pixels::{data_url, encoded};
use crate::draw::viewport::round_length;
use crate::draw::{Picture, colours, strokes};
use crate::semantic::Similarities;

/// Left of the matrix: its vertical title, numbers, ticks, px.
const LEFT_PX: u32 = 76;
/// Above the matrix, and right of it: half a number, px.
const BEYOND_PX: u32 = 22;
/// Below the matrix: ticks, numbers, title and the scale of grey, px.
const BELOW_PX: u32 = 84;
/// From one number of an axis to the next, at least, px.
const NUMBER_EVERY_PX: f64 = 60.0;

/// Queries from left to right, views of the map from top to bottom, each as far apart as the picture's width allows; bright is
/// alike. With axes and the scale of grey.
///
/// # Errors
/// A resource fault when it cannot be encoded.
pub fn matrix(similarities: &Similarities, width_px: u32) -> Result<Picture, Fault> {
    let values = similarities.values.iter();
    let grey: Vec<u8> = values
        .map(|value| (value.clamp(0.0, 1.0) * 255.0).round() as u8)
        .collect();
    let (columns, rows) = (similarities.queries as u32, similarities.views as u32);
    let png = encoded(columns, rows, ColorType::Grayscale, &grey)?;
    let room = width_px.saturating_sub(LEFT_PX + BEYOND_PX);
    let scale = (room / columns.max(1)).max(1);
    let ramp: Vec<u8> = (0..=255).collect();
    let matrix = Matrix {
        width: (columns * scale).max(1),
        height: (rows * scale).max(1),
        href: data_url(&png),
        ramp: data_url(&encoded(256, 1, ColorType::Grayscale, &ramp)?),
        columns: numbers(columns, scale),
        rows: numbers(rows, scale),
        across: format!(
            "queries of {}",
            strokes::name(&similarities.query_sessions, 60)
        ),
        down: format!(
            "views of {}",
            strokes::name(&similarities.view_sessions, 60)
        ),
    };
    Ok(Picture {
        svg: matrix.to_string(),
        width_px: matrix.whole_width(),
        height_px: matrix.whole_height(),
    })
}

/// Numbers of an axis: each with where it is, px.
fn numbers(count: u32, scale: u32) -> Vec<(String, f64)> {
    // Round lengths are at most 2.5 times as far apart: this one is as long as is needed.
    let every = round_length(2.5 * NUMBER_EVERY_PX / f64::from(scale)).max(1.0);
    let marks = (0..count).step_by(every as usize);
    let middle = |mark: u32| (f64::from(mark) + 0.5) * f64::from(scale);
    marks.map(|mark| (mark.to_string(), middle(mark))).collect()
}

#[derive(Template)]
#[template(path = "matrix.svg")]
struct Matrix {
    /// Of the matrix itself, px.
    width: u32,
    height: u32,
    href: String,
    /// From black to white.
    ramp: String,
    columns: Vec<(String, f64)>,
    rows: Vec<(String, f64)>,
    /// Titles of the axes.
    across: String,
    down: String,
}

impl Matrix {
    fn whole_width(&self) -> u32 {
        let title = strokes::width(&self.across).ceil() as u32;
        LEFT_PX + BEYOND_PX + self.width.max(title)
    }

    fn whole_height(&self) -> u32 {
        let title = strokes::width(&self.down).ceil() as u32;
        BEYOND_PX + BELOW_PX + self.height.max(title)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_matrix_has_a_square_for_each_pair_and_axes() {
        let similarities = Similarities {
            queries: 2,
            views: 3,
            values: vec![0.0, 1.0, 0.5, 0.0, 0.0, 0.2],
            query_sessions: "b".into(),
            view_sessions: "a".into(),
        };
        let picture = matrix(&similarities, 20 + LEFT_PX + BEYOND_PX).unwrap();
        assert!(
            picture
                .svg
                .contains("<image id=\"matrix\" width=\"20\" height=\"30\"")
        );
        for title in ["queries of b", "views of a", "similarity"] {
            assert!(picture.svg.contains(&strokes::letters(title)), "{title}");
        }
        assert!(picture.width_px > 20 + LEFT_PX && picture.height_px > 30 + BELOW_PX);
        crate::draw::png(&picture).unwrap();
    }

    #[test]
    fn numbers_stand_apart() {
        for (count, scale) in [(1, 1), (2, 300), (112, 9), (5000, 1)] {
            let found = numbers(count, scale);
            assert_eq!(found[0].0, "0");
            let apart = found.windows(2).map(|pair| pair[1].1 - pair[0].1);
            let least = apart.fold(f64::INFINITY, f64::min);
            assert!(least >= NUMBER_EVERY_PX, "{count} {scale}: {least}");
            assert!(found.len() < 100);
        }
    }
}
