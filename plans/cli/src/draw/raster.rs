//! From SVG to PNG.

use evermap_schemas::Fault;
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
