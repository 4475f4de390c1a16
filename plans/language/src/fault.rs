//! Faults: what is wrong with a plan, where, and what was probably meant.
//!
//! Every check appends to one [`PlanFaults`] and goes on, so that a person mends a file in one
//! go instead of once per mistake.

use std::fmt;

use crate::suggest;

/// Faults beyond this many are counted, not kept: a binary file is not worth a longer list.
const MOST_KEPT: usize = 1000;

/// A text and where it is from.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Source {
    /// Names the text in messages: the path of a file.
    pub origin: String,
    /// The text.
    pub text: String,
}

/// A position in a text: line and column, both counted from 1, columns in characters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Position {
    /// Which text: 0 is the plan itself, 1 the one that it extends, and so on.
    pub source: usize,
    /// Line, from 1.
    pub line: usize,
    /// Column in characters, from 1.
    pub column: usize,
}

/// Where a value was written: in the text, or in a `--set` option on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Location {
    /// In the text.
    Text(Position),
    /// In the option of this index, in the order given.
    Setting(usize),
}

impl Position {
    /// The first character of a text.
    pub(crate) fn start_of(source: usize) -> Self {
        Self {
            source,
            line: 1,
            column: 1,
        }
    }
}

impl Location {
    /// The position in a text; the start of the plan for a value set by an option.
    #[must_use]
    pub fn position(self) -> Position {
        match self {
            Self::Text(position) => position,
            Self::Setting(_) => Position::start_of(0),
        }
    }
}

/// Whether a fault stops the plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// The plan is refused.
    Error,
    /// The plan runs, but probably not as meant.
    Warning,
}

/// One thing that is wrong.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct PlanFault {
    /// Where.
    pub location: Location,
    /// Error or warning.
    pub severity: Severity,
    /// What was expected and what was found: one line, no full stop.
    pub message: String,
    /// What to do about it, as a phrase: "did you mean `lanes`?".
    pub suggestion: Option<String>,
}

/// All faults of a plan. Displayed as `origin:line:column: message; suggestion`, one a line.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct PlanFaults {
    sources: Vec<Source>,
    settings: Vec<String>,
    kept: Vec<PlanFault>,
    omitted: usize,
}

impl PlanFaults {
    /// No faults yet, in the same texts.
    #[must_use]
    pub fn none_yet(&self) -> Self {
        Self {
            sources: self.sources.clone(),
            settings: self.settings.clone(),
            ..Self::default()
        }
    }

    /// Adds a text that faults can point to; its number is that of [`Position::source`].
    pub(crate) fn open(&mut self, source: Source) -> usize {
        self.sources.push(source);
        self.sources.len() - 1
    }

    /// Where the text at a location is from.
    pub(crate) fn origin(&self, location: Location) -> &str {
        let source = self.sources.get(location.position().source);
        source.map_or("", |source| source.origin.as_str())
    }

    /// A text, by its number.
    pub(crate) fn text(&self, source: usize) -> Option<&str> {
        self.sources.get(source).map(|source| source.text.as_str())
    }

    /// Names the `--set` options that [`Location::Setting`] counts.
    #[must_use]
    pub fn with_settings(mut self, settings: &[String]) -> Self {
        self.settings = settings.to_vec();
        self
    }

    /// Records an error.
    pub fn error(&mut self, location: Location, message: impl Into<String>) {
        self.push(location, Severity::Error, message.into(), None);
    }

    /// Records an error and what to do about it.
    pub fn error_with(
        &mut self,
        location: Location,
        message: impl Into<String>,
        suggestion: impl Into<String>,
    ) {
        self.push(
            location,
            Severity::Error,
            message.into(),
            Some(suggestion.into()),
        );
    }

    /// Records a warning.
    pub fn warning(&mut self, location: Location, message: impl Into<String>) {
        self.push(location, Severity::Warning, message.into(), None);
    }

