//! Letters as strokes, so that a picture needs no font: machines that draw maps often have none.

/// Height of letters in pictures, px.
pub const LETTER_PX: f64 = 9.0;

/// A unit of the glyph grid, of which a capital is 6 high.
const UNIT_PX: f64 = LETTER_PX / 6.0;
/// From one letter to the next, in units of the glyph grid.
const ADVANCE: f64 = 5.6;

/// Letters and their glyphs, one a line.
const GLYPHS: &str = include_str!("strokes.txt");

/// Strokes of a glyph: points as two digits, column 0 to 4 and row 0 (top) to 6, or 8 below the line; `;` between
/// strokes.
fn glyph(letter: char) -> &'static str {
    if letter == ' ' {
        return "";
    }
    let mut glyphs = GLYPHS.lines();
    let found = glyphs.find_map(|glyph| glyph.strip_prefix(letter)?.strip_prefix(' '));
    found.unwrap_or("10 30 36 16 10")
}

/// The width of a text, px.
pub fn width(text: &str) -> f64 {
    let letters = text.chars().count() as f64;
    ((letters * ADVANCE) - (ADVANCE - 4.0)).max(0.0) * UNIT_PX
}

/// The path data of a text with its upper left corner at the origin.
pub fn letters(text: &str) -> String {
    let mut path = String::new();
    for (index, letter) in text.chars().enumerate() {
        let left = index as f64 * ADVANCE;
        for stroke in glyph(letter).split(';') {
            for (at, point) in stroke.split_whitespace().enumerate() {
                let mut digits = point
                    .bytes()
                    .map(|digit| f64::from(digit.wrapping_sub(b'0')));
                let (Some(column), Some(row)) = (digits.next(), digits.next()) else {
                    continue;
                };
                let command = if at == 0 { 'M' } else { 'L' };
                path.push_str(&format!(
                    "{command}{:.1} {:.1}",
                    (left + column) * UNIT_PX,
                    row * UNIT_PX
                ));
            }
        }
    }
    path
}

/// A text without the letters that XML forbids.
pub fn printable(text: &str) -> String {
    text.replace(char::is_control, " ")
}

/// A name, cut where it is longer than `most` letters.
pub fn name(text: &str, most: usize) -> String {
    if text.chars().count() <= most {
        return text.to_owned();
    }
    let kept = text.chars().take(most.saturating_sub(1));
    kept.chain(['…']).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_glyph_stays_in_its_box() {
        let others = "-_.,:/+()… ?%".chars();
        for letter in ('A'..='Z').chain('a'..='z').chain('0'..='9').chain(others) {
            for point in glyph(letter)
                .split([';', ' '])
                .filter(|point| !point.is_empty())
            {
                let bytes = point.as_bytes();
                assert!(
                    bytes.len() == 2
                        && (b'0'..=b'4').contains(&bytes[0])
                        && (b'0'..=b'8').contains(&bytes[1]),
                    "{letter}"
                );
            }
        }
    }

    #[test]
    fn names_are_cut_and_else_as_they_are() {
        assert_eq!(name("Revisit_1", 20), "Revisit_1");
        assert_eq!(name("abcdef", 4), "abc…");
        assert!(letters("L").contains("M0.0 0.0L0.0 9.0L6.0 9.0"));
        assert!((width("AB") - 14.4).abs() < 1e-9);
    }
}
