//! What a network that was taught with a million photographs sees in an image, at each of its stages.
//!
//! Mingxing Tan, Quoc Le: *EfficientNet: Rethinking model scaling for convolutional neural networks*, ICML 2019; its Lite0,
//! without squeezing, with weights that the authors taught with ImageNet (Apache 2.0; `backbone/README.md` says where the file
//! comes from). Run by OpenCV.

use std::cell::RefCell;
use std::io::Read;

use flate2::read::GzDecoder;
use opencv::core::{CV_32F, Mat, MatTraitConst, MatTraitConstManual, Scalar, Size, Vector};
use opencv::dnn::{Net, NetTrait, blob_from_image, read_net_from_onnx_buffer};
use opencv::imgproc::{INTER_AREA, INTER_LINEAR, resize};

use crate::ImageError;
use crate::threads::one_thread;

const FILE: &[u8] = include_bytes!("../backbone/efficientnet_lite0.onnx.gz");

/// Channels of each stage, and pixels of the network's image to a cell.
const STAGES: [(usize, usize); 6] = [(16, 2), (24, 4), (40, 8), (80, 16), (112, 16), (192, 32)];

/// The image's sides are at least this many cells of the last stage.
const LEAST_CELLS: u32 = 2;

/// What one stage of the network sees of an image.
#[derive(Debug, Clone, PartialEq)]
pub struct Activation {
    /// Numbers of a cell.
    pub channels: usize,
    /// Cells of a row, and rows.
    pub size: [usize; 2],
    /// Cells to a pixel of the image that was given, along its rows and its columns.
    pub cells_per_px: [f32; 2],
    /// Cell after cell, row by row, channels innermost.
    pub values: Vec<f32>,
}

thread_local! {
    /// A network is not shared by threads.
    static NETWORK: RefCell<Option<Net>> = const { RefCell::new(None) };
}

/// What each of six stages of EfficientNet-Lite0 sees of an image: 464 numbers in all, each stage's mostly between -30 and 30
/// with a deviation of 3 to 8. The image (red, green, blue of 8 bits, row by row) is brought to `area_px` pixels of the same
/// shape first, so that time and room are those of the area.
///
/// # Errors
/// [`ImageError::Size`] where there are not as many values as the size says, [`ImageError::OpenCv`].
pub fn activations(
    size: [u32; 2],
    rgb: &[u8],
    area_px: u32,
) -> Result<Vec<Activation>, ImageError> {
    one_thread()?;
    let [width, height] = size;
    if rgb.is_empty() || rgb.len() as u64 != 3 * u64::from(width) * u64::from(height) {
        return Err(ImageError::Size { width, height });
    }
    let looked = looked_at(size, area_px);
    let blob = blob(size, rgb, looked)?;
    let outputs: Vec<String> = (0..STAGES.len()).map(|at| format!("stage{at}")).collect();
    let outputs: Vector<String> = outputs.iter().map(String::as_str).collect();
    let mut found = Vector::<Mat>::new();
    NETWORK.with_borrow_mut(|network| {
        let network = match network {
            Some(network) => network,
            None => network.insert(read()?),
        };
        network.set_input(&blob, "", 1.0, Scalar::default())?;
        network.forward(&mut found, &outputs)?;
        Ok::<_, ImageError>(())
    })?;
    let stages = found.iter().zip(STAGES);
    stages
        .map(|(found, (channels, stride))| activation(&found, channels, stride, size, looked))
        .collect()
}

fn read() -> Result<Net, ImageError> {
    let mut file = Vec::new();
    let unpacked = GzDecoder::new(FILE).read_to_end(&mut file);
    unpacked.map_err(|error| ImageError::OpenCv {
        message: format!("network does not unpack: {error}"),
    })?;
    Ok(read_net_from_onnx_buffer(&file.into_iter().collect())?)
}

/// Size at which an image is looked at: of this area and its own shape, but no stripe.
fn looked_at(size: [u32; 2], area_px: u32) -> [u32; 2] {
    let [width, height] = size.map(f64::from);
    let least = f64::from(LEAST_CELLS) * STAGES[STAGES.len() - 1].1 as f64;
    let most = (f64::from(area_px) / least).max(least);
    let scale = (f64::from(area_px) / (width * height)).sqrt();
    [width, height].map(|side| (side * scale).round().clamp(least, most) as u32)
}

