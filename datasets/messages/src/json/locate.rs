//! Finds base64 text inside a JSON payload without taking the payload apart.

use super::plan::{Plan, Shape};
use crate::{DecodeError, Located};
use std::ops::Range;

/// Where the text of the base64 property at `path` lies, between its quotes. None where the
/// text is written with escapes, as its bytes are then not those of the base64.
pub(crate) fn locate(
    plan: &Plan,
    payload: &[u8],
    path: &[&str],
) -> Result<Option<Located>, DecodeError> {
    if !plan.is_base64(path) {
        return Ok(None);
    }
    let mut value = 0..payload.len();
    for name in path {
        let mut scanner = Scanner {
            text: payload,
            position: value.start,
        };
        match scanner.member(name)? {
            Some(member) => value = member,
            None => return Ok(None),
        }
    }
    Ok(match &payload[value.clone()] {
        [b'"', text @ .., b'"'] if !text.contains(&b'\\') => Some(Located {
            range: value.start + 1..value.end - 1,
            base64: true,
        }),
        _ => None,
    })
}

impl Plan {
    fn is_base64(&self, path: &[&str]) -> bool {
        let mut properties = self.properties.as_deref().unwrap_or_default();
        let mut shape = None;
        for name in path {
            let found = properties.iter().find(|(known, _)| known == name);
            shape = found.map(|(_, shape)| shape);
            properties = match shape {
                Some(Shape::Object(inner)) => inner,
                _ => &[],
            };
        }
        shape == Some(&Shape::Base64)
    }
}

/// Steps over JSON values by their brackets and quotes alone.
struct Scanner<'a> {
    text: &'a [u8],
    position: usize,
}

impl Scanner<'_> {
    /// The value of member `name` of the object here; the last, where there are several.
    fn member(&mut self, name: &str) -> Result<Option<Range<usize>>, DecodeError> {
        let mut found = None;
        if self.peek() != Some(b'{') {
            return Ok(None);
        }
        self.position += 1;
        while self.peek() != Some(b'}') {
            let key = self.string()?;
            let key = &self.text[key.start + 1..key.end - 1];
            self.expect(b':')?;
            let value = self.value()?;
            if key == name.as_bytes() {
                found = Some(value);
            }
            if self.peek() != Some(b'}') {
                self.expect(b',')?;
            }
        }
        Ok(found)
    }

    /// Steps over white space; the byte there.
    fn peek(&mut self) -> Option<u8> {
        while self.text.get(self.position)?.is_ascii_whitespace() {
            self.position += 1;
        }
        self.text.get(self.position).copied()
    }

    fn expect(&mut self, byte: u8) -> Result<(), DecodeError> {
        if self.peek() != Some(byte) {
            return Err(self.malformed(&format!("'{}'", char::from(byte))));
        }
        self.position += 1;
        Ok(())
    }

    /// Steps over a string, quotes included.
    fn string(&mut self) -> Result<Range<usize>, DecodeError> {
        self.expect(b'"')?;
        let start = self.position - 1;
        while let Some(byte) = self.text.get(self.position) {
            self.position += 1;
            match byte {
                b'"' => return Ok(start..self.position),
                b'\\' => self.position += 1,
                _ => {}
            }
        }
        Err(self.malformed("the end of a string"))
    }

    /// Steps over any value.
    fn value(&mut self) -> Result<Range<usize>, DecodeError> {
        let Some(first) = self.peek() else {
            return Err(self.malformed("a value"));
        };
        let start = self.position;
        match first {
            b'"' => return self.string(),
            b'{' | b'[' => self.brackets()?,
            _ => {
                let ends = |b: &u8| matches!(b, b',' | b'}' | b']') || b.is_ascii_whitespace();
                let rest = &self.text[start..];
                let length = rest.iter().position(ends).unwrap_or(rest.len());
                if length == 0 {
                    return Err(self.malformed("a value"));
                }
                self.position += length;
            }
        }
        Ok(start..self.position)
    }

    fn brackets(&mut self) -> Result<(), DecodeError> {
        let mut depth = 0_usize;
        while let Some(byte) = self.peek() {
            match byte {
                b'"' => {
                    self.string()?;
                    continue;
                }
                b'{' | b'[' => depth += 1,
                b'}' | b']' => depth -= 1,
                _ => {}
            }
            self.position += 1;
            if depth == 0 {
                return Ok(());
            }
        }
        Err(self.malformed("a closing bracket"))
    }

    fn malformed(&self, expected: &str) -> DecodeError {
        DecodeError::Malformed {
            format: "json",
            offset: self.position,
            expected: expected.to_owned(),
        }
    }
}
