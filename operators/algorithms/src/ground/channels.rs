//! What images show of a pixel or a cell: how bright it is, or its colour.

/// Values of a pixel or a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Channels {
    /// How bright it is.
    Grey,
    /// Red, green and blue, side by side.
    Colour,
}

impl Channels {
    /// How many values there are of each.
    pub fn count(self) -> usize {
        match self {
            Self::Grey => 1,
            Self::Colour => 3,
        }
    }
}

/// The pixels of a picture of the ground, the northernmost row first. Alpha is 0 where nothing was seen.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Pixels {
    /// Grey, and alpha.
    Grey(Vec<[u8; 2]>),
    /// Red, green, blue, and alpha.
    Colour(Vec<[u8; 4]>),
}

impl Pixels {
    /// How many there are.
    pub fn count(&self) -> usize {
        match self {
            Self::Grey(pixels) => pixels.len(),
            Self::Colour(pixels) => pixels.len(),
        }
    }
}

/// Red, green and blue, cell by cell; of cells that all are grey one value each, as of images that never had a colour.
pub fn plainest(colours: Vec<u8>) -> Vec<u8> {
    let (cells, _) = colours.as_chunks::<3>();
    let is_grey = |[red, green, blue]: &[u8; 3]| red == green && green == blue;
    if cells.iter().all(is_grey) {
        cells.iter().map(|[grey, ..]| *grey).collect()
    } else {
        colours
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_cell_in_colour_is_enough() {
        assert_eq!(plainest(vec![7, 7, 7, 9, 9, 9]), [7, 9]);
        assert_eq!(plainest(vec![7, 7, 7, 9, 9, 8]), [7, 7, 7, 9, 9, 8]);
        assert!(plainest(Vec::new()).is_empty());
    }
}
