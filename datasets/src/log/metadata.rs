//! Whether a metadata record is sound: its texts, and keys that come once.

use std::collections::HashSet;

use evermap_schemas::Fault;
use mcap::records::op;

use crate::log::heads::LONGEST_NAME;
use crate::log::index::Unit;
use crate::log::record::{FRAME, frame};
use crate::log::window::{PIECE, Window};

/// Keys that are told apart; of further ones nobody says that they come twice.
const MOST_KEYS: usize = 1 << 20;

/// Reads a metadata record piece by piece: its name, shortened, or what is wrong with it.
///
/// # Errors
/// A resource fault when the store fails.
pub(crate) async fn named(
    window: &mut Window,
    unit: &Unit,
) -> Result<Result<String, String>, Fault> {
    let head = window.get(unit.offset, FRAME).await?.unwrap_or_default();
    let Some((op::METADATA, length)) = frame(&head) else {
        return Ok(Err(
            "expected a metadata record, found another one".to_owned()
        ));
    };
    if length > unit.length.saturating_sub(FRAME) {
        return Ok(Err("a record that is cut".to_owned()));
    }
    let mut position = unit.offset + FRAME;
    let end = position + length;
    let mut check = Check::of(length);
    while position < end {
        let piece = window.get(position, PIECE.min(end - position)).await?;
        let piece = piece.unwrap_or_default();
        if piece.is_empty() {
            break;
        }
        if let Err(detail) = check.add(&piece) {
            return Ok(Err(detail));
        }
        position += piece.len() as u64;
    }
    Ok(check.finish())
}

/// Checks the body of a metadata record.
///
/// # Errors
/// In words, what is wrong with it.
pub(crate) fn check(body: &[u8]) -> Result<(), String> {
    let mut check = Check::of(body.len() as u64);
    check.add(body)?;
    check.finish()?;
    Ok(())
}

/// What is gone through next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ParseState {
    Name,
    Entries,
    Key,
    Value,
    /// What a later version of the format may have behind the entries.
    Rest,
}

impl ParseState {
    fn text(self) -> &'static str {
        match self {
            ParseState::Name => "a name",
            ParseState::Entries => "entries",
            ParseState::Key => "a key",
            ParseState::Value | ParseState::Rest => "a value",
        }
    }
}

/// Goes through the body of a record, in pieces of any size.
struct Check {
    part: ParseState,
    /// The bytes of a length, as far as they came.
    length: Vec<u8>,
    /// The text that is gone through, behind its length.
    text: Option<Text>,
    /// Bytes that are to come: of the record, and from the first key on of its entries.
    left: u64,
    name: String,
    /// Digests of keys.
    keys: HashSet<[u8; 16]>,
}

impl Check {
    /// Of a body of so many bytes.
    fn of(left: u64) -> Self {
        Self {
            part: ParseState::Name,
            length: Vec::new(),
            text: None,
            left,
            name: String::new(),
            keys: HashSet::new(),
        }
    }

    fn add(&mut self, mut bytes: &[u8]) -> Result<(), String> {
        while !bytes.is_empty() && self.part != ParseState::Rest {
            bytes = match self.text.take() {
                Some(text) => self.go_on(text, bytes)?,
                None => self.begin(bytes)?,
            };
        }
        Ok(())
    }

    fn finish(self) -> Result<String, String> {
        match self.part {
            ParseState::Rest => Ok(self.name),
            part => Err(format!(
                "expected {}, found the end of the record",
                part.text()
            )),
        }
    }

    /// Reads a length, or a part of it; what lies behind.
    fn begin<'a>(&mut self, bytes: &'a [u8]) -> Result<&'a [u8], String> {
        let (length, rest) = bytes.split_at(bytes.len().min(4 - self.length.len()));
        self.length.extend(length);
        let Some(length) = self.length.first_chunk::<4>() else {
            return Ok(rest);
        };
        let length = u64::from(u32::from_le_bytes(*length));
        self.length.clear();
        let room = self.left.saturating_sub(4);
        if self.left < 4 || length > room {
            let part = self.part.text();
            return Err(format!(
                "expected {part} of at most {room} B, found a claim of {length} B"
            ));
        }
        self.left = room;
        if self.part == ParseState::Entries {
            self.left = length;
            self.part = ParseState::Key;
            self.end_entry();
            return Ok(rest);
        }
        self.left -= length;
        self.go_on(Text::of(length, self.part == ParseState::Key), rest)
    }

    /// Takes what there is of a text; what lies behind.
    fn go_on<'a>(&mut self, mut text: Text, bytes: &'a [u8]) -> Result<&'a [u8], String> {
        let most = usize::try_from(text.left).unwrap_or(usize::MAX);
        let (piece, rest) = bytes.split_at(bytes.len().min(most));
        if !text.add(piece) {
            let (part, shown) = (self.part.text(), &text.shown);
            return Err(format!(
                "expected {part} in UTF-8, found another one behind {shown:?}"
            ));
        }
        match text.left {
            0 => self.end(text)?,
            _ => self.text = Some(text),
        }
        Ok(rest)
    }

    /// Takes a text that is complete.
    fn end(&mut self, text: Text) -> Result<(), String> {
        match self.part {
            ParseState::Name => {
                self.name = text.shown;
                self.part = ParseState::Entries;
            }
            ParseState::Key => {
                self.part = ParseState::Value;
                let mut is_new = |key| self.keys.len() >= MOST_KEYS || self.keys.insert(key);
                if text.digest().is_some_and(|key| !is_new(key)) {
                    let shown = text.shown;
                    return Err(format!("expected each key once, found {shown:?} twice"));
                }
            }
            _ => {
                self.part = ParseState::Key;
                self.end_entry();
            }
        }
        Ok(())
    }

    fn end_entry(&mut self) {
        if self.left == 0 {
            self.part = ParseState::Rest;
        }
    }
}

