//! PNG in and out.

use base64::Engine;
use evermap_schemas::Fault;
use png::{BitDepth, ColorType};
use resvg::{tiny_skia, usvg};

use crate::draw::Picture;

/// The picture as a PNG of its size.
///
/// # Errors
/// A bug fault for SVG that does not parse, a resource fault for a picture too large.
pub fn png(picture: &Picture) -> Result<Vec<u8>, Fault> {
    let options = usvg::Options::default();
    let tree = usvg::Tree::from_str(&picture.svg, &options)
        .map_err(|error| Fault::bug(format!("the picture's SVG does not parse: {error}")))?;
    let mut pixels =
        tiny_skia::Pixmap::new(picture.width_px, picture.height_px).ok_or_else(|| {
            Fault::resource(format!(
                "a picture of {} by {} pixels is too large",
                picture.width_px, picture.height_px
            ))
            .next("choose a smaller --width-px")
        })?;
    resvg::render(
        &tree,
        tiny_skia::Transform::identity(),
        &mut pixels.as_mut(),
    );
    pixels
        .encode_png()
        .map_err(|error| Fault::resource(format!("cannot encode the picture: {error}")))
}

/// A PNG of 8 bits a channel.
///
/// # Errors
/// A resource fault for a picture too large for the format.
pub fn encoded(width: u32, height: u32, colour: ColorType, bytes: &[u8]) -> Result<Vec<u8>, Fault> {
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, width, height);
    encoder.set_color(colour);
    let written = encoder.write_header().and_then(|mut writer| {
        writer.write_image_data(bytes)?;
        writer.finish()
    });
    written.map_err(|error| Fault::resource(format!("cannot encode a picture: {error}")))?;
    Ok(file)
}

/// Width, height and values of a PNG of 8 bits a channel, in these colours.
///
/// # Errors
/// A data fault for bytes that are no such PNG.
pub fn decoded(file: &[u8], colour: ColorType) -> Result<(u32, u32, Vec<u8>), Fault> {
    let damaged =
        |error: png::DecodingError| Fault::data(format!("the picture is damaged: {error}"));
    let mut decoder = png::Decoder::new(std::io::Cursor::new(file));
    decoder.set_transformations(png::Transformations::IDENTITY);
    let mut reader = decoder.read_info().map_err(damaged)?;
    let info = reader.info();
    let found = (info.color_type, info.bit_depth);
    let expected = (colour, BitDepth::Eight);
    if found != expected {
        return Err(Fault::data(format!(
            "expected a picture of {expected:?}, found {found:?}"
        )));
    }
    let (width, height) = (info.width, info.height);
    let mut bytes = vec![0; reader.output_buffer_size().unwrap_or(0)];
    reader.next_frame(&mut bytes).map_err(damaged)?;
    Ok((width, height, bytes))
}

/// Whether a PNG says that its pixels are red, green, blue and alpha; no more of it is looked at.
pub fn is_in_colour(file: &[u8]) -> bool {
    // Behind the signature, the chunk's length and name, width, height and the bits of a value.
    file.get(25) == Some(&(ColorType::Rgba as u8))
}

/// An image file as the address of itself, for SVG that refers to nothing else.
pub fn data_url(file: &[u8]) -> String {
    let is_png = file.starts_with(b"\x89PNG");
    let kind = if is_png { "png" } else { "jpeg" };
    let text = base64::engine::general_purpose::STANDARD.encode(file);
    format!("data:image/{kind};base64,{text}")
}
