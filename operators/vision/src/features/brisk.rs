//! Detection and description by OpenCV.

use std::borrow::Cow;
use std::sync::{Mutex, MutexGuard, PoisonError};

use opencv::core::{
    KeyPoint, KeyPointTraitConst, Mat, MatTraitConstManual, Ptr, Size, ToInputArray, Vector,
    no_array,
};
use opencv::features2d::{BRISK, BRISKTrait, Feature2DTrait};
use opencv::imgproc::{INTER_AREA, INTER_CUBIC, resize};

use super::spread::{Candidate, spread};
use super::{Blind, DESCRIPTOR_BYTES, FeatureParams, KeyPoints, Vignette};
use crate::threads::one_thread;
use crate::{Grey, ImageError};

/// The threshold is right when this many times the wanted key points are found: enough to choose from.
const CHOICE: [f64; 2] = [1.5, 6.0];

/// What is aimed at between the two.
const AIM: f64 = 2.5;

/// Key points found fall with about this power of the threshold (measured on car parks and streets; only the
/// number of tries depends on it).
const FALL: f64 = 1.6;

/// A first guess that suits well-lit images.
const FIRST_THRESHOLD: f64 = 16.0;

/// Radius of BRISK's pattern at scale 1 (px): what a descriptor looks at.
const PATTERN_RADIUS_PX: f64 = 10.0;

/// No side of an image may be shorter (px): a descriptor's pattern would not fit.
const SMALLEST_PX: u32 = 24;

/// OpenCV's detectors that nobody is using. Making BRISK's sampling pattern takes longer than using it on an image, and it
/// fills 45 MiB: as many are made as work side by side, and they go when this does.
#[derive(Default)]
pub struct Detectors(Mutex<Vec<Ptr<BRISK>>>);

impl Detectors {
    /// The features of an image, spread over what it shows. The same pixels give the same features. An image without
    /// contrast gives none.
    ///
    /// # Errors
    /// [`ImageError`] for an image of no size, or a scale that leaves none of it.
    pub fn features(
        &self,
        image: &Grey,
        params: &FeatureParams,
        blind: &Blind,
    ) -> Result<KeyPoints, ImageError> {
        one_thread()?;
        let extraction = Extraction::new(image, params, blind)?;
        let idle = self.idle().pop();
        let mut brisk = match idle {
            Some(brisk) => brisk,
            None => BRISK::create_def()?,
        };
        let found = extraction.run(&mut brisk);
        self.idle().push(brisk);
        found
    }

    fn idle(&self) -> MutexGuard<'_, Vec<Ptr<BRISK>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The work on one image.
struct Extraction<'a> {
    params: &'a FeatureParams,
    blind: &'a Blind,
    vignette: Vignette,
    full: &'a Grey,
    image: Cow<'a, Grey>,
}

impl<'a> Extraction<'a> {
    fn new(
        full: &'a Grey,
        params: &'a FeatureParams,
        blind: &'a Blind,
    ) -> Result<Self, ImageError> {
        let (width, height) = (full.width, full.height);
        if crate::grey::checked_pixels(width, height)? != full.data.len() {
            return Err(ImageError::Size { width, height });
        }
        let image = match params.scale_for(width) {
            1.0 => Cow::Borrowed(full),
            scale => Cow::Owned(resized(full, scale)?),
        };
        Ok(Self {
            params,
            blind,
            vignette: Vignette::of(full),
            full,
            image,
        })
    }

    fn run(self, brisk: &mut Ptr<BRISK>) -> Result<KeyPoints, ImageError> {
        if self.image.width.min(self.image.height) < SMALLEST_PX {
            return Ok(KeyPoints::default());
        }
        let (height, width) = (self.image.height as i32, self.image.width as i32);
        let image = Mat::new_rows_cols_with_data(height, width, self.image.data.as_slice())?;
        let found = self.detect(brisk, &image)?;
        let size = [width as f32, height as f32];
        let candidates: Vec<Candidate> = found.iter().map(Candidate::from).collect();
        let mut kept: Vector<KeyPoint> = spread(&candidates, size, self.params.count as usize)
            .into_iter()
            .filter_map(|index| found.get(index).cloned())
            .collect();
        if kept.is_empty() {
            return Ok(KeyPoints::default());
        }
        let mut descriptors = Mat::default();
        brisk.detect_and_compute(&image, &no_array(), &mut kept, &mut descriptors, true)?;
        self.keypoints(&kept, &descriptors)
    }

