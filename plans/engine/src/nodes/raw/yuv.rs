//! Luma and chroma, as cameras have them: ITU-R BT.601, limited range (luma 16 to 235).

use evermap_video::Colours;

/// Where the samples lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Packing {
    /// Two pixels in four bytes: u, y, v, y.
    Uyvy,
    /// Two pixels in four bytes: y, u, y, v.
    Yuyv,
    /// A plane of y, then u and v in turn for every two by two pixels.
    Nv12,
    /// As [`Packing::Nv12`], v before u.
    Nv21,
    /// A plane of y, then u and v in turn for every pixel.
    Nv24,
}

impl Packing {
    /// Bytes that a row of pixels takes.
    pub fn row(self, width: usize) -> usize {
        match self {
            Self::Uyvy | Self::Yuyv => width.next_multiple_of(2).saturating_mul(2),
            Self::Nv12 | Self::Nv21 => width.next_multiple_of(2),
            Self::Nv24 => width,
        }
    }

    /// Rows of bytes that so many rows of pixels take.
    pub fn lines(self, height: usize) -> usize {
        match self {
            Self::Uyvy | Self::Yuyv => height,
            Self::Nv12 | Self::Nv21 => height + height.div_ceil(2),
            Self::Nv24 => height.saturating_mul(3),
        }
    }

    /// Appends RGB.
    pub fn write(self, bytes: &[u8], [width, height]: [usize; 2], step: usize, file: &mut Vec<u8>) {
        let chroma = height * step;
        for y in 0..height {
            for x in 0..width {
                let line = y * step;
                let pair = line + x / 2 * 4;
                let [luma, u, v] = match self {
                    Self::Uyvy => [line + 2 * x + 1, pair, pair + 2],
                    Self::Yuyv => [line + 2 * x, pair + 1, pair + 3],
                    Self::Nv12 | Self::Nv21 => {
                        let block = chroma + y / 2 * step + x / 2 * 2;
                        let first = usize::from(self == Self::Nv21);
                        [line + x, block + first, block + 1 - first]
                    }
                    // Two bytes a pixel: a row of chroma takes two rows of bytes.
                    Self::Nv24 => {
                        let block = chroma + y * 2 * step + 2 * x;
                        [line + x, block, block + 1]
                    }
                };
                file.extend(Colours::USUAL.rgb([bytes[luma], bytes[u], bytes[v]]));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_packing_gives_the_same_pixels() {
        // Four by two pixels: left half red, right half blue.
        let (red, blue) = ([65, 100, 212], [35, 212, 114]);
        let [ly, lu, lv] = red;
        let [ry, ru, rv] = blue;
        let luma = [ly, ly, ry, ry].repeat(2);
        let cases = [
            (Packing::Uyvy, 8, [lu, ly, lv, ly, ru, ry, rv, ry].repeat(2)),
            (Packing::Yuyv, 8, [ly, lu, ly, lv, ry, ru, ry, rv].repeat(2)),
            (Packing::Nv12, 4, [&luma[..], &[lu, lv, ru, rv]].concat()),
            (Packing::Nv21, 4, [&luma[..], &[lv, lu, rv, ru]].concat()),
            (
                Packing::Nv24,
                4,
                [&luma[..], &[lu, lv, lu, lv, ru, rv, ru, rv].repeat(2)].concat(),
            ),
        ];
        let rgb = |yuv| Colours::USUAL.rgb(yuv);
        let expected = [rgb(red), rgb(red), rgb(blue), rgb(blue)]
            .concat()
            .repeat(2);
        for (packing, step, bytes) in cases {
            assert_eq!(packing.row(4), step);
            assert_eq!(bytes.len(), step * packing.lines(2), "{packing:?}");
            let mut file = Vec::new();
            packing.write(&bytes, [4, 2], step, &mut file);
            assert_eq!(file, expected, "{packing:?}");
        }
    }
}
