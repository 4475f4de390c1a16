//! People, by histograms of oriented gradients: OpenCV's detector, which its authors taught with upright people of 96 pixels.
//!
//! Navneet Dalal, Bill Triggs: *Histograms of oriented gradients for human detection*, CVPR 2005; weights of a linear
//! support-vector machine as OpenCV ships them (Apache 2.0).

use opencv::core::{Mat, Point, Size, Vector};
use opencv::objdetect::{HOGDescriptor, HOGDescriptorTrait, HOGDescriptorTraitConst};

use crate::threads::one_thread;
use crate::{Grey, ImageError};

/// Width and height of a window, pixels.
const WINDOW: [i32; 2] = [64, 128];
/// Windows are looked at on a grid as wide as a cell of gradients, pixels.
const STRIDE: i32 = 8;
/// Directions of gradients that a cell tells apart.
const BINS: usize = 9;
/// Blocks of two by two cells, one above the other: OpenCV tells them column by column.
const BLOCK_ROWS: usize = 15;

/// Tells people from all else in windows of 64 × 128 pixels, in which they are 96 pixels high, upright and in the middle.
pub struct PeopleDetector {
    hog: HOGDescriptor,
    /// Of a window's description, and a constant one.
    weights: Vec<f32>,
}

impl PeopleDetector {
    /// As OpenCV ships it.
    ///
    /// # Errors
    /// [`ImageError::OpenCv`].
    pub fn new() -> Result<Self, ImageError> {
        one_thread()?;
        let mut hog = HOGDescriptor::default()?;
        let weights = HOGDescriptor::get_default_people_detector()?;
        hog.set_svm_detector(weights.clone());
        Ok(Self {
            hog,
            weights: weights.iter().collect(),
        })
    }

    /// Windows that score at least `least`: column and row of their first pixel, and their score; in order of rows. Windows
    /// lie on a grid of 8 pixels. None in an image that is smaller than one.
    ///
    /// # Errors
    /// [`ImageError::OpenCv`].
    pub fn scan(&self, image: &Grey, least: f64) -> Result<Vec<([u32; 2], f64)>, ImageError> {
        if image.width < WINDOW[0] as u32 || image.height < WINDOW[1] as u32 {
            return Ok(Vec::new());
        }
        let (mut found, mut scores) = (Vector::<Point>::new(), Vector::<f64>::new());
        self.hog.detect_weights(
            &matrix(image)?,
            &mut found,
            &mut scores,
            least,
            Size::new(STRIDE, STRIDE),
            Size::new(0, 0),
            &Vector::new(),
        )?;
        let place = |point: Point| [point.x.max(0) as u32, point.y.max(0) as u32];
        let mut windows: Vec<([u32; 2], f64)> = found.iter().map(place).zip(scores).collect();
        windows.sort_by_key(|([column, row], _)| (*row, *column));
        Ok(windows)
    }

    /// The score of an image that is one window; above 0 for what looks more like a person.
    ///
    /// # Errors
    /// [`ImageError::Size`] where it has another size, [`ImageError::OpenCv`].
    pub fn score(&self, window: &Grey) -> Result<f64, ImageError> {
        let histograms = self.histograms(window)?;
        let products = histograms.iter().chain(&[1.0]).zip(&self.weights);
        Ok(products
            .map(|(value, weight)| f64::from(*value) * f64::from(*weight))
            .sum())
    }

    /// What an image that is one window shows, for somebody who is taught with few examples: a thirteenth of the numbers that
    /// the score comes from. Of the 4 × 8 blocks of 16 pixels that do not overlap, how much stronger than their mean
    /// gradients are in each of nine directions; of length 1 all together (0 where nothing is seen), and a constant 1 behind
    /// them.
    ///
    /// # Errors
    /// As [`PeopleDetector::score`].
    pub fn describe(&self, window: &Grey) -> Result<Vec<f32>, ImageError> {
        let histograms = self.histograms(window)?;
        let blocks = histograms.chunks_exact(4 * BINS).enumerate();
        let apart =
            |at: usize| (at / BLOCK_ROWS).is_multiple_of(2) && (at % BLOCK_ROWS).is_multiple_of(2);
        let blocks = blocks.filter(|(at, _)| apart(*at));
        let mut description: Vec<f32> = blocks.flat_map(|(_, block)| directions(block)).collect();
        let squares: f32 = description.iter().map(|value| value * value).sum();
        let length = squares.sqrt();
        if length > 0.0 {
            description.iter_mut().for_each(|value| *value /= length);
        }
        description.push(1.0);
        Ok(description)
    }

    /// Histograms of an image that is one window: block by block, in each cell by cell.
    fn histograms(&self, window: &Grey) -> Result<Vec<f32>, ImageError> {
        let (width, height) = (window.width, window.height);
        if [width as i32, height as i32] != WINDOW {
            return Err(ImageError::Size { width, height });
        }
        let mut histograms = Vector::<f32>::new();
        self.hog.compute(
            &matrix(window)?,
            &mut histograms,
            Size::new(STRIDE, STRIDE),
            Size::new(0, 0),
            &Vector::new(),
        )?;
        Ok(histograms.iter().collect())
    }
}

