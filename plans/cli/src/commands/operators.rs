//! `evermap operators`.

use std::fmt::Write as _;
use std::io::Write as _;

use evermap_contract::{Entry, Grain, Layer, LayerRow};
use evermap_schemas::{Column, record};

use crate::arguments::OperatorsArgs;
use crate::ending::{DONE, Ending};
use crate::output::print_rows;

record! {
    /// One operator.
    pub struct OperatorLine {
        /// Name, as plans write it after `op:`.
        operator: String,
        /// Raised when the same input gives another output.
        version: u32,
        /// Input ports; the first drives, those in brackets may stay unconnected.
        ports: String,
        /// Layer that it yields.
        yields: String,
        /// What it yields, in a sentence.
        summary: String,
    }
}
impl LayerRow for OperatorLine {
    const NAME: &'static str = "operators";
    const DOC: &'static str = "One operator.";
    const KEY: &'static [&'static str] = &["operator"];
}

/// Lists the operators, or prints the page of one with the columns of its ports.
///
/// # Errors
/// A user fault that names the operators there are.
pub async fn operators(args: &OperatorsArgs) -> Ending {
    let registry = evermap_catalog::registry();
    match &args.name {
        Some(name) => writeln!(
            std::io::stdout(),
            "{}",
            reference(registry.get(name)?).trim_end()
        )?,
        None => print_rows(args.format, registry.entries().map(line).collect()).await?,
    }
    DONE
}

fn line(entry: &Entry) -> OperatorLine {
    let port = |port: &evermap_contract::Port| {
        if port.optional {
            format!("[{}]", port.name)
        } else {
            port.name.to_owned()
        }
    };
    OperatorLine {
        operator: entry.name.to_owned(),
        version: entry.version,
        ports: entry.ports.iter().map(port).collect::<Vec<_>>().join(", "),
        yields: entry.output.name.to_owned(),
        summary: entry.page.summary().to_owned(),
    }
}

/// The operator's page, and behind it what its declaration says: columns of ports and output, parameters with types.
pub fn reference(entry: &Entry) -> String {
    let mut text = entry.page.0.trim_end().to_owned();
    let _ = write!(
        text,
        "\n\n## Parameters as a plan writes them\n\n{}",
        parameters(entry)
    );
    for port in &entry.ports {
        let optional = if port.optional { ", optional" } else { "" };
        let pixels = port
            .pixels
            .map(|column| format!("; `{column}` comes as encoded images"))
            .unwrap_or_default();
        let _ = write!(
            text,
            "\n## Port `{}`: {}{optional}{pixels}\n\n{}\n\n{}",
            port.name,
            grain(&port.grain),
            port.layer.doc,
            columns(&port.layer)
        );
    }
    let output = &entry.output;
    let key = output.key.join(", ");
    let _ = write!(
        text,
        "\n## Yields `{}`, ordered by {key}\n\n{}\n\n{}",
        output.name,
        output.doc,
        columns(output)
    );
    text
}

fn grain(grain: &Grain) -> String {
    match grain {
        Grain::Row => "any rows".to_owned(),
        Grain::Key { columns, order } => format!(
            "all rows of one {}, by {}",
            columns.join(" and "),
            order.join(", ")
        ),
        Grain::Whole => "all rows of one site".to_owned(),
    }
}

fn columns(layer: &Layer) -> String {
    let mut text =
        String::from("| column | type | unit | frame | meaning |\n|---|---|---|---|---|\n");
    for column in &layer.columns {
        let _ = writeln!(
            text,
            "| `{}` | {} | {} | {} | {} |",
            column.name,
            type_name(column),
            column.unit,
            column.frame,
            column.doc
        );
    }
    text
}

/// The column's type for people: structs by their fields.
fn type_name(column: &Column) -> String {
    let null = if column.nullable { ", may be null" } else { "" };
    format!("{}{null}", crate::describe::type_name(&column.data_type))
}

fn parameters(entry: &Entry) -> String {
    let mut text = String::from("| parameter | type | default | meaning |\n|---|---|---|---|\n");
    let empty = serde_json::Map::new();
    let properties = entry.params_schema["properties"]
        .as_object()
        .unwrap_or(&empty);
    for (name, default) in entry.defaults.as_object().unwrap_or(&empty) {
        let property = properties.get(name).unwrap_or(&serde_json::Value::Null);
        let kind = match &property["type"] {
            serde_json::Value::String(kind) => kind.clone(),
            serde_json::Value::Array(kinds) => kinds
                .iter()
                .filter_map(|kind| kind.as_str())
                .collect::<Vec<_>>()
                .join(" or "),
            _ => "object".to_owned(),
        };
        let doc = property["description"]
            .as_str()
            .unwrap_or_default()
            .replace('\n', " ");
        let _ = writeln!(text, "| `{name}` | {kind} | {default} | {doc} |");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reference_names_every_parameter_port_and_column() {
        for entry in evermap_catalog::registry().entries() {
            let text = reference(entry);
            assert!(text.starts_with(&format!("# {}", entry.name)));
            let columns = entry
                .ports
                .iter()
                .flat_map(|port| &port.layer.columns)
                .chain(&entry.output.columns);
            for column in columns {
                assert!(
                    text.contains(&format!("| `{}` |", column.name)),
                    "{}: {}",
                    entry.name,
                    column.name
                );
            }
            for name in entry
                .defaults
                .as_object()
                .into_iter()
                .flat_map(|defaults| defaults.keys())
            {
                assert!(
                    text.contains(&format!("| `{name}` | ")),
                    "{}: {name}",
                    entry.name
                );
            }
        }
    }
}
