//! Tables and columns for people.

use arrow::datatypes::Schema;
use evermap_schemas::{Layer, record, type_name};

record! {
    /// One column of a table.
    #[layer("columns", key(column))]
    pub struct ColumnLine {
        /// Column.
        column: String,
        /// Type.
        kind: String,
        /// Unit.
        unit: String,
        /// Frame of reference.
        frame: String,
        /// Whether it may be null.
        nullable: bool,
        /// Meaning.
        meaning: String,
    }
}

record! {
    /// One table.
    #[layer("tables", key(table))]
    pub struct TableLine {
        /// Table, as a query names it.
        table: String,
        /// Columns.
        columns: u32,
        /// What one row is.
        rows_are: String,
    }
}

/// The columns of a table; units and frames from its fields, or from the layer's declaration where it has one.
pub fn columns(schema: &Schema, declared: Option<&Layer>) -> Vec<ColumnLine> {
    let line = |field: &std::sync::Arc<arrow::datatypes::Field>| {
        let column = declared.and_then(|layer| layer.column(field.name()));
        let note = |key: &str, declared: Option<&str>| {
            let found = field.metadata().get(key).map(String::as_str);
            found.or(declared).unwrap_or_default().to_owned()
        };
        ColumnLine {
            column: field.name().clone(),
            kind: type_name(field.data_type()),
            unit: note("unit", column.map(|column| column.unit)),
            frame: note("frame", column.map(|column| column.frame)),
            nullable: field.is_nullable(),
            meaning: column.map(|column| column.doc.clone()).unwrap_or_default(),
        }
    };
    schema.fields().iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use evermap_schemas::LayerRow;
    use evermap_schemas::layers::Keyframe;

    #[test]
    fn types_are_short_and_units_are_found() {
        let layer = Keyframe::layer();
        let found = columns(&layer.schema(), None);
        let of = |name: &str| {
            found
                .iter()
                .find(|line| line.column == name)
                .map(|line| (line.kind.as_str(), line.unit.as_str()))
        };
        assert_eq!(of("stamp"), Some(("time", "ns")));
        assert_eq!(of("keyframe"), Some(("u32", "")));
        assert_eq!(of("distance_m"), Some(("f64", "m")));
        assert_eq!(
            of("images"),
            Some(("list of struct of camera, stamp, image", ""))
        );
        let bare = Schema::new(
            layer
                .schema()
                .fields()
                .iter()
                .map(|field| field.as_ref().clone().with_metadata(Default::default()))
                .collect::<Vec<_>>(),
        );
        let declared = columns(&bare, Some(&layer));
        assert!(
            declared
                .iter()
                .zip(&found)
                .all(|(a, b)| a.unit == b.unit && a.frame == b.frame && !a.meaning.is_empty())
        );
    }
}
