//! Layers in the formats of other programs.

mod colmap;
pub(crate) mod foxglove;
mod g2o;
mod geo;
mod geotiff;
mod ground;
mod lanelet2;
mod nav2;
mod nav2_route;
mod person_images;
mod ply;
mod tum;

use std::collections::{BTreeSet, HashMap};
use std::io::Write;
use std::path::Path;
use std::sync::Arc;

use arrow::array::RecordBatch;
use clap::{Args, ValueEnum};
use evermap_engine::sql::Term;
use evermap_engine::sql::described::{noted, notes};
use evermap_schemas::{Fault, Layer};

use crate::arguments::ExportArgs;
use crate::earth::{Coordinates, Earth, beside, on_earth};
use crate::ending::{DONE, Ending, Failure};
pub use crate::export::geo::{GeoJson, Head, ON_EARTH};
use crate::output::{
    CRS, Format, GEOMETRY, RowWriter, Sink, pieces, write, write_file, write_together,
};
use crate::reader::{MapReader, nothing, only, texts};

/// What a layer is exported to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ExportFormat {
    /// A GeoJSON feature collection; longitude and latitude where the map has georeference, else the map's metres, as the
    /// file says.
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
    /// Questions about people as a folder: the camera images, and the boxes that are asked about for programs that people
    /// annotate with (coco.json, label_studio.json). `evermap annotate --images` reads what they answered.
    Coco,
    /// The whole map, with its drives and their camera images, as a recording for Foxglove, Lichtblick and Rerun.
    Mcap,
    /// Overhead tiles as one picture with a world file beside it, and where on earth that is.
    Png,
    /// Overhead tiles as one Cloud Optimized GeoTIFF with overviews, transparent where nothing was seen; it says itself where it is.
    Geotiff,
    /// Comma separated; lists and structs are JSON.
    Csv,
    /// GeoParquet with the layer's columns; its geometries lie on earth where the map has georeference.
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
    /// Of questions, the first so many (coco).
    #[arg(long, value_name = "N", default_value_t = 100)]
    pub questions: u32,
    /// Geometries stay in the map's metres, wherever on earth it lies (geojson, parquet, png, geotiff).
    #[arg(long)]
    pub local: bool,
}

/// `evermap export`: writes a layer, or of the format MCAP the map, to a file.
///
/// # Errors
/// A user fault for a layer that has not what the format needs, a data fault for rows that make no sense.
pub async fn export(args: &ExportArgs) -> Ending {
    let reader = MapReader::open(&args.map.map, args.map.version).await?;
    let layer = match (args.layer.as_deref(), args.format) {
        (None, ExportFormat::Mcap) => {
            return foxglove::export(&reader, &args.selection, &args.out).await;
        }
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
        (Some(layer), ExportFormat::Coco) => {
            let lost = person_images::export(&reader, layer, &args.selection, &args.out).await;
            return lost.map_err(|failure| of_layer(failure, layer));
        }
        (Some(layer), _) => layer,
    };
    let written = written(&reader, layer, args).await;
    written.map_err(|failure| of_layer(failure, layer))?;
    DONE
}

fn of_layer(failure: Failure, layer: &str) -> Failure {
    match failure {
        Failure::Fault(fault) => Failure::Fault(fault.at(format!("layer {layer}"))),
        other => other,
    }
}

