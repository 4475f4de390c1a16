//! The image types, and what can be wrong with bytes that claim to be one.

/// Larger images are refused before anything is allocated for them: 2²⁷ pixels, 16384 × 8192.
pub const MAX_PIXELS: u64 = 1 << 27;

/// Scans that a JPEG has at most; each costs as much as the image is large, however few bytes it has. libjpeg's progressions have
/// 10 in colour and 18 at most; libjpeg-turbo's fuzzers stop at 500, and zune-jpeg, where scans are progressive, here.
pub(crate) const MAX_SCANS: usize = 100;

/// A grey image: 8 bits per pixel, row by row from the top, without gaps between rows.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Grey {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height` values.
    pub data: Vec<u8>,
}

impl Grey {
    /// The value of the pixel nearest to `[u, v]`, (0, 0) being the centre of the first; `None` outside.
    pub fn at(&self, pixel: [f64; 2]) -> Option<u8> {
        let [column, row] = pixel.map(f64::round);
        let inside = column >= 0.0 && column < f64::from(self.width) && row >= 0.0;
        let index = || row as usize * self.width as usize + column as usize;
        inside
            .then(index)
            .and_then(|index| self.data.get(index).copied())
    }

    /// Resizes to black pixels. The buffer is kept where it is large enough.
    pub(crate) fn reset(&mut self, width: u32, height: u32) -> Result<(), ImageError> {
        let pixels = checked_pixels(width, height)?;
        self.data.clear();
        self.data.resize(pixels, 0);
        (self.width, self.height) = (width, height);
        Ok(())
    }
}

/// A colour image: red, green, blue of 8 bits each per pixel, row by row from the top, without gaps between rows.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Rgb {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `3 * width * height` values.
    pub data: Vec<u8>,
}

impl Rgb {
    /// Resizes to black pixels. The buffer is kept where it is large enough.
    pub(crate) fn reset(&mut self, width: u32, height: u32) -> Result<(), ImageError> {
        let pixels = checked_pixels(width, height)?;
        self.data.clear();
        self.data.resize(3 * pixels, 0);
        (self.width, self.height) = (width, height);
        Ok(())
    }
}

/// An image of 16-bit values, such as a depth image: row by row from the top, without gaps between rows.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Grey16 {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height` values.
    pub data: Vec<u16>,
}

/// The number of pixels of an image of this size.
pub(crate) fn checked_pixels(width: u32, height: u32) -> Result<usize, ImageError> {
    let pixels = u64::from(width) * u64::from(height);
    if pixels == 0 || pixels > MAX_PIXELS {
        return Err(ImageError::Size { width, height });
    }
    usize::try_from(pixels).map_err(|_| ImageError::Size { width, height })
}

/// Why bytes are not an image.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ImageError {
    /// The bytes start like no image that is read.
    #[error("expected a jpeg, png or pnm image, found {found}; record images as JPEG or PNG")]
    Format {
        /// What was found instead.
        found: String,
    },
    /// The header claims an image of no size, or of too many pixels.
    #[error("expected 1 to {MAX_PIXELS} pixels, found a header of {width} x {height}")]
    Size {
        /// Width in the header.
        width: u32,
        /// Height in the header.
        height: u32,
    },
    /// The header is sound, the rest is not: truncated or damaged.
    #[error("{format} image of {bytes} bytes is truncated or damaged")]
    Damaged {
        /// What the header says it is.
        format: &'static str,
        /// Length of the data.
        bytes: usize,
    },
    /// A JPEG would be gone through too often.
    #[error("expected a jpeg of at most {MAX_SCANS} scans, found {found}")]
    Scans {
        /// How many there are.
        found: usize,
    },
    /// A picture of 16 bits whose values do not reach the upper four: of a camera of 10 or 12 bits, most likely. The upper
    /// eight hold next to nothing.
    #[error(
        "expected values that fill their 16 bits, found none above {most}; say how many bits raw ones have (`bits` in a session manifest), or record them shifted to the upper bits, or as 8 bits"
    )]
    Faint {
        /// The most that as many bits hold as the largest value has.
        most: u16,
    },
    /// Samples of floating point, as raw range images have them: no picture.
    #[error(
        "expected a picture, found samples of floating point, as range images have; give their topic to `depth_frames`, and not to `frames`, by `roles` in a session manifest"
    )]
    Float,
    /// An image of which the stored values are wanted does not store one value per pixel.
    #[error("expected a png or pgm with one value per pixel, found {found}")]
    Values {
        /// What was found instead.
        found: String,
    },
    /// OpenCV failed in a way that none of the above explains.
    #[error("OpenCV: {message}")]
    OpenCv {
        /// OpenCV's words.
        message: String,
    },
}

impl ImageError {
    /// Why, in words that tell no image from others of its kind: a few sentences, under which images can be counted.
    pub fn kind(&self) -> String {
        match self {
            Self::Format { .. } => {
                "expected a jpeg, png or pnm image; record images as JPEG or PNG".to_owned()
            }
            Self::Size { .. } => format!("expected 1 to {MAX_PIXELS} pixels"),
            Self::Damaged { format, .. } => format!("{format} image is truncated or damaged"),
            Self::Scans { .. } => format!("expected a jpeg of at most {MAX_SCANS} scans"),
            Self::Values { .. } => "expected one value per pixel".to_owned(),
            Self::OpenCv { .. } => "OpenCV refuses it".to_owned(),
            Self::Faint { .. } | Self::Float => self.to_string(),
        }
    }
}

impl From<opencv::Error> for ImageError {
    fn from(error: opencv::Error) -> Self {
        Self::OpenCv {
            message: error.message,
        }
    }
}
