//! GeoJSON. Its standard means longitude and latitude; where a map has local metres, the file says so.

use std::io::Write;

use arrow::array::{Array, AsArray, RecordBatch};
use arrow::datatypes::DataType;
use arrow::json::writer::{JsonArray, WriterBuilder};
use evermap_schemas::{Fault, Layer, Wkb};
use serde_json::{Map, Value, json};

use crate::earth::{Coordinates, Earth};
use crate::ending::Failure;
use crate::export::placed;
use crate::output::RowWriter;

const LOCAL: &str = "local metres in the map frame (x, y, z up), not longitude and latitude";
/// What a file says whose coordinates are longitude and latitude.
pub const ON_EARTH: &str = "longitude and latitude (WGS 84), height above the ellipsoid in metres";

/// What a file begins with.
#[derive(Debug, Clone, Copy)]
pub struct Head<'a> {
    /// What it is of.
    pub title: &'a str,
    /// Whether its geometries are longitude and latitude.
    pub on_earth: bool,
}

/// A feature collection on its way out: one feature a row, all other columns as its properties. `layer` says which column
/// is the geometry, `earth` where on earth its site lies.
pub struct GeoJson<'a, W> {
    layer: Option<&'a Layer>,
    earth: &'a Earth,
    out: W,
    is_first: bool,
}

impl<'a, W: Write> GeoJson<'a, W> {
    /// One with its head, and no feature yet.
    ///
    /// # Errors
    /// That the output is closed or full.
    pub fn begin(
        head: Head<'_>,
        layer: Option<&'a Layer>,
        earth: &'a Earth,
        mut out: W,
    ) -> Result<Self, Failure> {
        let coordinates = if head.on_earth { ON_EARTH } else { LOCAL };
        let head = json!({ "name": head.title, "coordinates": coordinates }).to_string();
        let head = head
            .strip_prefix('{')
            .and_then(|head| head.strip_suffix('}'))
            .unwrap_or_default();
        write!(
            out,
            "{{\"type\":\"FeatureCollection\",{head},\"features\":["
        )?;
        Ok(Self {
            layer,
            earth,
            out,
            is_first: true,
        })
    }
}

impl<W: Write + Send> RowWriter for GeoJson<'_, W> {
    fn write(&mut self, batch: &RecordBatch) -> Result<(), Failure> {
        let batch = placed(batch, self.layer, self.earth, Coordinates::Degrees)?;
        for feature in features(&batch, self.layer)? {
            let between: &[u8] = if self.is_first { b"\n" } else { b",\n" };
            self.is_first = false;
            self.out.write_all(between)?;
            self.out.write_all(feature.to_string().as_bytes())?;
        }
        Ok(())
    }

    fn copies(&self) -> usize {
        3
    }

    fn finish(mut self: Box<Self>) -> Result<(), Failure> {
        Ok(self.out.write_all(b"\n]}\n")?)
    }
}

fn features(batch: &RecordBatch, layer: Option<&Layer>) -> Result<Vec<Value>, Fault> {
    let name = layer.and_then(|layer| layer.geometry).unwrap_or("geometry");
    let geometry = batch
        .column_by_name(name)
        .filter(|column| *column.data_type() == DataType::Binary);
    let Some(geometry) = geometry.map(|column| column.as_binary::<i32>()) else {
        return Err(Fault::user("it has no geometry").next("choose csv or parquet"));
    };
    let shape = |bytes: &[u8]| Wkb(bytes.to_vec()).geojson();
    let shapes = geometry
        .iter()
        .map(|bytes| bytes.map_or(Ok(Value::Null), shape));
    let rows = properties(batch)?.into_iter();
    shapes
        .zip(rows)
        .map(|(shape, row)| Ok(json!({ "type": "Feature", "geometry": shape?, "properties": row })))
        .collect()
}

/// The rows as JSON objects, without columns of bytes.
fn properties(batch: &RecordBatch) -> Result<Vec<Map<String, Value>>, Fault> {
    let kept: Vec<usize> = (0..batch.num_columns())
        .filter(|&index| !batch.schema_ref().field(index).data_type().is_binary())
        .collect();
    let mut bytes = Vec::new();
    let mut writer = WriterBuilder::new()
        .with_explicit_nulls(true)
        .build::<_, JsonArray>(&mut bytes);
    writer.write(&batch.project(&kept)?)?;
    writer.finish()?;
    serde_json::from_slice(&bytes).map_err(|error| Fault::bug(error.to_string()))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use evermap_engine::sql::Term;
    use evermap_schemas::layers::Intersection;
    use evermap_schemas::{LayerRow, batch};

    use crate::export::geojson;

    const LOT: Head<'_> = Head {
        title: "places",
        on_earth: false,
    };

    fn crossing() -> Intersection {
        Intersection {
            site: "lot".into(),
            node: 4,
            degree: 3,
            x: 1.0,
            y: 2.0,
            z: 0.5,
            sources: vec![],
            geometry: Wkb::point([1.0, 2.0, 0.5]),
        }
    }

    /// What is written is no whole file then, and is not taken for one.
    #[tokio::test]
    async fn features_are_left_where_the_command_is_stopped() {
        let rows = batch(vec![crossing()]).unwrap();
        let (layer, earth, term) = (Intersection::layer(), Earth::default(), Term::default());
        let write = || async {
            let mut text = Vec::<u8>::new();
            geojson(
                vec![rows.clone()],
                Some(&layer),
                "places",
                &earth,
                &mut text,
            )
        };
        assert!(term.of(write()).await.is_ok());
        term.end();
        assert!(term.of(write()).await.is_err());
    }

    #[test]
    fn features_have_shapes_and_properties() {
        let rows = batch(vec![crossing(), crossing()]).unwrap();
        let (mut text, earth) = (Vec::<u8>::new(), Earth::default());
        let layer = Intersection::layer();
        let begun = GeoJson::begin(LOT, Some(&layer), &earth, &mut text);
        let mut written = Box::new(begun.unwrap());
        for batch in [rows.slice(0, 1), rows.slice(1, 1)] {
            written.write(&batch).unwrap();
        }
        written.finish().unwrap();
        let value: Value = serde_json::from_slice(&text).unwrap();
        assert_eq!(value["type"], "FeatureCollection");
        assert!(
            value["coordinates"]
                .as_str()
                .unwrap()
                .contains("local metres")
        );
        assert_eq!(value["features"].as_array().unwrap().len(), 2);
        let feature = &value["features"][1];
        assert_eq!(
            feature["geometry"],
            json!({"type": "Point", "coordinates": [1.0, 2.0, 0.5]})
        );
        assert_eq!(feature["properties"]["degree"], 3);
        assert!(feature["properties"].get("geometry").is_none());
        let plain = rows.project(&[0, 1]).unwrap();
        let mut other = GeoJson::begin(LOT, None, &earth, &mut text).unwrap();
        assert!(matches!(other.write(&plain), Err(Failure::Fault(_))));
    }
}
