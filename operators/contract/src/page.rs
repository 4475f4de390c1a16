//! An operator's page: Markdown that a person reads, and whose example a test runs.
//!
//! Under the heading `## Example` stand tables, each after a line that names what it is:
//!
//! ```text
//! With `baseline_m = 1.0`:            parameters, as `name = JSON value`, comma separated
//! Input `odometry`:                   a table of a port's rows
//! Output:                             the table of rows to expect
//! ```
//! A table's header names columns; `a.b` is field b of struct a. A column that a table leaves out is filled with the
//! type's zero on input and not compared on output. Cells are JSON, or bare text.

use std::collections::BTreeMap;

use serde_json::{Map, Value};

/// A page's text.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Page(pub &'static str);

/// The example on a page. Rows are JSON objects.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Example {
    /// Parameters that differ from their defaults.
    pub params: Map<String, Value>,
    /// Rows by port.
    pub inputs: BTreeMap<String, Vec<Map<String, Value>>>,
    /// Rows to expect.
    pub output: Vec<Map<String, Value>>,
}

enum Target {
    Input(String),
    Output,
}

impl Page {
    /// The first sentence after the title: what the operator yields.
    pub fn summary(&self) -> &'static str {
        self.0
            .lines()
            .find(|line| !line.is_empty() && !line.starts_with('#'))
            .unwrap_or_default()
    }

    /// The example; `None` where the page has none.
    pub fn example(&self) -> Option<Example> {
        let text = self.0.split("\n## Example").nth(1)?;
        let text = text.split("\n## ").next().unwrap_or(text);
        let mut example = Example::default();
        let mut target = None;
        let mut header: Vec<String> = Vec::new();
        for line in text.lines().map(str::trim) {
            if line.starts_with('|') {
                take_row(&mut example, target.as_ref(), &mut header, line);
            } else if let Some(next) = caption(&mut example, line) {
                target = Some(next);
                header.clear();
            }
        }
        Some(example)
    }
}

fn caption(example: &mut Example, line: &str) -> Option<Target> {
    if let Some(rest) = line.strip_prefix("With ") {
        for pair in rest.trim_end_matches(':').split("`, `") {
            if let Some((name, value)) = pair.trim_matches('`').split_once(" = ") {
                example.params.insert(name.to_owned(), cell(value));
            }
        }
        return None;
    }
    if let Some(rest) = line.strip_prefix("Input `") {
        let port = rest.split('`').next()?.to_owned();
        example.inputs.entry(port.clone()).or_default();
        return Some(Target::Input(port));
    }
    line.starts_with("Output").then_some(Target::Output)
}

fn take_row(example: &mut Example, target: Option<&Target>, header: &mut Vec<String>, line: &str) {
    let cells: Vec<&str> = line.trim_matches('|').split('|').map(str::trim).collect();
    if header.is_empty() {
        *header = cells
            .iter()
            .map(|cell| cell.trim_matches('`').to_owned())
            .collect();
        return;
    }
    if cells
        .iter()
        .all(|cell| cell.chars().all(|c| matches!(c, '-' | ':')))
    {
        return;
    }
    let mut row = Map::new();
    for (path, text) in header.iter().zip(&cells) {
        insert(&mut row, path, cell(text));
    }
    match target {
        Some(Target::Input(port)) => example.inputs.entry(port.clone()).or_default().push(row),
        Some(Target::Output) => example.output.push(row),
        None => {}
    }
}

fn insert(row: &mut Map<String, Value>, path: &str, value: Value) {
    match path.split_once('.') {
        None => {
            row.insert(path.to_owned(), value);
        }
        Some((head, rest)) => {
            let inner = row.entry(head).or_insert_with(|| Value::Object(Map::new()));
            if let Some(inner) = inner.as_object_mut() {
                insert(inner, rest, value);
            }
        }
    }
}

fn cell(text: &str) -> Value {
    let text = text.trim_matches('`');
    serde_json::from_str(text).unwrap_or_else(|_| Value::String(text.to_owned()))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use serde_json::json;

    #[test]
    fn reads_parameters_tables_and_nested_columns() {
        let page = Page(
            "# lengths\n\nLengths of things.\n\n## Example\n\nWith `a_m = 2.0`, `b = \"x\"`:\n\nInput `poses`:\n\n\
             | name | pose.x |\n|---|---:|\n| p | 1.5 |\n\nOutput:\n\n| n |\n|---|\n| 3 |\n| null |\n\n## Source\n| no |\n",
        );
        let example = page.example().unwrap();
        assert_eq!(page.summary(), "Lengths of things.");
        assert_eq!(Value::Object(example.params), json!({"a_m": 2.0, "b": "x"}));
        assert_eq!(
            example.inputs["poses"],
            vec![
                json!({"name": "p", "pose": {"x": 1.5}})
                    .as_object()
                    .unwrap()
                    .clone()
            ]
        );
        assert_eq!(example.output.len(), 2);
        assert_eq!(example.output[1]["n"], Value::Null);
    }
}
