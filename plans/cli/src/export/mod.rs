//! Layers in the formats of other programs.

mod colmap;
mod g2o;
mod geo;
mod ground;
mod metric;
mod tum;

use std::path::Path;

use arrow::array::{Array, AsArray, BooleanArray, RecordBatch};
use arrow::compute::filter_record_batch;
use arrow::datatypes::DataType;
use clap::ValueEnum;
use evermap_contract::Registry;
use evermap_engine::map::Map;
use evermap_schemas::{Fault, Layer};

use crate::ending::Failure;
use crate::output::{Format, Sink, write, write_file};

/// What a layer is exported to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ExportFormat {
    /// A GeoJSON feature collection; coordinates are the map's metres, as the file says.
    Geojson,
    /// A trajectory: `seconds x y z qx qy qz qw`, one pose a line.
    Tum,
    /// A pose graph: keyframe poses, odometry and loop closures between them.
    G2o,
    /// COLMAP's text model, a folder: cameras, adjusted poses with their features, landmarks.
    Colmap,
    /// Overhead tiles as one picture with a world file beside it.
    Png,
    /// Comma separated; lists and structs are JSON.
    Csv,
    /// Parquet with the layer's columns.
    Parquet,
}

/// What is exported.
#[derive(Debug, Clone, Default)]
pub struct Selection {
    /// Only this session's rows.
    pub session: Option<String>,
    /// Only this site's rows.
    pub site: Option<String>,
    /// Zoom level of tiles; the finest that fits where none is given.
    pub zoom: Option<u32>,
}

/// Writes a layer to a file.
///
/// # Errors
/// A user fault for a layer that has not what the format needs, a data fault for rows that make no sense.
pub async fn export(
    map: &Map,
    registry: &Registry,
    layer: &str,
    selection: &Selection,
    format: ExportFormat,
    out: &Path,
) -> Result<(), Failure> {
    if format == ExportFormat::Colmap {
        return colmap::export(map, registry, layer, selection, out)
            .await
            .map_err(|failure| at(failure, layer));
    }
    let batches = selected(map.batches(layer).await?, layer, selection)?;
    let declared = declaration(map, registry, layer);
    let place = |fault: Fault| fault.at(format!("layer {layer}"));
    match format {
        ExportFormat::Geojson => {
            let title = format!("{layer}, version {}", map.version.version);
            let mut sink = Sink::file(out)?;
            geo::write(&batches, declared.as_ref(), &title, &mut sink)
                .map_err(|failure| at(failure, layer))?;
            sink.finish()
        }
        ExportFormat::Tum => write_file(out, tum::text(&batches).map_err(place)?.as_bytes()),
        ExportFormat::G2o => {
            let graph = g2o::text(map, registry, &batches, selection.site.as_deref()).await;
            write_file(out, graph.map_err(place)?.as_bytes())
        }
        ExportFormat::Colmap => Ok(()),
        ExportFormat::Png => {
            let picture = ground::picture(&batches, selection.zoom).map_err(place)?;
            write_file(out, &picture.png()?)?;
            write_file(&out.with_extension("pgw"), picture.world_file().as_bytes())
        }
        ExportFormat::Csv => rows(Format::Csv, batches, layer, out).await,
        ExportFormat::Parquet => rows(Format::Parquet, batches, layer, out).await,
    }
}

fn at(failure: Failure, layer: &str) -> Failure {
    match failure {
        Failure::Fault(fault) => Failure::Fault(fault.at(format!("layer {layer}"))),
        other => other,
    }
}

async fn rows(
    format: Format,
    batches: Vec<RecordBatch>,
    layer: &str,
    out: &Path,
) -> Result<(), Failure> {
    let schema = batches
        .first()
        .map(RecordBatch::schema)
        .ok_or_else(|| nothing(layer))?;
    let mut sink = Sink::file(out)?;
    write(
        format,
        schema,
        futures::stream::iter(batches.into_iter().map(Ok)),
        &mut sink,
    )
    .await?;
    sink.finish()
}

fn nothing(layer: &str) -> Fault {
    Fault::user(format!("there is nothing of {layer} to export"))
}

/// The declaration of a map's layer, where an operator makes it.
pub fn declaration(map: &Map, registry: &Registry, layer: &str) -> Option<Layer> {
    let op = map.version.layers.get(layer)?.op.as_deref()?;
    registry.get(op).ok().map(|entry| entry.output.clone())
}

fn selected(
    batches: Vec<RecordBatch>,
    layer: &str,
    selection: &Selection,
) -> Result<Vec<RecordBatch>, Fault> {
    let mut kept = batches;
    for (column, value) in [("session", &selection.session), ("site", &selection.site)] {
        let Some(value) = value else { continue };
        let filtered = kept
            .iter()
            .map(|batch| only(batch, column, value, layer))
            .collect::<Result<Vec<_>, _>>()?;
        if !kept.is_empty() && filtered.iter().all(|batch| batch.num_rows() == 0) {
            return Err(Fault::user(format!(
                "{layer} has no rows of {column} {value}"
            )));
        }
        kept = filtered;
    }
    Ok(kept)
}

fn only(batch: &RecordBatch, column: &str, value: &str, layer: &str) -> Result<RecordBatch, Fault> {
    let found = batch
        .column_by_name(column)
        .filter(|found| *found.data_type() == DataType::Utf8);
    let Some(found) = found else {
        return Err(Fault::user(format!("{layer} has no column {column}"))
            .next(format!("leave --{column} out")));
    };
    let keep: BooleanArray = found
        .as_string::<i32>()
        .iter()
        .map(|text| Some(text == Some(value)))
        .collect();
    Ok(filter_record_batch(batch, &keep)?)
}
