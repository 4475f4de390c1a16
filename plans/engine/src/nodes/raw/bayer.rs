//! Mosaics of one colour a pixel, as most sensors have them.

/// Which colour each pixel of a two by two block has: 0 red, 1 green, 2 blue; rows from the top.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Mosaic([[usize; 2]; 2]);

impl Mosaic {
    /// The mosaic of an encoding (`bayer_rggb8`, `bayer_gbrg16`), and the bytes of a sample.
    pub fn named(encoding: &str) -> Option<(Self, usize)> {
        let (colours, bits) = encoding.strip_prefix("bayer_")?.split_at_checked(4)?;
        let colours = match colours {
            "rggb" => [[0, 1], [1, 2]],
            "bggr" => [[2, 1], [1, 0]],
            "gbrg" => [[1, 2], [0, 1]],
            "grbg" => [[1, 0], [2, 1]],
            _ => return None,
        };
        match bits {
            "8" => Some((Self(colours), 1)),
            "16" => Some((Self(colours), 2)),
            _ => None,
        }
    }

    /// Appends RGB: each pixel keeps its own colour and has the mean of its neighbours' for the other two (bilinear
    /// demosaicing). Samples of two bytes are read little endian and written big endian.
    pub fn write(
        self,
        bytes: &[u8],
        [width, height]: [usize; 2],
        step: usize,
        sample: usize,
        file: &mut Vec<u8>,
    ) {
        let at = |x: usize, y: usize| {
            let place = y * step + x * sample;
            match sample {
                1 => u32::from(bytes[place]),
                _ => u32::from(u16::from_le_bytes([bytes[place], bytes[place + 1]])),
            }
        };
        for y in 0..height {
            for x in 0..width {
                let (mut sums, mut counts) = ([0; 3], [0; 3]);
                for near_y in y.saturating_sub(1)..(y + 2).min(height) {
                    for near_x in x.saturating_sub(1)..(x + 2).min(width) {
                        let colour = self.0[near_y % 2][near_x % 2];
                        sums[colour] += at(near_x, near_y);
                        counts[colour] += 1;
                    }
                }
                let own = self.0[y % 2][x % 2];
                (sums[own], counts[own]) = (at(x, y), 1);
                for (sum, count) in sums.into_iter().zip(counts) {
                    // A colour that is nowhere near, in an image of one row or column, is dark.
                    let value = (sum + count / 2).checked_div(count).unwrap_or(0);
                    match sample {
                        1 => file.push(value as u8),
                        _ => file.extend((value as u16).to_be_bytes()),
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The mosaic of a plain colour.
    fn mosaic(encoding: &str, colour: [u16; 3]) -> Vec<u8> {
        let Some((mosaic, sample)) = Mosaic::named(encoding) else {
            return Vec::new();
        };
        let mut bytes = Vec::new();
        for y in 0..4 {
            for x in 0..6 {
                let value = colour[mosaic.0[y % 2][x % 2]].to_le_bytes();
                bytes.extend(&value[..sample]);
            }
        }
        let mut file = Vec::new();
        mosaic.write(&bytes, [6, 4], 6 * sample, sample, &mut file);
        file
    }

    #[test]
    fn a_plain_colour_is_found_at_every_pixel_of_every_mosaic() {
        for order in ["rggb", "bggr", "gbrg", "grbg"] {
            let file = mosaic(&format!("bayer_{order}8"), [10, 200, 30]);
            assert_eq!(file, [10, 200, 30].repeat(24), "{order}");
            let file = mosaic(&format!("bayer_{order}16"), [0x0102, 0x0304, 0xfffe]);
            assert_eq!(file, [1, 2, 3, 4, 0xff, 0xfe].repeat(24), "{order}");
        }
        assert_eq!(Mosaic::named("bayer_rgbg8"), None);
        assert_eq!(Mosaic::named("bayer_rggb12"), None);
    }

    #[test]
    fn between_two_reds_is_their_mean() {
        let Some((mosaic, _)) = Mosaic::named("bayer_rggb8") else {
            return;
        };
        let mut file = Vec::new();
        mosaic.write(&[10, 0, 21, 0, 0, 0], [3, 2], 3, 1, &mut file);
        assert_eq!(file[3], 16, "{file:?}");
    }
}