/// How much stronger than their mean the gradients of a block's cells are, by direction.
fn directions(block: &[f32]) -> [f32; BINS] {
    let mut sums = [0.0_f32; BINS];
    for cell in block.chunks_exact(BINS) {
        sums.iter_mut()
            .zip(cell)
            .for_each(|(sum, value)| *sum += value);
    }
    let mean = sums.iter().sum::<f32>() / BINS as f32;
    sums.map(|sum| sum - mean)
}

/// A copy: OpenCV wants no memory of ours.
fn matrix(image: &Grey) -> Result<Mat, ImageError> {
    let rows = Mat::from_slice(&image.data)?;
    let matrix = opencv::core::MatTraitConst::reshape(&rows, 1, image.height as i32)?;
    Ok(opencv::core::MatTraitConst::try_clone(&matrix)?)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// Rows of a figure, half its width there, and half the gap between its legs.
    const SHAPE: [(f64, f64, f64); 13] = [
        (16.0, 4.0, 0.0),
        (20.0, 8.0, 0.0),
        (26.0, 3.0, 2.0),
        (31.0, 5.0, 0.0),
        (33.0, 7.0, 0.0),
        (38.0, 12.0, 0.0),
        (46.0, 11.0, 0.0),
        (56.0, 16.0, 0.0),
        (66.0, 14.0, 0.0),
        (76.0, 9.0, 0.0),
        (88.0, 9.0, 3.0),
        (100.0, 13.0, 3.0),
        (111.0, 5.0, 0.0),
    ];

    /// A dark figure on bright ground in the middle of a window that begins at a column.
    fn figure(width: u32, at: i32) -> Grey {
        let shows = |column: i32, row: i32| {
            let (aside, row) = ((f64::from(column - at) - 31.5).abs(), f64::from(row));
            SHAPE.windows(2).any(|between| {
                let (from, to) = (between[0], between[1]);
                let part = (row - from.0) / (to.0 - from.0);
                let at = |one: f64, other: f64| one + part * (other - one);
                (0.0..=1.0).contains(&part) && (at(from.2, to.2)..at(from.1, to.1)).contains(&aside)
            })
        };
        let value = |at: u32| {
            let (column, row) = ((at % width) as i32, (at / width) as i32);
            if shows(column, row) { 40 } else { 200 }
        };
        Grey {
            width,
            height: 128,
            data: (0..width * 128).map(value).collect(),
        }
    }

    #[test]
    fn a_figure_is_found_where_it_is_and_scores_there_as_by_itself() {
        let detector = PeopleDetector::new().unwrap();
        let found = detector.scan(&figure(256, 96), 0.0).unwrap();
        let best = found.iter().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
        assert_eq!(best.0, [96, 0], "{found:?}");
        let alone = detector.score(&figure(64, 0)).unwrap();
        assert!(
            alone > 2.0 && (alone - best.1).abs() < 0.3,
            "{alone} {}",
            best.1
        );
    }

    #[test]
    fn what_is_described_is_alike_where_windows_are() {
        let detector = PeopleDetector::new().unwrap();
        let described = |at: i32| detector.describe(&figure(64, at)).unwrap();
        let alike = |a: &[f32], b: &[f32]| -> f32 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
        let (person, beside, away) = (described(0), described(2), described(40));
        assert_eq!((person.len(), person[288]), (289, 1.0));
        // Their lengths are 1, beside the constant.
        assert!((alike(&person, &person) - 2.0).abs() < 1e-4);
        assert!(alike(&person, &beside) > alike(&person, &away) + 0.2);
    }

    /// An edge down the left of a window shows in the first of four columns of blocks and nowhere else.
    #[test]
    fn blocks_are_told_column_by_column() {
        let detector = PeopleDetector::new().unwrap();
        let value = |at: u32| if at % 64 < 7 { 40 } else { 200 };
        let edge = Grey {
            width: 64,
            height: 128,
            data: (0..64 * 128).map(value).collect(),
        };
        let described = detector.describe(&edge).unwrap();
        let (left, rest) = described[..288].split_at(72);
        assert!(
            left.chunks(9)
                .all(|block| block.iter().any(|value| *value > 0.1))
        );
        assert!(rest.iter().all(|value| value.abs() < 1e-3));
    }

    #[test]
    fn an_even_image_shows_nobody_and_a_small_one_has_no_window() {
        let detector = PeopleDetector::new().unwrap();
        let even = Grey {
            width: 64,
            height: 128,
            data: vec![90; 64 * 128],
        };
        assert!(detector.score(&even).unwrap() < 0.0);
        let described = detector.describe(&even).unwrap();
        assert!(described[..288].iter().all(|value| *value == 0.0));
        assert!(detector.scan(&even, 0.0).unwrap().is_empty());
        let small = Grey {
            width: 10,
            height: 10,
            data: vec![0; 100],
        };
        assert!(detector.scan(&small, -10.0).unwrap().is_empty());
        assert!(detector.score(&small).is_err());
        assert!(detector.describe(&small).is_err());
    }
}
