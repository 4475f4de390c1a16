//! Letters as strokes, so that a picture needs no font: machines that draw maps often have none.

/// Height of letters in pictures, px.
pub const LETTER_PX: f64 = 9.0;

/// A unit of the glyph grid, of which a capital is 6 high.
const UNIT_PX: f64 = LETTER_PX / 6.0;
/// From one letter to the next, in units of the glyph grid.
const ADVANCE: f64 = 5.6;

/// Strokes of a glyph: points as two digits, column 0 to 4 and row 0 (top) to 6, or 8 below the line; `;` between
/// strokes.
fn glyph(letter: char) -> &'static str {
    match letter {
        'A' => "06 02 20 42 46;04 44",
        'B' => "03 33 42 41 30 00 06 36 45 44 33",
        'C' => "41 30 10 01 05 16 36 45",
        'D' => "00 06 26 44 42 20 00",
        'E' => "40 00 06 46;03 33",
        'F' => "40 00 06;03 33",
        'G' => "41 30 10 01 05 16 36 45 43 23",
        'H' => "00 06;40 46;03 43",
        'I' => "10 30;20 26;16 36",
        'J' => "40 45 36 16 05",
        'K' => "00 06;40 03 46",
        'L' => "00 06 46",
        'M' => "06 00 23 40 46",
        'N' => "06 00 46 40",
        'O' => "10 30 41 45 36 16 05 01 10",
        'P' => "06 00 30 41 42 33 03",
        'Q' => "10 30 41 45 36 16 05 01 10;34 46",
        'R' => "06 00 30 41 42 33 03;23 46",
        'S' => "41 30 10 01 02 13 33 44 45 36 16 05",
        'T' => "00 40;20 26",
        'U' => "00 05 16 36 45 40",
        'V' => "00 26 40",
        'W' => "00 16 23 36 40",
        'X' => "00 46;40 06",
        'Y' => "00 23 40;23 26",
        'Z' => "00 40 06 46",
        '0' => "10 30 41 45 36 16 05 01 10;41 05",
        '1' => "11 20 26;16 36",
        '2' => "01 10 30 41 42 06 46",
        '3' => "01 10 30 41 42 33 13;33 44 45 36 16 05",
        '4' => "36 30 04 44",
        '5' => "40 00 02 32 43 45 36 16 05",
        '6' => "41 30 10 01 05 16 36 45 44 33 03",
        '7' => "00 40 16",
        '8' => "10 30 41 42 33 13 02 01 10;13 04 05 16 36 45 44 33",
        '9' => "05 16 36 45 41 30 10 01 02 13 43",
        'a' => "43 32 12 03 05 16 36 45;42 46",
        'b' => "00 06;03 12 32 43 45 36 16 05",
        'c' => "43 32 12 03 05 16 36 45",
        'd' => "40 46;43 32 12 03 05 16 36 45",
        'e' => "04 44 43 32 12 03 05 16 36 45",
        'f' => "30 20 11 16;02 32",
        'g' => "43 32 12 03 05 16 36 45;42 47 38 18 07",
        'h' => "00 06;03 12 32 43 46",
        'i' => "22 26;20 21",
        'j' => "22 27 18 08;20 21",
        'k' => "00 06;42 04;23 46",
        'l' => "10 15 26 36",
        'm' => "06 02;03 12 23 26;23 32 43 46",
        'n' => "02 06;03 12 32 43 46",
        'o' => "12 32 43 45 36 16 05 03 12",
        'p' => "02 08;03 12 32 43 45 36 16 05",
        'q' => "42 48;43 32 12 03 05 16 36 45",
        'r' => "02 06;04 22 32 43",
        's' => "43 32 12 03 14 34 45 36 16 05",
        't' => "10 15 26 36;02 32",
        'u' => "02 05 16 36 45;42 46",
        'v' => "02 26 42",
        'w' => "02 16 23 36 42",
        'x' => "02 46;42 06",
        'y' => "02 26;42 18",
        'z' => "02 42 06 46",
        '-' => "13 33",
        '_' => "06 46",
        '.' => "25 26",
        ',' => "25 16",
        ':' => "21 22;24 25",
        '/' => "06 40",
        '+' => "21 25;03 43",
        '(' => "30 21 25 36",
        ')' => "10 21 25 16",
        '…' => "06 06;26 26;46 46",
        ' ' => "",
        _ => "10 30 36 16 10",
    }
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
        let others = "-_.,:/+()… ?".chars();
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
