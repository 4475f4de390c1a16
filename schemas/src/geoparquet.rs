//! What a Parquet file says of its geometries: GeoParquet 1.1.

use std::collections::BTreeSet;

use arrow::array::{AsArray, RecordBatch};
use arrow::datatypes::DataType;
use serde_json::{Value, json};

use crate::{Geometry, Position};

/// The key of the metadata.
pub const KEY: &str = "geo";

/// Name of the column whose values are taken for geometries where nobody declares one.
pub const COLUMN: &str = "geometry";

/// What is known of a column of geometries while rows go by.
#[derive(Debug, Clone)]
pub struct GeoColumn {
    name: String,
    types: BTreeSet<String>,
    /// Least and greatest x, y and z.
    bounds: [[f64; 2]; 3],
    has_heights: bool,
}

impl GeoColumn {
    /// Of the column of this name, well-known binary.
    pub fn new(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            types: BTreeSet::new(),
            bounds: [[f64::INFINITY, f64::NEG_INFINITY]; 3],
            has_heights: false,
        }
    }

    /// Looks at the rows of a batch. What is no geometry is passed over.
    pub fn add(&mut self, batch: &RecordBatch) {
        let Some(column) = batch.column_by_name(&self.name) else {
            return;
        };
        match column.data_type() {
            DataType::Binary => self.add_all(column.as_binary::<i32>().iter()),
            DataType::BinaryView => self.add_all(column.as_binary_view().iter()),
            _ => {}
        }
    }

    /// Whether no geometry was seen.
    pub fn is_empty(&self) -> bool {
        self.types.is_empty()
    }

    fn add_all<'b>(&mut self, values: impl Iterator<Item = Option<&'b [u8]>>) {
        for bytes in values.flatten() {
            if let Ok(geometry) = Geometry::from_wkb(bytes) {
                self.add_geometry(&geometry);
            }
        }
    }

    fn add_geometry(&mut self, geometry: &Geometry) {
        let paths = geometry.paths();
        let mut points = paths.into_iter().flatten().peekable();
        let has_height = points.peek().is_some_and(|point| point.z.is_some());
        self.has_heights |= has_height;
        let suffix = if has_height { " Z" } else { "" };
        self.types.insert(format!("{}{suffix}", geometry.kind()));
        for point in points {
            self.add_position(*point);
        }
    }

    fn add_position(&mut self, Position { x, y, z }: Position) {
        let values = [Some(x), Some(y), z];
        for ([least, most], value) in self.bounds.iter_mut().zip(values) {
            if let Some(value) = value.filter(|value| value.is_finite()) {
                *least = least.min(value);
                *most = most.max(value);
            }
        }
    }

    /// The metadata, as JSON. `crs` is PROJJSON, or null for local metres: without the key, readers would take them for
    /// WGS 84.
    pub fn metadata(&self, crs: &Value) -> String {
        let mut column = json!({
            "encoding": "WKB",
            "geometry_types": self.types,
            "crs": crs,
            "edges": "planar",
        });
        let axes = if self.has_heights { 3 } else { 2 };
        let bounds = &self.bounds[..axes];
        if bounds.iter().all(|[least, most]| least <= most) {
            let least = bounds.iter().map(|[least, _]| *least);
            let most = bounds.iter().map(|[_, most]| *most);
            column["bbox"] = least.chain(most).collect();
        }
        json!({
            "version": "1.1.0",
            "primary_column": self.name,
            "columns": { &self.name: column },
        })
        .to_string()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::layers::Intersection;
    use crate::{Wkb, batch};

    fn place(geometry: Wkb) -> Intersection {
        Intersection {
            site: "lot".into(),
            node: 1,
            degree: 3,
            x: 0.0,
            y: 0.0,
            z: 0.0,
            sources: vec![],
            geometry,
        }
    }

    #[test]
    fn kinds_and_bounds_are_those_of_all_rows() {
        let mut column = GeoColumn::new("geometry");
        let rows = [
            Wkb::point([1.0, 2.0, 0.5]),
            Wkb::line_string(&[[-1.0, 5.0, 0.0], [3.0, 4.0, 1.0]]),
            Wkb(vec![9]),
        ];
        column.add(&batch(rows.map(place).to_vec()).unwrap());
        let found: Value = serde_json::from_str(&column.metadata(&Value::Null)).unwrap();
        let column = &found["columns"]["geometry"];
        assert_eq!(column["geometry_types"], json!(["LineString Z", "Point Z"]));
        assert_eq!(column["bbox"], json!([-1.0, 2.0, 0.0, 3.0, 5.0, 1.0]));
        assert!(column.as_object().unwrap().contains_key("crs"));
    }

    #[test]
    fn a_column_without_rows_has_no_bounds() {
        let column = GeoColumn::new("geometry");
        let found: Value = serde_json::from_str(&column.metadata(&Value::Null)).unwrap();
        assert!(found["columns"]["geometry"].get("bbox").is_none());
    }
}