    /// Key points enough to choose from, at a threshold that suits the image's contrast.
    fn detect(
        &self,
        brisk: &mut Ptr<BRISK>,
        image: &impl ToInputArray,
    ) -> Result<Vec<KeyPoint>, ImageError> {
        let wanted = f64::from(self.params.count.max(1));
        let lowest = f64::from(self.params.min_contrast.clamp(1, 255));
        let mut threshold = FIRST_THRESHOLD.max(lowest);
        let mut found = Vector::new();
        let mut kept = Vec::new();
        brisk.set_octaves(self.octaves())?;
        for last in [false, false, true] {
            brisk.set_threshold(threshold.round() as i32)?;
            brisk.detect_def(image, &mut found)?;
            kept = found.iter().filter(|point| self.visible(point)).collect();
            let ratio = kept.len().max(1) as f64 / wanted;
            let next = (threshold * (ratio / AIM).powf(1.0 / FALL)).clamp(lowest, 255.0);
            let enough = (CHOICE[0]..=CHOICE[1]).contains(&ratio);
            if last || enough || next.round() == threshold.round() {
                break;
            }
            threshold = next;
        }
        Ok(kept)
    }

    /// As many as leave the smallest layer room for a pattern.
    fn octaves(&self) -> i32 {
        let side = self.image.width.min(self.image.height);
        let possible = (0..16).take_while(|n| (side >> n) >= SMALLEST_PX);
        self.params.octaves.min(possible.count() as u32) as i32
    }

    fn visible(&self, point: &KeyPoint) -> bool {
        let [u, v] = self.in_full(point);
        let scale = self.full.width as f64 / self.image.width as f64;
        let margin = PATTERN_RADIUS_PX * scale;
        self.vignette.lit([u, v], margin, self.full.width) && !self.blind.covers([u, v])
    }

    /// Where a point of the worked-on image is in the full one: corners of the images stay corners.
    fn in_full(&self, point: &KeyPoint) -> [f64; 2] {
        let at = point.pt();
        let x = f64::from(self.full.width) / f64::from(self.image.width);
        let y = f64::from(self.full.height) / f64::from(self.image.height);
        [
            (f64::from(at.x) + 0.5) * x - 0.5,
            (f64::from(at.y) + 0.5) * y - 0.5,
        ]
    }

    fn keypoints(
        &self,
        kept: &Vector<KeyPoint>,
        descriptors: &Mat,
    ) -> Result<KeyPoints, ImageError> {
        let scale = self.full.width as f32 / self.image.width as f32;
        let mut points = KeyPoints {
            descriptors: descriptors.data_bytes()?.to_vec(),
            ..KeyPoints::default()
        };
        for point in kept {
            let [u, v] = self.in_full(&point);
            points.u.push(u as f32);
            points.v.push(v as f32);
            points.size_px.push(point.size() * scale);
        }
        if points.descriptors.len() != DESCRIPTOR_BYTES * points.len() {
            return Err(ImageError::OpenCv {
                message: format!(
                    "{} key points, {} bytes",
                    kept.len(),
                    points.descriptors.len()
                ),
            });
        }
        Ok(points)
    }
}

impl From<&KeyPoint> for Candidate {
    fn from(point: &KeyPoint) -> Self {
        let at = point.pt();
        Self {
            at: [at.x, at.y],
            response: point.response(),
        }
    }
}

/// The image at another scale, at least one pixel large.
fn resized(full: &Grey, scale: f64) -> Result<Grey, ImageError> {
    let side = |side: u32| {
        (f64::from(side) * scale)
            .round()
            .clamp(0.0, f64::from(u32::MAX)) as u32
    };
    let mut image = Grey::default();
    image.reset(side(full.width), side(full.height))?;
    let (rows, columns) = (image.height as i32, image.width as i32);
    let source =
        Mat::new_rows_cols_with_data(full.height as i32, full.width as i32, full.data.as_slice())?;
    let mut target = Mat::new_rows_cols_with_data_mut(rows, columns, image.data.as_mut_slice())?;
    let interpolation = if scale < 1.0 { INTER_AREA } else { INTER_CUBIC };
    let size = Size::new(columns, rows);
    resize(&source, &mut target, size, 0.0, 0.0, interpolation)?;
    drop(target);
    Ok(image)
}
