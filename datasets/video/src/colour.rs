//! Luma and chroma to red, green and blue, in integers, so that bytes are equal everywhere.

/// What the samples of luma and chroma mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Colours {
    /// Which colours the chroma stands for.
    pub matrix: Matrix,
    /// Which samples are black and white.
    pub scale: Scale,
}

/// Weights of the colours in luma and chroma.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Matrix {
    /// ITU-R BT.601: cameras, and streams that name none.
    Bt601,
    /// ITU-R BT.709.
    Bt709,
}

/// Samples of black and white.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    /// Luma 16 to 235, chroma 16 to 240.
    Limited,
    /// 0 to 255, as in JPEG.
    Full,
}

impl Colours {
    /// What raw images of cameras and streams that say nothing mean.
    pub const USUAL: Self = Self {
        matrix: Matrix::Bt601,
        scale: Scale::Limited,
    };

    /// Red, green and blue of luma and the two chroma samples, with 8 bits of fraction.
    pub fn rgb(self, [luma, u, v]: [u8; 3]) -> [u8; 3] {
        let (black, gain, [red_v, green_u, green_v, blue_u]) = match (self.matrix, self.scale) {
            (Matrix::Bt601, Scale::Limited) => (16, 298, [409, 100, 208, 516]),
            (Matrix::Bt709, Scale::Limited) => (16, 298, [459, 55, 136, 541]),
            (Matrix::Bt601, Scale::Full) => (0, 256, [359, 88, 183, 454]),
            (Matrix::Bt709, Scale::Full) => (0, 256, [403, 48, 120, 475]),
        };
        let luma = gain * (i32::from(luma) - black) + 128;
        let (u, v) = (i32::from(u) - 128, i32::from(v) - 128);
        [
            luma + red_v * v,
            luma - green_u * u - green_v * v,
            luma + blue_u * u,
        ]
        .map(|value| (value >> 8).clamp(0, 255) as u8)
    }

    /// Luma and chroma of red, green and blue as [`Colours::USUAL`] reads them: what the encoder of tests writes.
    pub fn usual_yuv([red, green, blue]: [u8; 3]) -> [u8; 3] {
        let (red, green, blue) = (i32::from(red), i32::from(green), i32::from(blue));
        let of = |[r, g, b]: [i32; 3], zero: i32| {
            (((r * red + g * green + b * blue + 128) >> 8) + zero).clamp(0, 255) as u8
        };
        [
            of([66, 129, 25], 16),
            of([-38, -74, 112], 128),
            of([112, -94, -18], 128),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values of the 75 % bars of ITU-R BT.601: luma and chroma, colour.
    const BARS: [([u8; 3], [u8; 3]); 5] = [
        ([16, 128, 128], [0, 0, 0]),
        ([235, 128, 128], [255, 255, 255]),
        ([65, 100, 212], [191, 0, 0]),
        ([112, 72, 58], [0, 191, 0]),
        ([35, 212, 114], [0, 0, 191]),
    ];

    fn near(found: [u8; 3], expected: [u8; 3]) -> bool {
        found.iter().zip(expected).all(|(a, b)| a.abs_diff(b) <= 2)
    }

    #[test]
    fn the_colours_of_the_standard() {
        for (yuv, rgb) in BARS {
            let found = Colours::USUAL.rgb(yuv);
            assert!(near(found, rgb), "{yuv:?}: {found:?}");
            let back = Colours::usual_yuv(rgb);
            assert!(near(back, yuv), "{rgb:?}: {back:?}");
        }
        // Red of BT.709 in limited and of BT.601 in full range.
        for (matrix, scale, red) in [
            (Matrix::Bt709, Scale::Limited, [63, 102, 240]),
            (Matrix::Bt601, Scale::Full, [76, 85, 255]),
            (Matrix::Bt709, Scale::Full, [54, 99, 255]),
        ] {
            let found = Colours { matrix, scale }.rgb(red);
            assert!(near(found, [255, 0, 0]), "{matrix:?} {scale:?}: {found:?}");
        }
    }
}
