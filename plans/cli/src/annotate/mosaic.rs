//! Where the pixels of a mosaic are in the map, as its world file says.

use std::fmt::Display;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use evermap_datasets::no_file;
use evermap_schemas::Fault;

use crate::earth::beside;

/// A mosaic that annotations are of.
#[derive(Debug, Clone)]
pub struct Picture {
    /// The name of its file.
    pub name: String,
    /// Width and height, px.
    pub size: [u32; 2],
    /// Where it is in the map.
    reference: WorldFile,
    /// From metres to pixels.
    inverse: WorldFile,
}

impl Picture {
    /// A PNG with its world file beside it.
    ///
    /// # Errors
    /// A user fault where either is missing, or not what it is named.
    pub fn read(path: &Path) -> Result<Self, Fault> {
        let at = |fault: Fault| fault.at(path.display());
        let unread =
            |found: &dyn Display| at(Fault::user(format!("expected a mosaic, found {found}")));
        if let Some(kind) = no_file(path).map_err(|error| unread(&error))? {
            return Err(unread(&kind));
        }
        let file = File::open(path).map_err(|error| unread(&error))?;
        let header = png::Decoder::new(BufReader::new(file)).read_info();
        let header =
            header.map_err(|error| at(Fault::user(format!("expected a PNG, found {error}"))))?;
        let name = path.file_name().unwrap_or_default();
        let reference = WorldFile::read(path)?;
        Ok(Self {
            name: name.to_string_lossy().into_owned(),
            size: [header.info().width, header.info().height],
            inverse: reference.inverse(),
            reference,
        })
    }

    /// The place of pixel coordinates, m.
    pub fn place(&self, pixel: [f64; 2]) -> [f64; 2] {
        self.reference.place(pixel)
    }

    /// The longer side of a pixel, m.
    pub fn pixel_m(&self) -> f64 {
        let WorldFile { x, y } = self.reference;
        let [column, row] = [0, 1].map(|axis| x[axis].hypot(y[axis]));
        column.max(row)
    }

    /// The pixel coordinates of a place.
    pub fn pixel(&self, place: [f64; 2]) -> [f64; 2] {
        self.inverse.turned(place).map(|value| value + 0.5)
    }
}

/// An affine map from pixels to metres. Pixel coordinates begin at the corner of the picture, as annotation programs have
/// them; a world file is about the centres of pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
struct WorldFile {
    /// x = a · column + b · row + c, m.
    x: [f64; 3],
    /// y = d · column + e · row + f, m.
    y: [f64; 3],
}

impl WorldFile {
    /// Of the world file beside a picture, or the world file itself.
    ///
    /// # Errors
    /// A user fault where there is none, or it is not six numbers that make sense.
    fn read(picture: &Path) -> Result<Self, Fault> {
        let earth = beside(picture);
        if earth.exists() {
            return Err(Fault::user(
                "expected a mosaic in the map's metres, found one that lies on earth",
            )
            .at(earth.display())
            .next("`evermap export overhead_tiles --format png --local` writes the former"));
        }
        let path = picture.with_extension("pgw");
        let at = |fault: Fault| fault.at(path.display());
        let text = evermap_datasets::read_text(&path).map_err(|error| {
            at(Fault::user(format!("expected a world file, found {error}"))
                .next("`evermap export overhead_tiles --format png` writes it beside the picture"))
        })?;
        Self::parse(&text).ok_or_else(|| {
            at(Fault::user(
                "expected the six numbers of a world file, of pixels that have a size",
            ))
        })
    }

    /// Six numbers, one a line: a, d, b, e, and the centre of the first pixel.
    fn parse(text: &str) -> Option<Self> {
        let numbers: Option<Vec<f64>> = text
            .split_whitespace()
            .map(|word| word.parse().ok())
            .collect();
        let [a, d, b, e, c, f]: [f64; 6] = numbers?.try_into().ok()?;
        let sound = [a, d, b, e, c, f].iter().all(|number| number.is_finite());
        (sound && a * e - b * d != 0.0).then_some(Self {
            x: [a, b, c],
            y: [d, e, f],
        })
    }

    /// The place of pixel coordinates, m.
    fn place(&self, pixel: [f64; 2]) -> [f64; 2] {
        self.turned(pixel.map(|value| value - 0.5))
    }

    /// As the world file has it, of the centres of pixels.
    fn turned(&self, [column, row]: [f64; 2]) -> [f64; 2] {
        [self.x, self.y].map(|[by_column, by_row, first]| by_column * column + by_row * row + first)
    }

    /// The way back. Its determinant is not zero.
    fn inverse(&self) -> Self {
        let ([a, b, c], [d, e, f]) = (self.x, self.y);
        let by = 1.0 / (a * e - b * d);
        Self {
            x: [e * by, -b * by, (b * f - c * e) * by],
            y: [-d * by, a * by, (c * d - a * f) * by],
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use evermap_algorithms::ground::channels::Pixels;

    #[test]
    fn an_exported_mosaic_lies_where_its_world_file_says() {
        let mosaic = crate::mosaic::Mosaic {
            cell_m: 0.1,
            west: -12.8,
            north: 25.6,
            width: 4,
            height: 2,
            cells: Pixels::Grey(vec![[0, 0]; 8]),
        };
        let found = WorldFile::parse(&mosaic.world_file(None)).unwrap();
        for (pixel, place) in [([0.0, 0.0], [-12.8, 25.6]), ([4.0, 2.0], [-12.4, 25.4])] {
            let [x, y] = found.place(pixel);
            assert!((x - place[0]).abs() < 1e-9 && (y - place[1]).abs() < 1e-9);
            let [column, row] = found.inverse().turned(place).map(|value| value + 0.5);
            assert!((column - pixel[0]).abs() < 1e-9 && (row - pixel[1]).abs() < 1e-9);
        }
    }

    /// Reading a pipe would wait for ever.
    #[test]
    fn a_mosaic_is_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("lot.png");
        let made = std::process::Command::new("mkfifo").arg(&pipe).status();
        assert!(made.unwrap().success());
        for (path, expected) in [
            (pipe.as_path(), "expected a mosaic, found a named pipe"),
            (folder.path(), "expected a mosaic, found a folder"),
        ] {
            let fault = Picture::read(path).unwrap_err().to_string();
            assert!(fault.contains(expected), "{fault}");
        }
    }

    #[test]
    fn corners_of_pixels_are_half_a_pixel_from_their_centres() {
        let found = WorldFile::parse("0.05\n0\n0\n-0.05\n10.025\n19.975\n").unwrap();
        let [x, y] = found.place([0.0, 0.0]);
        assert!((x - 10.0).abs() < 1e-12 && (y - 20.0).abs() < 1e-12);
        let [x, y] = found.place([100.0, 40.0]);
        assert!((x - 15.0).abs() < 1e-12 && (y - 18.0).abs() < 1e-12);
        for text in [
            "",
            "1 0 0 1 2",
            "1 0 0 x 2 3",
            "0 0 0 1 2 3",
            "1 0 0 inf 2 3",
        ] {
            assert_eq!(WorldFile::parse(text), None, "{text}");
        }
    }
}
