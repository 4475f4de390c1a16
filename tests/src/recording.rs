//! Maps exported as recordings, read by the official readers, and the same played live.

use std::collections::BTreeSet;
use std::path::Path;

use serde_json::{Value, json};

use crate::server::{Server, script};
use crate::{Finished, evermap, rows_of, text};

/// Layers whose rows a recording has, where the map has the layer.
const LAYERS: [&str; 4] = ["lanes", "parking_spaces", "placed_labels", "landmarks"];

/// Exports a map to a folder; the official readers find in it what the map says, and who watches it live gets the same.
///
/// # Panics
/// Where they do not.
pub fn is_read_as_the_map_says(map: &Path, folder: &Path) {
    let sql =
        |query: &str| -> Vec<Value> { rows_of(map, query).as_array().cloned().unwrap_or_default() };
    let poses = sql(
        "SELECT session, CAST(stamp AS BIGINT) AS stamp, map_from_vehicle['x'] AS x, map_from_vehicle['y'] AS y FROM poses",
    );
    let pose = |row: &Value| json!([row["session"], row["stamp"], row["x"], row["y"]]);
    let poses: Vec<Value> = poses.iter().map(pose).collect();
    let rows = sql("SELECT layer, rows FROM layers").into_iter();
    let mut counts = serde_json::Map::new();
    let mut has = BTreeSet::new();
    for row in rows {
        let layer = row["layer"].as_str().unwrap_or_default().to_owned();
        has.insert(layer.clone());
        if LAYERS.contains(&layer.as_str()) {
            counts.insert(layer, row["rows"].clone());
        }
    }
    let images = match has.contains("keyframes") {
        true => sql("SELECT sum(cardinality(images)) AS n FROM keyframes")[0]["n"].clone(),
        false => json!(0),
    };
    let images = if images.is_null() { json!(0) } else { images };
    let cells = |layer: &str, least: &str, greatest: &str| -> Vec<Value> {
        let query = format!(
            "SELECT \"column\", \"row\", cell_m, {least} AS least, {greatest} AS greatest FROM {layer}"
        );
        let cells = if has.contains(layer) {
            sql(&query)
        } else {
            Vec::new()
        };
        let cell = |row: &Value| {
            json!(["column", "row", "cell_m", "least", "greatest"].map(|name| row[name].clone()))
        };
        cells.iter().map(cell).collect()
    };
    let danger = cells("danger_map", "100 * danger - 0.51", "100 * danger + 0.51");
    // Rounded down, but to 1: no limit at all is none of a map's.
    let percent = "100 * speed_mps / max_mps";
    let least = format!("greatest({percent} - 1.0, 1.0)");
    let speeds = cells(
        "speed_map",
        &least,
        &format!("greatest({percent}, 1.0) + 1e-6"),
    );
    let facts = folder.join("facts.json");
    let all = json!({
        "poses": poses, "rows": counts, "images": images, "danger": danger, "speeds": speeds,
    });
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
    let server = Server::start(map, &[]);
    if let Some(mut viewer) = script("serve/live.py", &["same", &server.http, text(&out)]) {
        let watched = viewer.output().expect("python starts");
        Finished::from(watched).expect(0);
    }
}
