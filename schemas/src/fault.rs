//! The one error vocabulary: who must act, what was expected, what was found, where, and what to do next.

use std::fmt;

/// Who can do something about a fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// The request is wrong: a plan, a parameter, a command line.
    User,
    /// The input is wrong: a torn log, a missing column, a value out of range.
    Data,
    /// The machine is short of something: memory, disk, a file that cannot be opened, a lost executor.
    Resource,
    /// We are wrong.
    Bug,
}

impl Kind {
    const ALL: [(Kind, &'static str); 4] = [
        (Kind::User, "user"),
        (Kind::Data, "data"),
        (Kind::Resource, "resource"),
        (Kind::Bug, "bug"),
    ];

    /// The word that starts a message, so that the kind survives a trip through a remote error string.
    pub fn code(self) -> &'static str {
        Self::ALL
            .iter()
            .find(|(kind, _)| *kind == self)
            .map_or("bug", |(_, code)| code)
    }
}

/// An error with a kind. Displays as `kind: message (at place); next step`.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Fault {
    /// Who must act.
    pub kind: Kind,
    /// What was expected and what was found.
    pub message: String,
    /// Where: a file and offset, a step, a column. Empty where the message says it all.
    pub place: String,
    /// What to do next. Empty where nothing sensible can be said.
    pub next: String,
}

impl Fault {
    /// A fault of any kind.
    pub fn new(kind: Kind, message: impl Into<String>) -> Self {
        Self {
            kind,
            message: message.into(),
            place: String::new(),
            next: String::new(),
        }
    }

    /// The request is wrong.
    pub fn user(message: impl Into<String>) -> Self {
        Self::new(Kind::User, message)
    }

    /// The input is wrong.
    pub fn data(message: impl Into<String>) -> Self {
        Self::new(Kind::Data, message)
    }

    /// The machine is short of something.
    pub fn resource(message: impl Into<String>) -> Self {
        Self::new(Kind::Resource, message)
    }

    /// We are wrong.
    pub fn bug(message: impl Into<String>) -> Self {
        Self::new(Kind::Bug, message)
    }

    /// Where it happened. A second call puts the outer place in front of the inner one.
    #[must_use]
    pub fn at(mut self, place: impl fmt::Display) -> Self {
        self.place = if self.place.is_empty() {
            place.to_string()
        } else {
            format!("{place}: {}", self.place)
        };
        self
    }

    /// What to do next.
    #[must_use]
    pub fn next(mut self, step: impl Into<String>) -> Self {
        self.next = step.into();
        self
    }

    /// Reads back what [`fmt::Display`] wrote, wherever it stands inside a remote error's text.
    pub fn parse(text: &str) -> Option<Self> {
        let (start, kind) = Kind::ALL
            .iter()
            .filter_map(|(kind, code)| {
                text.find(&format!("evermap {code}: "))
                    .map(|at| (at, *kind))
            })
            .min_by_key(|(at, _)| *at)?;
        let body = &text[start + "evermap : ".len() + kind.code().len()..];
        Some(Self::new(kind, body.trim_end()))
    }

    /// The text that [`Fault::parse`] finds again.
    pub fn coded(&self) -> String {
        format!("evermap {self}")
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.kind.code(), self.message)?;
        if !self.place.is_empty() {
            write!(f, " (at {})", self.place)?;
        }
        if !self.next.is_empty() {
            write!(f, "; {}", self.next)?;
        }
        Ok(())
    }
}

impl std::error::Error for Fault {}

impl From<arrow::error::ArrowError> for Fault {
    fn from(error: arrow::error::ArrowError) -> Self {
        Self::data(error.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn survives_a_remote_error_string() {
        let fault = Fault::data("expected 4 cameras, found 3")
            .at("session a")
            .next("check the manifest");
        let remote = format!("Execution error: task 3 failed: {}", fault.coded());
        let back = Fault::parse(&remote);
        assert_eq!(back.as_ref().map(|f| f.kind), Some(Kind::Data));
        assert!(back.is_some_and(|f| {
            f.message
                .contains("expected 4 cameras, found 3 (at session a)")
        }));
        assert_eq!(Fault::parse("nothing of ours"), None);
    }
}
