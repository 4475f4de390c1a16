//! Maps exported as recordings, read by the official readers.

use std::path::Path;

use serde_json::{Value, json};

use crate::server::script;
use crate::{Finished, evermap, text};

/// Layers whose rows a recording has, where the map has the layer.
const LAYERS: [&str; 4] = ["lanes", "parking_spaces", "placed_labels", "landmarks"];

/// Exports a map to a folder; the official readers find in it what the map says.
///
/// # Panics
/// Where they do not.
pub fn is_read_as_the_map_says(map: &Path, folder: &Path) {
    let sql = |query: &str| -> Vec<Value> {
        let answer = evermap(&["sql", "--map", text(map), "--format", "json", query]);
        let rows = answer.expect(0).json();
        rows.as_array().cloned().unwrap_or_default()
    };
    let poses = sql(
        "SELECT session, CAST(stamp AS BIGINT) AS stamp, map_from_vehicle['x'] AS x, map_from_vehicle['y'] AS y FROM poses",
    );
    let pose = |row: &Value| json!([row["session"], row["stamp"], row["x"], row["y"]]);
    let poses: Vec<Value> = poses.iter().map(pose).collect();
    let rows = sql("SELECT layer, rows FROM layers").into_iter();
    let mut counts = serde_json::Map::new();
    let mut has_keyframes = false;
    for row in rows {
        let layer = row["layer"].as_str().unwrap_or_default().to_owned();
        has_keyframes |= layer == "keyframes";
        if LAYERS.contains(&layer.as_str()) {
            counts.insert(layer, row["rows"].clone());
        }
    }
    let images = match has_keyframes {
        true => sql("SELECT sum(cardinality(images)) AS n FROM keyframes")[0]["n"].clone(),
        false => json!(0),
    };
    let images = if images.is_null() { json!(0) } else { images };
    let facts = folder.join("facts.json");
    let all = json!({ "poses": poses, "rows": counts, "images": images });
    std::fs::write(&facts, all.to_string()).expect("the folder can be written");
    let out = folder.join("recording.mcap");
    let export = [
        "export",
        "--map",
        text(map),
        "--format",
        "mcap",
        "--out",
        text(&out),
    ];
    evermap(&export).expect(0);
    let Some(mut reader) = script("exports/recording.py", &[text(&out), text(&facts)]) else {
        return;
    };
    let read = reader.output().expect("python starts");
    Finished::from(read).expect(0);
}
