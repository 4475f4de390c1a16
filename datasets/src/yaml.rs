//! YAML that people wrote, or that lies beside logs, within bounds: the library looks back at all brackets that are open
//! for each word, and copies what an alias stands for as often as it is named.

use std::collections::BTreeMap;

use evermap_schemas::Fault;
use saphyr_parser::{Event, Parser};
use serde::de::DeserializeOwned;

use crate::stores::without_mark;

/// Bytes of a text at most.
pub(crate) const LONGEST: usize = 4 << 20;

/// Collections may be nested this deep.
const DEEPEST: usize = 64;

/// Values that a text may stand for, aliases counted in full.
const MOST: usize = 500_000;

/// Brackets that the library may look back at without harm.
const FEW: usize = 1_000;

/// Reads YAML that should be `what`.
///
/// # Errors
/// A user fault for what is none, or beyond the bounds.
pub(crate) fn from_yaml<T: DeserializeOwned>(text: &str, what: &str) -> Result<T, Fault> {
    let refused =
        |found: &dyn std::fmt::Display| Fault::user(format!("expected {what}, found {found}"));
    // The library takes it for a document of its own.
    let text = without_mark(text);
    check(text).map_err(|found| refused(&found))?;
    serde_yaml_ng::from_str(text).map_err(|error| refused(&error))
}

/// That a text is within the bounds.
///
/// # Errors
/// What was found beyond them, or what is no YAML in a text that has to be looked at for it.
pub(crate) fn check(text: &str) -> Result<(), String> {
    if text.len() > LONGEST {
        let length = text.len();
        return Err(format!("{length} bytes, at most {LONGEST} are read"));
    }
    let opens = |byte: &u8| matches!(byte, b'[' | b'{');
    if text.bytes().filter(opens).count() <= FEW && !text.contains('&') {
        return Ok(());
    }
    let mut seen = NodeCounter::default();
    let mut parser = Parser::new_from_str(text);
    while let Some(event) = parser.next_event() {
        let (event, span) = event.map_err(|error| match error.info() {
            // The parser has a limit of its own, above ours.
            "recursion limit exceeded" => too_deep(),
            info => {
                let (line, column) = (error.marker().line(), error.marker().col() + 1);
                format!("{info} at line {line} column {column}")
            }
        })?;
        let line = span.start.line();
        seen.event(&event)
            .map_err(|found| format!("{found} at line {line}"))?;
    }
    Ok(())
}

fn too_deep() -> String {
    format!("values nested deeper than {DEEPEST} levels")
}

/// How many values a text has, those that its aliases repeat counted.
#[derive(Default)]
struct NodeCounter {
    /// Of each collection that is open: its anchor, and the values in it so far.
    open: Vec<(usize, usize)>,
    /// Values by anchor, those in them counted.
    anchors: BTreeMap<usize, usize>,
    /// Values, collections among them.
    values: usize,
}

impl NodeCounter {
    fn event(&mut self, event: &Event<'_>) -> Result<(), String> {
        match event {
            Event::SequenceStart(anchor, _) | Event::MappingStart(anchor, _) => {
                self.open.push((*anchor, 1));
                match self.open.len() > DEEPEST {
                    true => Err(too_deep()),
                    false => Ok(()),
                }
            }
            Event::SequenceEnd | Event::MappingEnd => match self.open.pop() {
                Some((anchor, values)) => self.add(anchor, values, 1),
                None => Ok(()),
            },
            Event::Scalar(_, _, anchor, _) => self.add(*anchor, 1, 1),
            Event::Alias(anchor) => {
                let values = self.anchors.get(anchor).copied().unwrap_or(1);
                self.add(0, values, values)
            }
            _ => Ok(()),
        }
    }

    /// Adds so many values to the collection that is open, of which so many are new.
    fn add(&mut self, anchor: usize, values: usize, new: usize) -> Result<(), String> {
        if anchor > 0 {
            self.anchors.insert(anchor, values);
        }
        if let Some((_, inside)) = self.open.last_mut() {
            *inside += values;
        }
        self.values += new;
        match self.values > MOST {
            true => Err(format!("more than {MOST} values")),
            false => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::time::{Duration, Instant};

    use serde_json::Value;

    use super::*;

    #[test]
    fn what_would_take_minutes_or_gigabytes_is_refused_at_once() {
        let begun = Instant::now();
        let list = vec!["1"; 10_000].join(", ");
        let aliases = vec!["*a"; 10_000].join(", ");
        for (text, says) in [
            ("[".repeat(200_000), "nested deeper than 64 levels"),
            ("{a: ".repeat(200_000), "nested deeper than 64 levels"),
            // What a comment closes stays open.
            ("[ # ]\n".repeat(200_000), "nested deeper than 64 levels"),
            (
                format!("defaults: {{list: &a [{list}], lists: [{aliases}]}}"),
                "more than 500000 values",
            ),
            ("#".repeat(LONGEST + 1), "at most 4194304 are read"),
        ] {
            let refused = from_yaml::<Value>(&text, "a session manifest").unwrap_err();
            let refused = refused.to_string();
            assert!(
                refused.contains("expected a session manifest, found") && refused.contains(says),
                "{refused}"
            );
        }
        assert!(begun.elapsed() < Duration::from_secs(10));
    }

    #[test]
    fn a_byte_order_mark_is_no_content() {
        let text = "\u{feff}site: lot\nsessions: {a: [b.mcap]}\n";
        let read: Value = from_yaml(text, "a session manifest").unwrap();
        assert_eq!(read["site"], "lot");
        let refused = from_yaml::<Value>("\u{feff}a: [b", "a session manifest").unwrap_err();
        assert!(refused.to_string().contains("at line "), "{refused}");
    }

    #[test]
    fn what_is_long_and_flat_is_read() {
        let masks = vec!["[[0, 700], [1280, 960]]"; 5_000].join(", ");
        let text = format!("mask: &m [{masks}]\nother: *m\nsites: {{a: [b, 'c]', \"d}}\"]}}");
        let read: Value = from_yaml(&text, "a session manifest").unwrap();
        assert_eq!(read["other"].as_array().map(Vec::len), Some(5_000));
        assert_eq!(read["sites"]["a"][1], "c]");
        let wrong = format!("{text}\nmore: [a");
        let refused = from_yaml::<Value>(&wrong, "a session manifest").unwrap_err();
        assert!(refused.to_string().contains("at line "), "{refused}");
    }
}
