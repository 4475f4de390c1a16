//! The layers of a map, declared once.
//!
//! A *layer* is a named table whose columns carry a unit, a frame and a sentence of documentation.
//! Each layer is one Rust struct, declared with [`record!`] in [`layers`]; from that one place come the Arrow
//! schema, the typed rows that kernels read and write, and the reference page.
//!
//! ```text
//!   record! { struct Pose.. }  ──►  Record (columns) ──►  Layer::schema()   Arrow, with units and frames
//!                                       │
//!                                       └────────────►  rows ⇄ RecordBatch  typed, checked, no by-hand downcasts
//! ```
//!
//! This crate knows Arrow and nothing above it: no operators, no engine, no files.

mod cell;
pub mod dictionary;
mod fault;
mod geometry;
pub mod geoparquet;
mod layer;
pub mod layers;
mod record;
pub mod roles;
mod type_name;
mod values;
mod wkb;

pub use cell::Cell;
pub use fault::{Fault, Kind};
pub use geometry::{Geometry, Position};
pub use layer::{Layer, LayerRow, batch, column, rows};
#[doc(hidden)]
pub use record::decode_column;
pub use record::{Column, Record};
pub use type_name::{type_name, type_named};
pub use values::{Bytes, ImageRef, Pose, Stamp};
pub use wkb::Wkb;

#[doc(hidden)]
pub use arrow;

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::collections::BTreeMap;

    use super::*;

    record! {
        /// Everything a cell can be.
        #[layer("samples", key(name))]
        pub struct Sample {
            /// Text.
            name: String,
            /// Perhaps a number.
            height_m: Option<f64> ["m", "map"],
            /// A list of structs.
            poses: Vec<Pose>,
            /// A list of points.
            points: Vec<[f64; 3]>,
            /// Perhaps a struct.
            pose: Option<Pose>,
            /// Perhaps bytes.
            bytes: Option<Bytes>,
            /// Text by text.
            notes: BTreeMap<String, String>,
        }
    }

    fn samples() -> Vec<Sample> {
        let full = Sample {
            name: "a".into(),
            height_m: Some(2.0),
            poses: vec![
                Pose::IDENTITY,
                Pose {
                    x: 3.0,
                    ..Pose::IDENTITY
                },
            ],
            points: vec![[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]],
            pose: Some(Pose::IDENTITY),
            bytes: Some(Bytes(vec![1, 2])),
            notes: BTreeMap::from([("by".into(), "me".into()), ("of".into(), "it".into())]),
        };
        let empty = Sample {
            name: "b".into(),
            height_m: None,
            poses: vec![],
            points: vec![],
            pose: None,
            bytes: None,
            notes: BTreeMap::new(),
        };
        vec![full.clone(), empty.clone(), full, empty]
    }

    #[test]
    fn rows_survive_a_round_trip_and_a_slice() {
        let table = batch(samples()).unwrap();
        assert_eq!(rows::<Sample>(&table).unwrap(), samples());
        assert_eq!(rows::<Sample>(&table.slice(1, 2)).unwrap(), samples()[1..3]);
        assert_eq!(rows::<Sample>(&table.slice(4, 0)).unwrap(), vec![]);
        assert_eq!(
            rows::<Sample>(&batch::<Sample>(vec![]).unwrap()).unwrap(),
            vec![]
        );
    }

    #[test]
    fn units_and_frames_are_field_metadata() {
        let schema = Sample::layer().schema();
        let field = schema.field_with_name("height_m").unwrap();
        assert_eq!(field.metadata().get("unit").map(String::as_str), Some("m"));
        assert_eq!(
            field.metadata().get("frame").map(String::as_str),
            Some("map")
        );
        assert!(field.is_nullable());
        // Those of what is within a column stand beside its own.
        let poses = schema.field_with_name("poses").unwrap().metadata();
        assert_eq!(poses.get("x.unit").map(String::as_str), Some("m"));
        assert!(!poses.contains_key("unit") && !poses.contains_key("qw.unit"));
    }

    #[test]
    fn what_was_stored_before_a_nullable_column_was_declared_is_null_there() {
        let table = batch(samples()).unwrap();
        // Without the height and the pose.
        let older = table.project(&[0, 2, 3, 5, 6]).unwrap();
        let mut expected = samples();
        for sample in &mut expected {
            (sample.height_m, sample.pose) = (None, None);
        }
        assert_eq!(rows::<Sample>(&older).unwrap(), expected);
        assert_eq!(rows::<Sample>(&older.slice(3, 0)).unwrap(), vec![]);
    }

    #[test]
    fn a_missing_or_wrong_column_is_named() {
        let table = batch(samples()).unwrap();
        let without = table.project(&[0, 1]).unwrap();
        assert!(
            rows::<Sample>(&without)
                .unwrap_err()
                .to_string()
                .contains("expected a column poses")
        );
    }

    #[test]
    fn every_layer_key_is_a_column_and_every_column_is_documented() {
        for layer in layers::all() {
            assert!(
                layer.key.iter().all(|key| layer.column(key).is_some()),
                "{}",
                layer.name
            );
            assert!(
                layer.columns.iter().all(|column| !column.doc.is_empty()),
                "{}",
                layer.name
            );
            assert!(
                layer
                    .geometry
                    .is_none_or(|geometry| layer.column(geometry).is_some()),
                "{}",
                layer.name
            );
        }
    }
}
