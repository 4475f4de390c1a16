//! Layers in the formats of other programs.

mod colmap;
mod foxglove;
mod g2o;
mod geo;
mod ground;
mod lanelet2;
mod nav2;
mod nav2_route;
mod ply;
mod tum;

use std::path::Path;

use arrow::array::RecordBatch;
use clap::{Args, ValueEnum};
use evermap_schemas::{Fault, Layer};

use crate::ending::Failure;
use crate::output::{Format, Sink, write, write_file};
use crate::reader::{MapReader, only};

/// What a layer is exported to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ExportFormat {
    /// A GeoJSON feature collection; coordinates are the map's metres, as the file says.
    Geojson,
    /// Lanes as a Lanelet2 map (OSM) in local metres, for Autoware's projector `Local`.
    Lanelet2,
    /// A speed map as a mask of Nav2's speed filter: the map's YAML, and beside it its picture (PGM).
    Nav2,
    /// Lanes as a graph (GeoJSON) of Nav2's route server, with speeds where the map has lane_speeds.
    Nav2Route,
    /// Points, as landmarks and surface_points have them, as PLY.
    Ply,
    /// A trajectory: `seconds x y z qx qy qz qw`, one pose a line.
    Tum,
    /// A pose graph: keyframe poses, odometry and loop closures between them.
    G2o,
    /// COLMAP's text model, a folder: cameras, adjusted poses with their features, landmarks.
    Colmap,
    /// The whole map, with its drives and their camera images, as a recording for Foxglove, Lichtblick and Rerun.
    Mcap,
    /// Overhead tiles as one picture with a world file beside it.
    Png,
    /// Comma separated; lists and structs are JSON.
    Csv,
    /// Parquet with the layer's columns.
    Parquet,
}

/// What is exported.
#[derive(Debug, Clone, Default, Args)]
pub struct Selection {
    /// Only rows of this session.
    #[arg(long, value_name = "NAME")]
    pub session: Option<String>,
    /// Only rows of this site.
    #[arg(long, value_name = "NAME")]
    pub site: Option<String>,
    /// Zoom level of tiles; 0 is the finest [default: the finest that fits].
    #[arg(long, value_name = "Z")]
    pub zoom: Option<u32>,
}

/// Writes a layer, or of the format MCAP the map, to a file.
///
/// # Errors
/// A user fault for a layer that has not what the format needs, a data fault for rows that make no sense.
pub async fn export(
    reader: &MapReader,
    layer: Option<&str>,
    selection: &Selection,
    format: ExportFormat,
    out: &Path,
) -> Result<(), Failure> {
    let layer = match (layer, format) {
        (None, ExportFormat::Mcap) => return foxglove::export(reader, selection, out).await,
        (Some(layer), ExportFormat::Mcap) => {
            let fault = Fault::user(format!(
                "expected no layer beside --format mcap, found {layer}"
            ));
            return Err(fault
                .next("leave it out: the recording is of the whole map")
                .into());
        }
        (None, _) => {
            let fault = Fault::user("expected the layer to export, found none");
            return Err(fault.next("evermap layers --map MAP lists them").into());
        }
        (Some(layer), _) => layer,
    };
    let written = written(reader, layer, selection, format, out).await;
    written.map_err(|failure| match failure {
        Failure::Fault(fault) => Failure::Fault(fault.at(format!("layer {layer}"))),
        other => other,
    })
}

async fn written(
    reader: &MapReader,
    layer: &str,
    selection: &Selection,
    format: ExportFormat,
    out: &Path,
) -> Result<(), Failure> {
    let site = selection.site.as_deref();
    let batches = selected(reader.map.batches(layer).await?, selection)?;
    match format {
        ExportFormat::Geojson => {
            let title = format!("{layer}, version {}", reader.map.version.version);
            geojson(&batches, reader.declaration(layer).as_ref(), &title, out)
        }
        ExportFormat::Lanelet2 => {
            let version = reader.map.version.version;
            write_file(out, lanelet2::text(&batches, site, version)?.as_bytes())
        }
        ExportFormat::Nav2 => {
            let picture = out.with_extension("pgm");
            let name = picture.file_name().unwrap_or_default().to_string_lossy();
            let mask = nav2::mask(&batches, site, &name)?;
            write_file(&picture, &mask.picture)?;
            write_file(out, mask.yaml.as_bytes())
        }
        ExportFormat::Nav2Route => {
            let graph = nav2_route::text(reader, &batches, site).await?;
            write_file(out, graph.as_bytes())
        }
        ExportFormat::Ply => write_file(out, &ply::points(&batches)?),
        ExportFormat::Tum => write_file(out, tum::text(&batches)?.as_bytes()),
        ExportFormat::G2o => {
            let graph = g2o::text(reader, &batches, site).await?;
            write_file(out, graph.as_bytes())
        }
        ExportFormat::Colmap => colmap::export(reader, &batches, site, out).await,
        ExportFormat::Mcap => Err(Fault::bug("a layer is no recording").into()),
        ExportFormat::Png => {
            let picture = ground::picture(&batches, selection.zoom)?;
            write_file(out, &picture.png()?)?;
            write_file(&out.with_extension("pgw"), picture.world_file().as_bytes())
        }
        ExportFormat::Csv => rows(Format::Csv, batches, out).await,
        ExportFormat::Parquet => rows(Format::Parquet, batches, out).await,
    }
}

/// Writes rows with a geometry as a GeoJSON file.
///
/// # Errors
/// A user fault for rows without a geometry, a resource fault for a file that cannot be written.
pub fn geojson(
    batches: &[RecordBatch],
    layer: Option<&Layer>,
    title: &str,
    out: &Path,
) -> Result<(), Failure> {
    let mut sink = Sink::file(out)?;
    geo::write(batches, layer, title, &mut sink)?;
    sink.finish()
}

/// Rows with a geometry as GeoJSON.
///
/// # Errors
/// A user fault for rows without a geometry.
pub fn geojson_text(
    batches: &[RecordBatch],
    layer: Option<&Layer>,
    title: &str,
) -> Result<Vec<u8>, Failure> {
    let mut text = Vec::new();
    geo::write(batches, layer, title, &mut text)?;
    Ok(text)
}

async fn rows(format: Format, batches: Vec<RecordBatch>, out: &Path) -> Result<(), Failure> {
    let nothing = || Fault::user("there is nothing to export");
    let schema = batches.first().ok_or_else(nothing)?.schema();
    let mut sink = Sink::file(out)?;
    let batches = futures::stream::iter(batches.into_iter().map(Ok));
    write(format, schema, batches, &mut sink).await?;
    sink.finish()
}

fn selected(batches: Vec<RecordBatch>, selection: &Selection) -> Result<Vec<RecordBatch>, Fault> {
    let mut kept = batches;
    for (column, value) in [("session", &selection.session), ("site", &selection.site)] {
        let Some(value) = value else { continue };
        let filtered = only(&kept, column, value)
            .map_err(|fault| fault.next(format!("leave --{column} out")))?;
        if !kept.is_empty() && filtered.iter().all(|batch| batch.num_rows() == 0) {
            return Err(Fault::user(format!("it has no rows of {column} {value}")));
        }
        kept = filtered;
    }
    Ok(kept)
}
