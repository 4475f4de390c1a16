//! The reference of an operator: its page, and behind it the tables that its declaration gives. This is the one place
//! that writes them, for the command line and for the documentation alike.

use std::fmt::Write;

use evermap_schemas::{Column, Layer, type_name};

use crate::{Entry, Key, Reach, Shape};

impl Entry {
    /// The page with tables of parameters, ports and columns, as Markdown.
    pub fn reference(&self) -> String {
        let mut text = self.page.0.trim_end().to_owned();
        text.push_str("\n\n## Parameters\n\n");
        text.push_str(&self.parameter_table());
        text.push_str("\n## Ports\n\n");
        text.push_str(&self.port_table());
        for port in &self.ports {
            let title = format!("Port `{}`: `{}`", port.name, port.layer.name);
            section(&mut text, &title, &port.layer);
        }
        let key = self.output.key.join(", ");
        let title = format!("Yields `{}`, ordered by {key}", self.output.name);
        section(&mut text, &title, &self.output);
        text
    }

    fn parameter_table(&self) -> String {
        let mut text = String::from(
            "| parameter | type | range | default | meaning |\n|---|---|---|---|---|\n",
        );
        for parameter in self.parameters() {
            let _ = writeln!(
                text,
                "| `{}` | {} | {} | {} | {} |",
                parameter.name, parameter.kind, parameter.range, parameter.default, parameter.doc
            );
        }
        text
    }

    fn port_table(&self) -> String {
        let mut text = String::from("| port | reads | how much at once |\n|---|---|---|\n");
        for (index, port) in self.ports.iter().enumerate() {
            let much = match index {
                0 => format!("{}; drives", shape(self.shape, &port.layer)),
                _ => reach(port.reach).to_owned(),
            };
            let images = port
                .pixels
                .map(|column| format!(" with the images of `{column}`"));
            let images = images.unwrap_or_default();
            let fetched = if port.fetched {
                ", fetched one at a time"
            } else {
                ""
            };
            let optional = if port.optional { "; optional" } else { "" };
            let needed = if port.needed {
                "; where there are none, there is nothing to do"
            } else {
                ""
            };
            let _ = writeln!(
                text,
                "| `{}` | `{}`{images} | {much}{fetched}{optional}{needed} |",
                port.name, port.layer.name
            );
        }
        text
    }
}

fn reach(reach: Reach) -> &'static str {
    match reach {
        Reach::Session => "the session's rows",
        Reach::Site => "all rows of the site",
    }
}

fn shape(shape: Shape, layer: &Layer) -> String {
    match shape {
        Shape::Map => "any rows".to_owned(),
        Shape::Fold => "any rows, accumulated by key".to_owned(),
        Shape::Group(Key { columns, order }) => {
            let order = if order.is_empty() { layer.key } else { order };
            format!(
                "all rows of one {}, by {}",
                columns.join(" and "),
                order.join(", ")
            )
        }
    }
}

fn section(text: &mut String, title: &str, layer: &Layer) {
    let _ = write!(
        text,
        "\n## {title}\n\n{}\n\n| column | type | unit | frame | meaning |\n|---|---|---|---|---|\n",
        layer.doc
    );
    for column in &layer.columns {
        let _ = writeln!(
            text,
            "| `{}` | {} | {} | {} | {} |",
            column.name,
            column_type(column),
            column.unit,
            column.frame,
            column.doc
        );
    }
}

fn column_type(column: &Column) -> String {
    let null = if column.nullable { ", may be null" } else { "" };
    format!("{}{null}", type_name(&column.data_type))
}
