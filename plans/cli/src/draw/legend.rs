//! Which colour stands for what: names side by side above pictures of labels, in as many lines as they take.

use crate::draw::{colours, strokes};

/// Height of a legend of one line, px.
const ONE_LINE_PX: u32 = 34;
/// From one line to the next, px.
const LINE_PX: u32 = 18;
/// Between the legend and the picture's edges, px.
const MARGIN_PX: f64 = 11.0;
/// From where a name's colour begins to the name, px.
pub const NAME_PX: f64 = strokes::LETTER_PX * 1.6;
/// Between a name and the next one's colour, px.
const BETWEEN_PX: f64 = strokes::LETTER_PX * 2.0;
/// Letters of a name.
const MOST_LETTERS: usize = 20;

/// A legend, as `templates/legend.svg` draws it.
pub struct Legend {
    /// Width, px: as asked for, or as the longest name takes.
    pub width: u32,
    /// Height, px.
    pub height: u32,
    /// What it names.
    pub names: Vec<Caption>,
}

/// A name in a legend.
pub struct Caption {
    /// The name.
    pub name: String,
    /// Its colour.
    pub colour: String,
    /// Where it begins, px.
    pub x: f64,
    /// Its line.
    pub line: u32,
}

impl Caption {
    /// Its upper edge, px.
    pub fn y(&self) -> f64 {
        12.5 + f64::from(self.line * LINE_PX)
    }
}

impl Legend {
    /// Of classes, in the order of their colours.
    pub fn of_classes(classes: &[String], width: u32) -> Self {
        let colours = (0..classes.len()).map(colours::class);
        Self::of(classes.iter().cloned().zip(colours), width)
    }

    /// Of names with their colours, of at least this width (px).
    pub fn of(named: impl IntoIterator<Item = (String, String)>, width: u32) -> Self {
        let named: Vec<(String, String)> = named
            .into_iter()
            .map(|(name, colour)| (strokes::name(&name, MOST_LETTERS), colour))
            .collect();
        let wide = |name: &str| NAME_PX + strokes::width(name);
        let widths = named.iter().map(|(name, _)| wide(name));
        let widest = widths.fold(0.0, f64::max) + 2.0 * MARGIN_PX;
        let width = width.max(widest.ceil() as u32);
        let (mut x, mut line) = (MARGIN_PX, 0);
        let mut names = Vec::with_capacity(named.len());
        for (name, colour) in named {
            let wide = wide(&name);
            if x > MARGIN_PX && x + wide > f64::from(width) - MARGIN_PX {
                (x, line) = (MARGIN_PX, line + 1);
            }
            names.push(Caption {
                name,
                colour,
                x,
                line,
            });
            x += wide + BETWEEN_PX;
        }
        Self {
            width,
            height: ONE_LINE_PX + line * LINE_PX,
            names,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_legend_has_as_many_lines_as_its_names_take() {
        let names = "building car fence person pole road sidewalk sky tree";
        let classes: Vec<String> = names.split(' ').map(str::to_owned).collect();
        let legend = Legend::of_classes(&classes, 256);
        assert_eq!((legend.width, legend.names.len()), (256, classes.len()));
        for (one, next) in legend.names.iter().zip(&legend.names[1..]) {
            let end = one.x + NAME_PX + strokes::width(&one.name);
            assert!(one.x >= MARGIN_PX && end <= 256.0 - MARGIN_PX, "{end}");
            let goes_on = one.line == next.line && end < next.x;
            assert!(goes_on || next.line == one.line + 1 && next.x == MARGIN_PX);
        }
        let last = &legend.names[8];
        assert!(last.line > 0 && last.x + NAME_PX + strokes::width("tree") <= 256.0 - MARGIN_PX);
        assert!(last.y() + strokes::LETTER_PX < f64::from(legend.height));
        // There is room for all of them in one line of a wide picture.
        let wide = Legend::of_classes(&classes, 1024);
        assert!(wide.names.iter().all(|named| named.line == 0));
        assert_eq!(wide.height, ONE_LINE_PX);
    }

    #[test]
    fn a_legend_is_as_wide_as_its_longest_name() {
        let named = ["tree", "sky"].map(|name| (name.to_owned(), "#000000".to_owned()));
        assert_eq!(Legend::of(named, 1).width, 68);
    }
}