async fn written(reader: &MapReader, layer: &str, args: &ExportArgs) -> Result<(), Failure> {
    let (selection, out) = (&args.selection, args.out.as_path());
    let site = selection.site.as_deref();
    let batches = selected(reader.map.batches(layer).await?, selection)?;
    let earth = match selection.local {
        true => Earth::default(),
        false => Earth::of(reader).await?,
    };
    let declared = reader.declaration(layer);
    match args.format {
        ExportFormat::Geojson => {
            let title = format!("{layer}, version {}", reader.map.version.version);
            let mut sink = Sink::file(out)?;
            geojson(batches, declared.as_ref(), &title, &earth, &mut sink)?;
            sink.finish()
        }
        ExportFormat::Lanelet2 => {
            let version = reader.map.version.version;
            write_file(out, lanelet2::text(&batches, site, version)?.as_bytes())
        }
        ExportFormat::Nav2 => {
            let picture = out.with_extension("pgm");
            let name = picture.file_name().unwrap_or_default().to_string_lossy();
            let mask = nav2::mask(&batches, site, &name)?;
            let yaml = (out.to_owned(), mask.yaml.as_bytes());
            write_together(&[(picture, &mask.picture), yaml])
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
        ExportFormat::Coco | ExportFormat::Mcap => {
            Err(Fault::bug("a layer cannot be exported as a file of its own").into())
        }
        ExportFormat::Png => {
            let (picture, site) = ground::picture(&batches, selection.zoom)?;
            let (png, place) = (picture.png()?, earth.place(&site));
            let world = picture.world_file(place);
            let dataset = place.map(|place| place.pam_dataset());
            let mut files = vec![
                (out.to_owned(), png.as_slice()),
                (out.with_extension("pgw"), world.as_bytes()),
            ];
            files.extend(dataset.iter().map(|text| (beside(out), text.as_bytes())));
            write_together(&files)?;
            if dataset.is_none() {
                // One of an earlier export would be believed.
                let _ = std::fs::remove_file(beside(out));
            }
            Ok(())
        }
        ExportFormat::Geotiff => {
            let (picture, site) = ground::picture(&batches, selection.zoom)?;
            let file = geotiff::bytes(&picture, earth.place(&site))?;
            write_file(out, &file)
        }
        ExportFormat::Csv => rows(Format::Csv, batches, out).await,
        ExportFormat::Parquet => {
            let described = reader.described(layer).await?;
            let notes = notes(&described);
            let described = batches.into_iter().map(|batch| {
                let schema = noted(batch.schema_ref(), &notes);
                RecordBatch::try_new(schema, batch.columns().to_vec())
            });
            let batches = described.collect::<Result<Vec<_>, _>>();
            let batches = batches.map_err(Fault::from)?;
            let batches = geoparquet(batches, declared.as_ref(), &earth)?;
            rows(Format::Parquet, batches, out).await
        }
    }
}

/// Rows of a layer, with its geometries on earth where anything is known of it.
fn placed(
    batch: &RecordBatch,
    layer: Option<&Layer>,
    earth: &Earth,
    to: Coordinates,
) -> Result<RecordBatch, Fault> {
    match layer.map_or(Some(GEOMETRY), |layer| layer.geometry) {
        Some(geometry) if !earth.is_empty() => on_earth(batch, geometry, earth, to),
        _ => Ok(batch.clone()),
    }
}

/// The rows of a layer with geometries on earth, and in which system. A file has one, and each site its own: rows of
/// several sites stay in their metres.
fn geoparquet(
    batches: Vec<RecordBatch>,
    layer: Option<&Layer>,
    earth: &Earth,
) -> Result<Vec<RecordBatch>, Fault> {
    let sites = batches.iter().filter_map(|batch| texts(batch, "site"));
    let sites: BTreeSet<String> = sites.flatten().flatten().map(str::to_owned).collect();
    let site = sites.first().filter(|_| sites.len() == 1);
    let Some(place) = site.and_then(|site| earth.place(site)) else {
        return Ok(batches);
    };
    let metadata = HashMap::from([(CRS.to_owned(), place.projjson().to_string())]);
    let said = batches.iter().map(|batch| {
        let batch = placed(batch, layer, earth, Coordinates::Metres)?;
        let schema = batch.schema().as_ref().clone();
        Ok(batch.with_schema(Arc::new(schema.with_metadata(metadata.clone())))?)
    });
    said.collect()
}

/// Writes rows with a geometry as GeoJSON: in longitude and latitude where `earth` knows their site, else in the map's
/// metres.
///
/// # Errors
/// A user fault for rows without a geometry, or of a site that lies nowhere, and where the term of the task is over.
pub fn geojson(
    batches: Vec<RecordBatch>,
    layer: Option<&Layer>,
    title: &str,
    earth: &Earth,
    out: &mut (impl Write + Send),
) -> Result<(), Failure> {
    let head = Head {
        title,
        on_earth: earth.moves(&batches),
    };
    let mut features = Box::new(GeoJson::begin(head, layer, earth, out)?);
    let term = Term::of_task();
    for piece in batches.into_iter().flat_map(pieces) {
        if term.is_over() {
            return Err(Fault::user("stopped").into());
        }
        features.write(&piece)?;
    }
    features.finish()
}

async fn rows(format: Format, batches: Vec<RecordBatch>, out: &Path) -> Result<(), Failure> {
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
