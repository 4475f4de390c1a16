//! Resampling by look-up table: what the overhead mosaic is measured against.

use evermap_vision::{Grey, ImageError};
use opencv::core::{
    BORDER_CONSTANT, CV_16SC2, CV_32FC1, Mat, MatTraitConst, Scalar, set_num_threads,
};
use opencv::imgproc::{INTER_LINEAR, convert_maps, remap};

/// A fixed way to resample images of one camera: OpenCV's `remap` with bilinear interpolation and fixed-point maps.
pub struct Remap {
    whole: Mat,
    fraction: Mat,
}

impl Remap {
    /// From the source position (pixels; the top-left pixel's centre is (0, 0)) of each output pixel, row by row.
    /// What lies outside the source comes out black; give such pixels a position like (-10, -10).
    ///
    /// # Errors
    /// [`ImageError::Size`] when the positions are not `width * height`.
    pub fn new(width: u32, height: u32, x: &[f32], y: &[f32]) -> Result<Self, ImageError> {
        set_num_threads(1)?;
        let pixels = width as usize * height as usize;
        if x.len() != pixels || y.len() != pixels {
            return Err(ImageError::Size { width, height });
        }
        let x = Mat::new_rows_cols_with_data(height as i32, width as i32, x)?;
        let y = Mat::new_rows_cols_with_data(height as i32, width as i32, y)?;
        debug_assert_eq!(x.typ(), CV_32FC1);
        let (mut whole, mut fraction) = (Mat::default(), Mat::default());
        convert_maps(&x, &y, &mut whole, &mut fraction, CV_16SC2, false)?;
        Ok(Self { whole, fraction })
    }

    /// The resampled image, into a buffer that is used again.
    ///
    /// # Errors
    /// [`ImageError::OpenCv`] when the source is not an image.
    pub fn apply(&self, source: &Grey, target: &mut Grey) -> Result<(), ImageError> {
        (target.width, target.height) = (self.whole.cols() as u32, self.whole.rows() as u32);
        target.data.clear();
        target
            .data
            .resize(target.width as usize * target.height as usize, 0);
        let (height, width) = (source.height as i32, source.width as i32);
        let source = Mat::new_rows_cols_with_data(height, width, source.data.as_slice())?;
        let mut output = Mat::new_rows_cols_with_data_mut(
            target.height as i32,
            target.width as i32,
            target.data.as_mut_slice(),
        )?;
        remap(
            &source,
            &mut output,
            &self.whole,
            &self.fraction,
            INTER_LINEAR,
            BORDER_CONSTANT,
            Scalar::default(),
        )?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;

    #[test]
    fn shifts_and_interpolates_and_is_black_outside() {
        let source = Grey {
            width: 2,
            height: 2,
            data: vec![0, 100, 50, 150],
        };
        let remap = Remap::new(3, 1, &[1.0, 0.5, -10.0], &[0.0, 0.5, -10.0]).unwrap();
        let mut target = Grey::default();
        remap.apply(&source, &mut target).unwrap();
        assert_eq!(target.data, [100, 75, 0]);
        assert!(Remap::new(2, 2, &[0.0], &[0.0]).is_err());
        assert!(remap.apply(&Grey::default(), &mut target).is_err());
    }
}
