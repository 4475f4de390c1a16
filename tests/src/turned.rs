//! Panoramas that look elsewhere: the same log, as if its camera had stood turned by another angle at each view.

use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::io::Cursor;
use std::path::Path;

use evermap_vision::{Grey, decode_grey, encode_png};

/// Copies a log of whole panoramas, each turned by `share` of a circle to the right, which is drawn by its stamp. Says how
/// far (rad), by stamp (ns).
///
/// # Panics
/// Where the log is not as `evermap simulate street` writes it.
pub fn turned(log: &Path, to: &Path, mut share: impl FnMut() -> f64) -> BTreeMap<i64, f64> {
    let bytes = std::fs::read(log).expect("the log can be read");
    let file = std::fs::File::create(to).expect("a log can be made");
    let mut writer = mcap::Writer::new(std::io::BufWriter::new(file)).expect("a log begins");
    let mut turns = BTreeMap::new();
    for message in mcap::MessageStream::new(&bytes).expect("the log has a beginning") {
        let mut message = message.expect("the log is whole");
        let schema = message.channel.schema.clone();
        if schema.is_some_and(|schema| schema.name.ends_with("CompressedImage")) {
            let stamp = stamp(&message.data);
            let turn = *turns.entry(stamp).or_insert_with(|| TAU * share());
            let at = image_at(&message.data);
            let image = rolled(&message.data[at..], turn);
            let mut data = message.data[..at - 4].to_vec();
            data.extend((image.len() as u32).to_le_bytes());
            data.extend(image);
            message.data = data.into();
        }
        writer.write(&message).expect("a message fits");
    }
    writer.finish().expect("a log ends");
    turns
}

fn number(data: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(data[at..at + 4].try_into().expect("four bytes"))
}

/// Instant of a message in CDR that begins with a header (ns).
fn stamp(data: &[u8]) -> i64 {
    i64::from(number(data, 4)) * 1_000_000_000 + i64::from(number(data, 8))
}

/// Where the bytes of a `sensor_msgs/CompressedImage` begin, in CDR: after the header's frame and the format.
fn image_at(data: &[u8]) -> usize {
    let after_text = |at: usize| (at + 4 + number(data, at) as usize).next_multiple_of(4);
    after_text(after_text(12)) + 4
}

/// An image whose columns are moved to the left, as a camera sees them that turned to the right: as PNG.
fn rolled(image: &[u8], turn: f64) -> Vec<u8> {
    if !image.starts_with(b"\x89PNG") {
        let mut grey = Grey::default();
        decode_grey(image, &mut grey).expect("an image");
        return rolled(&encode_png(&grey).expect("an image"), turn);
    }
    let mut decoder = png::Decoder::new(Cursor::new(image));
    decoder.set_transformations(png::Transformations::IDENTITY);
    let mut reader = decoder.read_info().expect("a PNG");
    let mut pixels = vec![0; reader.output_buffer_size().expect("a size")];
    let info = reader.next_frame(&mut pixels).expect("a whole PNG");
    let columns = (turn / TAU * f64::from(info.width)).round() as usize;
    let line = info.line_size;
    for row in pixels.chunks_exact_mut(line) {
        row.rotate_left(columns * (line / info.width as usize) % line);
    }
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, info.width, info.height);
    encoder.set_color(info.color_type);
    encoder.set_depth(info.bit_depth);
    if let Some(palette) = &reader.info().palette {
        encoder.set_palette(palette.to_vec());
    }
    let mut writer = encoder.write_header().expect("memory suffices");
    writer.write_image_data(&pixels).expect("memory suffices");
    writer.finish().expect("memory suffices");
    bytes
}
