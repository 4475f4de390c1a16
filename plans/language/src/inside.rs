//! Where a part of a query is written in a plan, which may fold it, indent it or put it between quotes.

use crate::fault::{Location, PlanFaults, Position};

/// A part of a query.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum QueryPosition<'q> {
    /// The character at this line and column of it, both from 1.
    At(usize, usize),
    /// The first place of a word, whatever its case.
    Word(&'q str),
}

impl QueryPosition<'_> {
    /// Its first byte; `None` where the query has no such part.
    fn start(self, query: &str) -> Option<usize> {
        match self {
            Self::At(line, column) => {
                let lines = query.split_inclusive('\n');
                let before: usize = lines.take(line.checked_sub(1)?).map(str::len).sum();
                let (at, _) = query
                    .get(before..)?
                    .char_indices()
                    .nth(column.checked_sub(1)?)?;
                Some(before + at)
            }
            Self::Word(word) => {
                let (query, word) = (query.to_ascii_lowercase(), word.to_ascii_lowercase());
                let is_letter = |c: char| c.is_alphanumeric() || c == '_';
                let is_whole = |at: &usize| {
                    let (before, behind) = (&query[..*at], &query[at + word.len()..]);
                    !before.ends_with(is_letter) && !behind.starts_with(is_letter)
                };
                let mut found = query.match_indices(&word).map(|(at, _)| at);
                found.find(is_whole)
            }
        }
    }
}

impl PlanFaults {
    /// The location of a part of a query that begins at a location; the query's own where the part cannot be found
    /// there. YAML changes white space alone, but for characters that are escaped.
    #[must_use]
    pub fn inside(
        &self,
        query_location: Location,
        query: &str,
        part: QueryPosition<'_>,
    ) -> Location {
        let found = || {
            let Location::Text(begin) = query_location else {
                return None;
            };
            let visible = |text: &str| text.chars().filter(|c| !c.is_whitespace()).count();
            let before = visible(query.get(..part.start(query)?)?);
            let text = self.text(begin.source)?;
            let mut written = visible_from(text, begin).peekable();
            let quotes = ['"', '\''];
            written.next_if(|(_, c)| quotes.contains(c) && !query.trim_start().starts_with(*c));
            let mut meant = query.chars().filter(|c| !c.is_whitespace());
            let mut both = written.zip(meant.by_ref());
            let same = both.by_ref().take(before).all(|((_, c), meant)| c == meant);
            let ((position, c), meant) = both.next()?;
            (same && c == meant).then_some(Location::Text(position))
        };
        found().unwrap_or(query_location)
    }
}

/// The characters of a text that are no white space, from a position on.
fn visible_from(text: &str, begin: Position) -> impl Iterator<Item = (Position, char)> {
    let lines = text.lines().enumerate().skip(begin.line.saturating_sub(1));
    lines.flat_map(move |(number, line)| {
        let skipped = match number + 1 == begin.line {
            true => begin.column.saturating_sub(1),
            false => 0,
        };
        let characters = line.chars().enumerate().skip(skipped);
        let visible = characters.filter(|(_, c)| !c.is_whitespace());
        visible.map(move |(column, c)| {
            let position = Position {
                source: begin.source,
                line: number + 1,
                column: column + 1,
            };
            (position, c)
        })
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::fault::Source;

    /// Where a part is found of the query that a plan's text has from its first `SELECT` on, or the quote before.
    fn found(text: &str, query: &str, part: QueryPosition<'_>) -> (usize, usize) {
        let mut faults = PlanFaults::default();
        let source = faults.open(Source {
            origin: "x.yaml".to_owned(),
            text: text.to_owned(),
        });
        let start = text.find(['"', '\'']).or(text.find("SELECT")).unwrap();
        let before = &text[..start];
        let line = before.matches('\n').count() + 1;
        let column = before.chars().rev().take_while(|c| *c != '\n').count() + 1;
        let location = Location::Text(Position {
            source,
            line,
            column,
        });
        let Position { line, column, .. } = faults.inside(location, query, part).position();
        (line, column)
    }

    #[test]
    fn parts_of_queries_are_found_however_they_are_written() {
        let block = "sql: |\n  SELECT é,\n    nope(b)\n  FROM c\n";
        let query = "SELECT é,\n  nope(b)\nFROM c\n";
        assert_eq!(found(block, query, QueryPosition::At(1, 8)), (2, 10));
        assert_eq!(found(block, query, QueryPosition::At(2, 3)), (3, 5));
        assert_eq!(found(block, query, QueryPosition::Word("NOPE")), (3, 5));
        let folded = "sql: >\n  SELECT a,\n  nope(b)\n  FROM c\n";
        let query = "SELECT a, nope(b) FROM c\n";
        assert_eq!(found(folded, query, QueryPosition::At(1, 11)), (3, 3));
        assert_eq!(found(folded, query, QueryPosition::Word("c")), (4, 8));
        let plain = "a: { sql: SELECT a, nope(b) FROM c }";
        assert_eq!(
            found(plain, query.trim(), QueryPosition::At(1, 11)),
            (1, 21)
        );
        let quoted = "sql: \"SELECT a, nope(b) FROM c\"";
        assert_eq!(
            found(quoted, query.trim(), QueryPosition::Word("from")),
            (1, 25)
        );
    }

    #[test]
    fn what_is_not_found_is_where_the_query_is() {
        let escaped = "sql: \"SELECT \\x61, nope(b) FROM c\"";
        let query = "SELECT a, nope(b) FROM c";
        assert_eq!(found(escaped, query, QueryPosition::Word("nope")), (1, 6));
        for part in [
            QueryPosition::At(0, 1),
            QueryPosition::At(1, 99),
            QueryPosition::At(9, 9),
            QueryPosition::Word("select_"),
        ] {
            assert_eq!(found("sql: SELECT a", "SELECT a", part), (1, 6));
        }
    }
}
