//! The data dictionary: what each column of a table is, from the declaration of its layer.

use std::collections::HashMap;

use arrow::datatypes::{DataType, Field, Schema};

use crate::{Column, Layer, record, type_name};

record! {
    /// One column of a layer, or one within it.
    #[layer("columns", key(layer, column))]
    pub struct ColumnInfo {
        /// Layer or other table, as queries name it.
        layer: String,
        /// Column. Of what is within one the path: `pose.x` of a struct, `observations[].camera` of a list's items.
        column: String,
        /// Type.
        kind: String,
        /// Unit; empty for a pure number, a name, and where nobody declared it.
        unit: String,
        /// Frame of reference; empty where there is none.
        frame: String,
        /// Whether it may be null.
        nullable: bool,
        /// Meaning; empty where nobody declared it.
        meaning: String,
        /// What a null says; null where there is none, or nobody declared it.
        null_meaning: Option<String>,
    }
}

/// The columns of a table, each followed by those within it; units and frames from its fields, or from the layer's
/// declaration where it has one.
pub fn columns(table: &str, schema: &Schema, declared: Option<&Layer>) -> Vec<ColumnInfo> {
    let mut lines = Vec::new();
    for field in schema.fields() {
        let declared = declared.and_then(|layer| layer.column(field.name()));
        let column = Noted {
            table,
            metadata: field.metadata(),
        };
        column.add(field.name(), "", field, declared, &mut lines);
    }
    lines
}

/// A column of a table, whose metadata say what is known of it and of what is within it.
struct Noted<'s> {
    table: &'s str,
    metadata: &'s HashMap<String, String>,
}

impl Noted<'_> {
    /// Adds the column, or one within it, and those within that. `path` is where it is, `noted` where its metadata are.
    fn add(
        &self,
        path: &str,
        noted: &str,
        field: &Field,
        declared: Option<&Column>,
        lines: &mut Vec<ColumnInfo>,
    ) {
        let note = |key: &str, declared: Option<&str>| {
            let found = self.metadata.get(&format!("{noted}{key}"));
            let found = found.map(String::as_str);
            found.or(declared).unwrap_or_default().to_owned()
        };
        let meaning = declared.map_or("", |column| column.doc.as_str());
        lines.push(ColumnInfo {
            layer: self.table.to_owned(),
            column: path.to_owned(),
            kind: type_name(field.data_type()),
            unit: note("unit", declared.map(|column| column.unit)),
            frame: note("frame", declared.map(|column| column.frame)),
            nullable: field.is_nullable(),
            meaning: meaning.to_owned(),
            null_meaning: null_meaning(meaning).filter(|_| field.is_nullable()),
        });
        let (items, members) = match field.data_type() {
            DataType::Struct(fields) => ("", fields),
            DataType::List(item) | DataType::FixedSizeList(item, _) => match item.data_type() {
                DataType::Struct(fields) => ("[]", fields),
                _ => return,
            },
            _ => return,
        };
        for member in members {
            let name = member.name();
            let (path, noted) = (format!("{path}{items}.{name}"), format!("{noted}{name}."));
            let mut declared = declared.into_iter().flat_map(|column| &column.members);
            let declared = declared.find(|column| column.name == name);
            self.add(&path, &noted, member, declared, lines);
        }
    }
}

/// What a column's documentation says of nulls: `Height; null where it was not measured.` says `where it was not
/// measured`.
fn null_meaning(doc: &str) -> Option<String> {
    let clause = |at: usize| {
        let alone = doc
            .get(..at)?
            .chars()
            .next_back()
            .is_none_or(|c| !c.is_alphabetic());
        let rest = doc.get(at + "null ".len()..).filter(|_| alone)?;
        let stop = rest.find(['.', ';']).unwrap_or(rest.len());
        rest.get(..stop).map(str::to_owned)
    };
    let places = doc.match_indices("null ").chain(doc.match_indices("Null "));
    let clauses: Vec<String> = places.filter_map(|(at, _)| clause(at)).collect();
    (!clauses.is_empty()).then(|| clauses.join("; "))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::LayerRow;
    use crate::layers::{AdjustedPose, Keyframe, all};

    #[test]
    fn what_is_within_a_column_has_its_unit_and_its_meaning() {
        let layer = AdjustedPose::layer();
        let lines = columns("poses", &layer.schema(), Some(&layer));
        let of = |name: &str| lines.iter().find(|line| line.column == name).unwrap();
        let residual = of("observations[].residual_px");
        assert_eq!(
            (residual.kind.as_str(), residual.unit.as_str()),
            ("f32", "px")
        );
        assert!(!residual.meaning.is_empty());
        assert_eq!(of("map_from_vehicle.x").unit, "m");
        assert_eq!(of("map_from_vehicle").frame, "map");
        assert!(lines.iter().all(|line| line.layer == "poses"));
    }

    #[test]
    fn units_come_from_the_declaration_where_a_file_has_none() {
        let layer = Keyframe::layer();
        let found = columns("keyframes", &layer.schema(), None);
        let bare = layer.schema();
        let bare = bare.fields().iter();
        let bare = bare.map(|field| field.as_ref().clone().with_metadata(Default::default()));
        let bare = Schema::new(bare.collect::<Vec<_>>());
        let declared = columns("keyframes", &bare, Some(&layer));
        for (a, b) in declared.iter().zip(&found) {
            assert_eq!((&a.unit, &a.frame), (&b.unit, &b.frame), "{}", a.column);
            assert!(!a.meaning.is_empty());
        }
        let distance = found
            .iter()
            .find(|line| line.column == "distance_m")
            .unwrap();
        assert_eq!(
            (distance.kind.as_str(), distance.unit.as_str()),
            ("f64", "m")
        );
    }

    /// Whoever adds a column that may be null says what a null means.
    #[test]
    fn every_column_of_every_layer_has_a_meaning_and_every_null_too() {
        let mut silent = Vec::new();
        for layer in all() {
            for line in columns(layer.name, &layer.schema(), Some(&layer)) {
                assert!(!line.meaning.is_empty(), "{}.{}", layer.name, line.column);
                if line.nullable && line.null_meaning.is_none() {
                    silent.push(format!("{}.{}: {}", layer.name, line.column, line.meaning));
                }
            }
        }
        assert!(silent.is_empty(), "{}", silent.join("\n"));
    }

    #[test]
    fn nulls_are_told_in_any_part_of_a_sentence() {
        let meaning = |doc: &str| null_meaning(doc);
        assert_eq!(
            meaning("Height; null where it was not measured.").as_deref(),
            Some("where it was not measured")
        );
        assert_eq!(
            meaning("Height. Null for a flat one; else metres.").as_deref(),
            Some("for a flat one")
        );
        assert_eq!(meaning("Annull where it is."), None);
    }
}
