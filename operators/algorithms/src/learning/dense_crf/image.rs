//! Colour images as the field's appearance kernel sees them.

/// An 8-bit colour image: three channels per pixel, interleaved, rows without gaps. Their order does not matter.
#[derive(Debug, Clone, Copy)]
pub struct ColourView<'a> {
    width: usize,
    height: usize,
    pixels: &'a [[u8; 3]],
}

impl<'a> ColourView<'a> {
    /// A view of `3 · width · height` bytes; `None` for any other number of them, and for none.
    pub fn new(width: u32, height: u32, data: &'a [u8]) -> Option<Self> {
        let (width, height) = (width as usize, height as usize);
        let (pixels, rest) = data.as_chunks();
        let fits = width.checked_mul(height) == Some(pixels.len()) && rest.is_empty();
        (fits && !pixels.is_empty()).then_some(Self {
            width,
            height,
            pixels,
        })
    }

    /// Width (px).
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height (px).
    pub fn height(&self) -> usize {
        self.height
    }

    /// The pixels, row by row.
    pub fn pixels(&self) -> &'a [[u8; 3]] {
        self.pixels
    }
}
