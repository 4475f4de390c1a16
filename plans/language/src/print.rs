//! A plan as YAML, composed: reading it gives the same plan.

use std::fmt;

use serde_json::Value;

use crate::plan::{Body, Input, Plan, Step};
use crate::yaml::{Kind, plain};

/// Longer texts are broken into lines.
const WIDEST: usize = 100;

/// What the plan extends, its defaults and the ports that it does not name are in its steps. Its
/// tests are not shown.
impl fmt::Display for Plan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "plan: {}", word(&self.name))?;
        if let Some(doc) = &self.doc {
            writeln!(f, "doc: {}", block(doc, 2))?;
        }
        if !self.needs.is_empty() {
            writeln!(f, "needs: {}", names(&self.needs))?;
        }
        if let Some(sessions) = &self.sessions {
            writeln!(f, "sessions: {}", word(&sessions.path))?;
        }
        writeln!(f, "steps:")?;
        for step in &self.steps {
            write_step(step, f)?;
        }
        writeln!(f, "write: {}", names(&self.write))
    }
}

fn names(names: &[String]) -> String {
    flow(&names.into())
}

fn write_step(step: &Step, f: &mut fmt::Formatter<'_>) -> fmt::Result {
    writeln!(f, "  {}:", step.name)?;
    if step.once {
        writeln!(f, "    once: true")?;
    }
    match &step.body {
        Body::Op { op, params } => {
            writeln!(f, "    op: {}", word(op))?;
            write_mappings([("in", ports(step)), ("with", params.clone())], f)
        }
        Body::Python(python) => {
            let text = format!("{}:{}", python.file, python.function);
            writeln!(f, "    python: {}", word(&text))?;
            let with = Value::Object(python.params.clone());
            let pixels = python.pixels.iter();
            let pixels = pixels.map(|(port, column)| (port.clone(), column.clone().into()));
            let pixels = Value::Object(pixels.collect());
            write_mappings([("in", ports(step)), ("with", with), ("pixels", pixels)], f)?;
            writeln!(f, "    grain: {}", python.grain.name())?;
            writeln!(f, "    output: {}", flow(&python.output))
        }
        Body::Sql { query } => writeln!(f, "    sql: {}", block(query, 6)),
    }
}

fn ports(step: &Step) -> Value {
    let named = |(port, input): (&String, &Input)| (port.clone(), input.written().into());
    Value::Object(step.inputs.iter().map(named).collect())
}

/// The mappings that are not empty.
fn write_mappings<const N: usize>(
    mappings: [(&str, Value); N],
    f: &mut fmt::Formatter<'_>,
) -> fmt::Result {
    for (key, value) in mappings {
        if value.as_object().is_some_and(|entries| !entries.is_empty()) {
            writeln!(f, "    {key}: {}", flow(&value))?;
        }
    }
    Ok(())
}

/// A value in one line.
fn flow(value: &Value) -> String {
    match value {
        Value::String(text) => word(text),
        Value::Array(items) => {
            let items: Vec<String> = items.iter().map(flow).collect();
            format!("[{}]", items.join(", "))
        }
        Value::Object(entries) if entries.is_empty() => "{}".to_owned(),
        Value::Object(entries) => {
            let entry = |(key, value): (&String, &Value)| format!("{}: {}", word(key), flow(value));
            let entries: Vec<String> = entries.iter().map(entry).collect();
            format!("{{ {} }}", entries.join(", "))
        }
        Value::Null | Value::Bool(_) | Value::Number(_) => value.to_string(),
    }
}

/// A text in one line, quoted where it would be read as something else.
fn word(text: &str) -> String {
    let is_simple = |c: char| c.is_ascii_alphanumeric() || "_./-".contains(c);
    let starts_simply = text.starts_with(|c: char| c.is_ascii_alphanumeric() || "_/.".contains(c));
    let is_text = matches!(plain(text), Kind::Text(_));
    match starts_simply && text.chars().all(is_simple) && is_text {
        true => text.to_owned(),
        false => Value::from(text).to_string(),
    }
}

/// A text in lines of its own, or quoted where its spaces and breaks would not stay. A long line
/// is broken between words, which reads as one line again.
fn block(text: &str, indent: usize) -> String {
    let (lines, end) = match text.strip_suffix('\n') {
        Some(lines) => (lines, ""),
        None => (text, "-"),
    };
    let starts_well = lines.starts_with(|c: char| !c.is_whitespace());
    let stays = |c: char| c == '\n' || c == ' ' || !(c.is_control() || c.is_whitespace());
    if !starts_well || lines.ends_with(['\n', ' ']) || !lines.chars().all(stays) {
        return Value::from(text).to_string();
    }
    let margin = format!("\n{}", " ".repeat(indent));
    let is_long = lines.chars().count() > WIDEST;
    if is_long && !lines.contains('\n') && !lines.contains("  ") {
        return format!(">{end}{margin}{}", wrapped(lines, WIDEST).join(&margin));
    }
    format!("|{end}{margin}{}", lines.replace('\n', &margin))
}

/// The words of a text in lines that are not wider than so many letters, unless a word is.
pub fn wrapped(text: &str, widest: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= widest => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}