/// The image as the network takes it.
fn blob(size: [u32; 2], rgb: &[u8], looked: [u32; 2]) -> Result<Mat, ImageError> {
    let row = Mat::from_slice(rgb)?;
    let image = row.reshape(3, size[1] as i32)?;
    let mut resized = Mat::default();
    let smaller =
        u64::from(looked[0]) * u64::from(looked[1]) < u64::from(size[0]) * u64::from(size[1]);
    let by = if smaller { INTER_AREA } else { INTER_LINEAR };
    let [width, height] = looked.map(|side| side as i32);
    resize(&image, &mut resized, Size::new(width, height), 0.0, 0.0, by)?;
    let mean = Scalar::all(127.0);
    let as_it_is = Size::new(0, 0);
    Ok(blob_from_image(
        &resized,
        1.0 / 128.0,
        as_it_is,
        mean,
        false,
        false,
        CV_32F,
    )?)
}

/// What a stage gave, channels innermost.
fn activation(
    found: &Mat,
    channels: usize,
    stride: usize,
    size: [u32; 2],
    looked: [u32; 2],
) -> Result<Activation, ImageError> {
    let sides = found.mat_size();
    let &[_, _, rows, columns] = &sides[..] else {
        let message = format!("expected four dimensions, found {}", sides.len());
        return Err(ImageError::OpenCv { message });
    };
    let [rows, columns] = [rows, columns].map(|side| side as usize);
    let planes: &[f32] = found.data_typed()?;
    let cells = rows * columns;
    let mut values = vec![0.0; channels * cells];
    for (channel, plane) in planes.chunks_exact(cells).enumerate().take(channels) {
        for (cell, value) in plane.iter().enumerate() {
            values[cell * channels + channel] = *value;
        }
    }
    let share = |axis: usize| f64::from(looked[axis]) / (f64::from(size[axis]) * stride as f64);
    Ok(Activation {
        channels,
        size: [columns, rows],
        cells_per_px: [share(0) as f32, share(1) as f32],
        values,
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// Grey above, and a checkerboard below.
    fn picture(width: u32, height: u32) -> Vec<u8> {
        let value = |at: u32| {
            let (column, row) = (at % width, at / width);
            match row < height / 2 || (column / 8 + row / 8).is_multiple_of(2) {
                true => 128,
                false => 30,
            }
        };
        (0..width * height).flat_map(|at| [value(at); 3]).collect()
    }

    #[test]
    fn each_stage_sees_the_whole_image_at_its_own_stride() {
        let found = activations([192, 96], &picture(192, 96), 4 * 192 * 96).unwrap();
        let channels: Vec<usize> = found.iter().map(|stage| stage.channels).collect();
        assert_eq!(channels, [16, 24, 40, 80, 112, 192]);
        let sizes: Vec<[usize; 2]> = found.iter().map(|stage| stage.size).collect();
        assert_eq!(sizes[..2], [[192, 96], [96, 48]]);
        assert_eq!(sizes[5], [12, 6]);
        for stage in &found {
            assert_eq!(
                stage.values.len(),
                stage.channels * stage.size[0] * stage.size[1]
            );
            let cells = stage.size[0] as f32 / 192.0;
            assert!(
                (stage.cells_per_px[0] - cells).abs() < 0.02 * cells,
                "{cells}"
            );
        }
        // What lies above differs from what lies below, and less from its neighbour.
        let at = |column: usize, row: usize| {
            let stage = &found[2];
            &stage.values[(row * stage.size[0] + column) * stage.channels..][..stage.channels]
        };
        let apart = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f32>();
        let (near, far) = (apart(at(20, 5), at(24, 5)), apart(at(20, 5), at(20, 19)));
        assert!(4.0 * near < far, "{near} {far}");
        let again = activations([192, 96], &picture(192, 96), 4 * 192 * 96).unwrap();
        assert!(found == again);
    }

    #[test]
    fn stripes_and_single_pixels_are_looked_at_within_the_area() {
        assert_eq!(looked_at([640, 480], 172_800), [480, 360]);
        assert_eq!(looked_at([2, 1], 172_800), [588, 294]);
        assert_eq!(looked_at([100_000, 1], 172_800), [2700, 64]);
        let found = activations([1, 1], &[9, 9, 9], 10_000).unwrap();
        assert_eq!(found.len(), 6);
        assert!(activations([2, 1], &[9, 9, 9], 10_000).is_err());
        assert!(activations([0, 7], &[], 10_000).is_err());
    }
}
