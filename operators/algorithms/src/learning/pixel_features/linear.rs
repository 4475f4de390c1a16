//! Linear functions of the features of many pixels: where what a network sees has far fewer cells than there are pixels, they
//! are taken of the cells, and what lies between them is taken of their results, as both are linear.

use nalgebra::DMatrix;

use super::{CHANNELS, FeatureMap, PixelFeatures, sift};

/// Cells are projected where there are at most so many of the pixels that are asked for: their results take memory, and what lies
/// between is as much work as sixteen features.
const MOST_CELLS: f64 = 0.25;

/// Linear functions of the features of an image's pixels.
pub struct LinearFeatures {
    /// What is read at single pixels.
    features: PixelFeatures,
    /// Its weights, a row each function.
    weights: DMatrix<f32>,
    /// The functions of cells.
    projected: Vec<FeatureMap>,
}

impl LinearFeatures {
    /// With these weights, a row each function and a column each feature, of so many pixels.
    pub fn new(mut features: PixelFeatures, weights: &DMatrix<f32>, pixels: usize) -> Self {
        let options = &features.description.options;
        let windows = options.windows_px.len() * CHANNELS;
        let mut first = features.sift.len() * sift::DIMENSIONS + windows;
        let mut kept: Vec<usize> = (0..first).collect();
        let mut projected = Vec::new();
        features.maps.retain(|map| {
            let own = first..first + map.channels;
            first = own.end;
            let is_coarse = (map.size[0] * map.size[1]) as f64 <= MOST_CELLS * pixels as f64;
            if is_coarse {
                projected.push(map.projected(&weights.columns(own.start, own.len())));
            } else {
                kept.extend(own);
            }
            !is_coarse
        });
        kept.extend(first..weights.ncols());
        Self {
            features,
            weights: weights.select_columns(&kept),
            projected,
        }
    }

    /// Maps whose cells are weighed.
    #[cfg(test)]
    pub(super) fn projected(&self) -> usize {
        self.projected.len()
    }

    /// Adds their values at some pixels of a row, a column each; positions beyond the image stand for the nearest pixel.
    pub fn add(&self, us: &[usize], v: usize, sums: &mut DMatrix<f32>) {
        let length = self.weights.ncols();
        let mut bytes = vec![0; us.len() * length];
        for (u, out) in us.iter().zip(bytes.chunks_exact_mut(length)) {
            self.features.write(*u, v, out);
        }
        let values = bytes.iter().map(|byte| f32::from(*byte));
        let values = DMatrix::from_iterator(length, us.len(), values);
        sums.gemm(1.0, &self.weights, &values, 1.0);
        for map in &self.projected {
            map.add(us, v, sums.as_mut_slice());
        }
    }
}