/// A text that goes by.
struct Text {
    /// Bytes that are to come.
    left: u64,
    /// The first bytes of a letter whose others are to come.
    begun: Vec<u8>,
    /// Its first letters.
    shown: String,
    /// Of a key.
    hasher: Option<Box<blake3::Hasher>>,
}

impl Text {
    fn of(left: u64, is_key: bool) -> Self {
        Self {
            left,
            begun: Vec::new(),
            shown: String::new(),
            hasher: is_key.then(Box::default),
        }
    }

    /// Takes the next bytes; whether it is UTF-8 so far.
    fn add(&mut self, piece: &[u8]) -> bool {
        if let Some(hasher) = &mut self.hasher {
            hasher.update(piece);
        }
        self.left = self.left.saturating_sub(piece.len() as u64);
        let mut bytes = std::mem::take(&mut self.begun);
        bytes.extend(piece);
        let sound = match std::str::from_utf8(&bytes) {
            Ok(_) => bytes.len(),
            Err(error) => error.valid_up_to(),
        };
        let (letters, begun) = bytes.split_at(sound);
        self.show(&String::from_utf8_lossy(letters));
        self.begun = begun.to_vec();
        // A letter has at most four bytes.
        let goes_on = std::str::from_utf8(begun).is_err_and(|error| error.error_len().is_none());
        begun.is_empty() || (goes_on && self.left > 0)
    }

    fn show(&mut self, letters: &str) {
        let room = LONGEST_NAME - self.shown.chars().count();
        self.shown.extend(letters.chars().take(room));
    }

    /// Of a key.
    fn digest(&self) -> Option<[u8; 16]> {
        let digest = self.hasher.as_ref()?.finalize();
        digest.as_bytes().first_chunk().copied()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn text(bytes: &[u8]) -> Vec<u8> {
        [&(bytes.len() as u32).to_le_bytes(), bytes].concat()
    }

    fn record(name: &[u8], texts: &[&[u8]]) -> Vec<u8> {
        let entries: Vec<u8> = texts.iter().flat_map(|bytes| text(bytes)).collect();
        [text(name), text(&entries)].concat()
    }

    /// What comes of a body in pieces of so many bytes.
    fn found(body: &[u8], piece: usize) -> Result<String, String> {
        let mut check = Check::of(body.len() as u64);
        for piece in body.chunks(piece) {
            check.add(piece)?;
        }
        check.finish()
    }

    #[test]
    fn what_is_wrong_is_said_in_pieces_of_any_size() {
        let sound = record("größe".as_bytes(), &[b"", b"", "é".as_bytes(), b"x"]);
        let padded = [&sound[..], b"of a later version"].concat();
        let empty = record(b"", &[]);
        let twice = record(b"n", &[b"1", b"road", b"2", b"car", b"1", b"tree"]);
        let mut claim = record(b"n", &[b"1", b"road"]);
        claim[5] = 99;
        let beyond = [text(b"n"), text(&[9, 0, 0, 0, b'1'])].concat();
        let no_value = [record(b"n", &[b"1"]), text(b"behind")].concat();
        let no_text = record(b"n", &[b"k", b"a\xff"]);
        let half = record(b"n\xc3", &[]);
        let cases = [
            (sound, Ok("größe")),
            (padded, Ok("größe")),
            (empty, Ok("")),
            (twice, Err("expected each key once, found \"1\" twice")),
            (
                claim,
                Err("expected entries of at most 13 B, found a claim of 99 B"),
            ),
            (
                beyond,
                Err("expected a key of at most 1 B, found a claim of 9 B"),
            ),
            (
                no_value,
                Err("expected a value of at most 0 B, found a claim of 6 B"),
            ),
            (
                no_text,
                Err("expected a value in UTF-8, found another one behind \"a\""),
            ),
            (
                half,
                Err("expected a name in UTF-8, found another one behind \"n\""),
            ),
            (
                text(b"n"),
                Err("expected entries, found the end of the record"),
            ),
        ];
        for (body, expected) in cases {
            let expected = expected.map(str::to_owned).map_err(str::to_owned);
            for piece in [1, 2, 3, 5, 1000] {
                assert_eq!(found(&body, piece), expected, "{body:?} by {piece} B");
            }
        }
    }

    #[test]
    fn names_are_kept_in_part_and_bodies_are_read_as_far_as_they_go() {
        let long = "é".repeat(100_000);
        let body = record(long.as_bytes(), &[]);
        assert_eq!(found(&body, 999).unwrap(), "é".repeat(LONGEST_NAME));
        for length in 0..40 {
            found(&body[..length], 7).unwrap_err();
        }
    }
}
