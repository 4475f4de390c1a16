//! Labels to and from other programs.
//!
//! ```text
//!   GeoJSON ─────────────────► features ─┐
//!   pixels of a mosaic ──────────────────┤
//!   boxes on camera images ──► people ───┴─► saying ──► acts ──► a log of annotations
//!                                               ▲
//!   a map's version, logs ──► state: known labels, placed in it ──► GeoJSON, pixels of a mosaic
//! ```

pub mod features;
pub mod geojson;
pub mod known;
pub mod mapped_image;
pub mod mosaic;
pub mod people;
pub mod person_images;
pub mod pixels;
mod reading;
pub mod saying;
pub mod state;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use evermap_datasets::annotations::{AnnotationLog, RecordingError};
use evermap_engine::map::version::Version;
use evermap_schemas::Fault;
use evermap_schemas::roles::annotations::is_word;

use crate::output::outside_of_maps;
use crate::progress::line;

/// Lines about single losses; more are only counted.
const MOST_LINES: usize = 20;

/// What was left out, and why.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Losses {
    /// Counts by reason.
    pub counts: BTreeMap<String, u64>,
    /// Where, and what was found, one line each; and what else is to be told. Of many, the first, and how many more there are.
    pub lines: Vec<String>,
    /// How many more there are.
    more: usize,
}

impl Losses {
    /// One thing that was left out, or does not fit; `place` says which.
    pub fn note(&mut self, reason: &str, place: &str) {
        self.count(reason, 1);
        self.line(|| format!("{place}: {reason}"));
    }

    /// Something to be told that is no loss.
    pub fn remark(&mut self, text: &str) {
        self.line(|| text.to_owned());
    }

    fn line(&mut self, text: impl Fn() -> String) {
        if self.lines.len() < MOST_LINES {
            return self.lines.push(text());
        }
        self.more += 1;
        self.lines.truncate(MOST_LINES);
        self.lines.push(format!("… and {} more", self.more));
    }

    /// Counts without a place.
    pub fn count(&mut self, reason: &str, count: u64) {
        if count > 0 {
            *self.counts.entry(reason.to_owned()).or_default() += count;
        }
    }

    /// Tells the person, on stderr.
    pub fn tell(&self) {
        self.lines.iter().for_each(|text| line(text));
    }
}

/// A file of another program as text.
///
/// # Errors
/// A user fault for what is no file, or no text of UTF-8.
fn read_text(path: &Path) -> Result<String, Fault> {
    let text = evermap_datasets::read_text(path)
        .map_err(|error| Fault::user(format!("expected a file, found {error}")))?;
    match text.find('\0') {
        None => Ok(text),
        // All letters of a file in UTF-16 may be letters of UTF-8, too, with this one between them.
        Some(at) => {
            let (number, next) = (at + 1, "save it as UTF-8: it may be UTF-16");
            let fault = format!("expected text in UTF-8, found 0 as byte {number} of the file");
            Err(Fault::user(fault).next(next))
        }
    }
}

/// That a text is no JSON.
fn no_json(error: &serde_json::Error) -> Fault {
    Fault::user(format!("expected JSON, found {error}"))
}

/// Whether a text says nothing: runs throw acts away whose author or kind is empty.
pub fn is_blank(text: &str) -> bool {
    text.trim().is_empty()
}

/// The name of the person at the machine.
pub fn user() -> String {
    let named = ["USER", "USERNAME"]
        .into_iter()
        .find_map(|name| std::env::var(name).ok());
    let named = named.filter(|name| !is_blank(name) && is_word(name));
    named.unwrap_or_else(|| "unknown".to_owned())
}

/// Begins the next part of a log, of a name that no session of the map has: it would take that one's place.
///
/// # Errors
/// A resource fault where it cannot be written, a user fault as [`outside_of_maps`].
pub fn begin(log: &Path, map: &Version) -> Result<AnnotationLog, Fault> {
    outside_of_maps(log)?;
    let library = concat!("evermap ", env!("CARGO_PKG_VERSION"));
    let sessions = map.sessions.iter();
    let sessions: BTreeSet<&str> = sessions
        .map(|session| session.log.session.as_str())
        .collect();
    AnnotationLog::begin(log, |name| sessions.contains(name), library).map_err(unwritten)
}

/// The command that takes a log into a map, for people to copy.
pub fn taking_in(map: &str, site: &str, log: &Path) -> String {
    let log = log.display().to_string();
    let [map, site, log] = [map, site, log.as_str()].map(in_shell);
    format!("evermap run PLAN --map {map} --site {site} --sessions {log}")
}

/// A word as a shell reads it as one.
fn in_shell(word: &str) -> String {
    let is_plain = |letter: char| letter.is_alphanumeric() || "-_./:@+=,%".contains(letter);
    match !word.is_empty() && word.chars().all(is_plain) {
        true => word.to_owned(),
        false => format!("'{}'", word.replace('\'', r"'\''")),
    }
}

/// Why a log was not written.
pub fn unwritten(error: RecordingError) -> Fault {
    match error {
        RecordingError::Io { .. } => Fault::resource(error.to_string()),
        RecordingError::Kept { .. } | RecordingError::Folder { .. } => {
            Fault::user(error.to_string())
        }
        RecordingError::Mcap(_) => Fault::bug(error.to_string()),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn of_many_losses_the_first_are_told_and_all_are_counted() {
        let mut losses = Losses::default();
        for number in 0..1_000_000 {
            losses.note("feature without a shape", &format!("feature {number}"));
        }
        losses.remark("note: done");
        assert_eq!(losses.counts["feature without a shape"], 1_000_000);
        assert_eq!(losses.lines.len(), MOST_LINES + 1);
        assert_eq!(losses.lines[1], "feature 1: feature without a shape");
        assert_eq!(losses.lines[MOST_LINES], "… and 999981 more");
    }

    /// Its letters are letters of UTF-8, too: where it has no mark at its beginning, nothing else tells.
    #[test]
    fn a_file_in_utf_16_is_told_as_such() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.json");
        let text = r#"{"type": "FeatureCollection"}"#;
        let units = || text.encode_utf16();
        let little: Vec<u8> = units().flat_map(u16::to_le_bytes).collect();
        let big: Vec<u8> = units().flat_map(u16::to_be_bytes).collect();
        for (bytes, at) in [(little, 2), (big, 1)] {
            std::fs::write(&path, bytes).unwrap();
            let told = read_text(&path).unwrap_err().to_string();
            let expected = format!("expected text in UTF-8, found 0 as byte {at} of the file");
            assert!(
                told.contains(&expected) && told.contains("UTF-16"),
                "{told}"
            );
        }
        std::fs::write(&path, text).unwrap();
        assert_eq!(read_text(&path).unwrap(), text);
    }

    #[test]
    fn a_command_to_copy_is_one_for_a_shell() {
        let told = taking_in("s3://maps/lot", "lot", Path::new("labels/lot_ada.mcap"));
        let expected =
            "evermap run PLAN --map s3://maps/lot --site lot --sessions labels/lot_ada.mcap";
        assert_eq!(told, expected);
        let told = taking_in("my maps/lot", "lot", Path::new("lot_Ada O'B.mcap"));
        let expected =
            r"evermap run PLAN --map 'my maps/lot' --site lot --sessions 'lot_Ada O'\''B.mcap'";
        assert_eq!(told, expected);
    }
}