    /// Records that `name` is none of `known`, suggesting the nearest of them if one is near.
    pub fn unknown<'k>(
        &mut self,
        location: Location,
        message: impl Into<String>,
        name: &str,
        known: impl IntoIterator<Item = &'k str>,
    ) {
        self.unknown_as(Severity::Error, location, message, name, known);
    }

    /// As [`PlanFaults::unknown`], with the severity given.
    pub fn unknown_as<'k>(
        &mut self,
        severity: Severity,
        location: Location,
        message: impl Into<String>,
        name: &str,
        known: impl IntoIterator<Item = &'k str>,
    ) {
        let nearest = match self.kept.len() {
            0..MOST_KEPT => suggest::nearest(name, known),
            _ => None,
        };
        let suggestion = nearest.map(|known| format!("did you mean {}?", suggest::quoted(known)));
        self.push(location, severity, message.into(), suggestion);
    }

    fn push(
        &mut self,
        location: Location,
        severity: Severity,
        message: String,
        suggestion: Option<String>,
    ) {
        if self.kept.len() >= MOST_KEPT {
            self.omitted += 1;
            return;
        }
        self.kept.push(PlanFault {
            location,
            severity,
            message,
            suggestion,
        });
    }

    /// The faults, in the order of the text once sorted by [`PlanFaults::settle`].
    pub fn iter(&self) -> impl Iterator<Item = &PlanFault> {
        self.kept.iter()
    }

    /// The faults that refuse the plan.
    pub fn errors(&self) -> impl Iterator<Item = &PlanFault> {
        self.iter()
            .filter(|fault| fault.severity == Severity::Error)
    }

    /// True when nothing at all was found.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.kept.is_empty()
    }

    /// How many errors there are, those not kept included.
    #[must_use]
    pub fn error_count(&self) -> usize {
        self.errors().count() + self.omitted
    }

    /// Sorts by location and drops repetitions (an alias repeats the faults of its anchor).
    #[must_use]
    pub fn settle(mut self) -> Self {
        self.kept.sort();
        self.kept.dedup();
        self
    }

    /// `value` and the warnings, or all faults if one of them is an error.
    ///
    /// # Errors
    /// The faults, if one of them is an error.
    pub fn into_result<T>(self, value: Option<T>) -> Result<(T, Self), Self> {
        let settled = self.settle();
        match value {
            Some(value) if settled.error_count() == 0 => Ok((value, settled)),
            _ => Err(settled),
        }
    }

    fn location_name(&self, location: Location) -> String {
        match location {
            Location::Text(Position { line, column, .. }) => {
                format!("{}:{line}:{column}", self.origin(location))
            }
            Location::Setting(index) => match self.settings.get(index) {
                Some(setting) => format!("--set {}", suggest::printable(setting)),
                None => "--set".to_owned(),
            },
        }
    }

    fn write_omitted(&self, out: &mut impl fmt::Write) -> fmt::Result {
        match self.omitted {
            0 => Ok(()),
            omitted => {
                let origin = self.origin(Location::Text(Position::start_of(0)));
                writeln!(out, "{origin}: … and {omitted} more")
            }
        }
    }

    /// The long form for a terminal: each fault with its source line and a mark under it.
    #[must_use]
    pub fn pretty(&self) -> String {
        let lines: Vec<Vec<&str>> = self
            .sources
            .iter()
            .map(|source| source.text.lines().collect())
            .collect();
        let mut out = String::new();
        for fault in &self.kept {
            self.pretty_fault(fault, &lines, &mut out);
        }
        // Writing to a string cannot fail.
        let _ = self.write_omitted(&mut out);
        out
    }

    fn pretty_fault(&self, fault: &PlanFault, lines: &[Vec<&str>], out: &mut String) {
        let kind = match fault.severity {
            Severity::Error => "error",
            Severity::Warning => "warning",
        };
        let place = self.location_name(fault.location);
        out.push_str(&format!("{kind}: {}\n  --> {place}\n", fault.message));
        let source = match fault.location {
            Location::Text(position) => lines
                .get(position.source)
                .and_then(|lines| lines.get(position.line.wrapping_sub(1)))
                .map(|line| (position, *line)),
            Location::Setting(_) => None,
        };
        let hint = fault.suggestion.as_deref().unwrap_or("");
        match source {
            Some((position, line)) => out.push_str(&marked_line(position, line, hint)),
            None if hint.is_empty() => {}
            None => out.push_str(&format!("   = {hint}\n")),
        }
        out.push('\n');
    }
}

/// The source line, cut to a window around the column, with carets under the word there.
fn marked_line(position: Position, line: &str, hint: &str) -> String {
    const WINDOW: usize = 100;
    let column = position.column.saturating_sub(1);
    let from = column.saturating_sub(WINDOW / 2);
    let shown: String = line
        .chars()
        .skip(from)
        .take(WINDOW)
        .map(|c| if c.is_control() { ' ' } else { c })
        .collect();
    let word = shown
        .chars()
        .skip(column - from)
        .take_while(|c| c.is_alphanumeric() || "_-./$".contains(*c))
        .count();
    let carets = "^".repeat(word.max(1));
    let number = position.line.to_string();
    let margin = " ".repeat(number.len());
    let indent = " ".repeat(column - from);
    let under = format!("{margin} | {indent}{carets} {hint}");
    format!(
        "{margin} |\n{number} | {}\n{}\n",
        shown.trim_end(),
        under.trim_end()
    )
}

impl fmt::Display for PlanFaults {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for fault in &self.kept {
            let place = self.location_name(fault.location);
            let kind = match fault.severity {
                Severity::Error => "",
                Severity::Warning => "warning: ",
            };
            write!(f, "{place}: {kind}{}", fault.message)?;
            match &fault.suggestion {
                Some(suggestion) => writeln!(f, "; {suggestion}")?,
                None => writeln!(f)?,
            }
        }
        self.write_omitted(f)
    }
}

impl std::error::Error for PlanFaults {}
