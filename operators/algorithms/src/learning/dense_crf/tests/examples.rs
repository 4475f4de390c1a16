//! The examples of the Python bindings of the reference implementation (pydensecrf), with the results that their
//! authors keep beside them.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stderr
)]

use std::path::Path;

use super::super::{ColourView, Kernels, RandomField};
use super::of_labels;
use evermap_test_data::shared;

/// The reference itself, given the coordinates in another order, agrees with its own results on this much: the
/// lattice is not the same from all sides. (Measured: 99.87 %.)
const AGREEMENT: f64 = 0.998;

struct Picture {
    width: u32,
    height: u32,
    rgb: Vec<u8>,
}

fn read(path: &Path) -> Picture {
    let mut decoder =
        png::Decoder::new(std::io::BufReader::new(std::fs::File::open(path).unwrap()));
    decoder.set_transformations(png::Transformations::EXPAND);
    let mut reader = decoder.read_info().unwrap();
    let mut rgb = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut rgb).unwrap();
    assert_eq!(info.color_type, png::ColorType::Rgb);
    rgb.truncate(info.buffer_size());
    Picture {
        width: info.width,
        height: info.height,
        rgb,
    }
}

/// Colours but black, in the order of their blue-first numbers, as the example counts them.
fn classes(picture: &Picture) -> Vec<[u8; 3]> {
    let mut colours = picture.rgb.as_chunks::<3>().0.to_vec();
    colours.sort_unstable();
    colours.dedup();
    colours.retain(|colour| *colour != [0; 3]);
    colours
}

fn agreement(folder: &Path, image: &str, annotation: &str, expected: &str) -> f64 {
    let [image, annotation, expected] =
        [image, annotation, expected].map(|name| read(&folder.join(format!("{name}.png"))));
    let classes = classes(&annotation);
    let label = |colour: &[u8; 3]| {
        classes
            .binary_search(colour)
            .map_or(255, |class| class as u8)
    };
    let labels = |picture: &Picture| -> Vec<u8> {
        picture.rgb.as_chunks::<3>().0.iter().map(label).collect()
    };
    let view = ColourView::new(image.width, image.height, &image.rgb).unwrap();
    let field = RandomField::new(&view, &Kernels::default(), false).unwrap();
    let unary = of_labels(classes.len(), &labels(&annotation), 0.7);
    let found = field.infer(&unary, 5).unwrap().labels();
    let expected = labels(&expected);
    let equal = found.iter().zip(&expected).filter(|(a, b)| a == b).count();
    equal as f64 / expected.len() as f64
}

#[test]
fn the_references_examples_come_out_as_theirs_do() {
    let Some(folder) = shared("data/densecrf") else {
        return;
    };
    for [image, annotation, expected] in [
        ["im1", "anno1", "out1"],
        ["im1", "anno1-b", "out1-b"],
        ["im2", "anno2", "out2"],
        ["im3", "anno3", "out3"],
    ] {
        let equal = agreement(&folder, image, annotation, expected);
        eprintln!("{expected}: {:.4} % of the labels are equal", 100.0 * equal);
        assert!(equal >= AGREEMENT, "{expected}: {equal}");
    }
}
