//! `evermap render`.

use clap::ValueEnum;
use evermap_engine::map::version::Version;
use evermap_schemas::layers::WarpedLabels;
use evermap_schemas::{Fault, LayerRow};

use crate::arguments::{RenderArgs, Shown};
use crate::draw::{Canvas, Picture, matrix, png, stable, views};
use crate::ending::{DONE, Ending};
use crate::metric::metric_map;
use crate::moved::{changes, placings};
use crate::output::write_file;
use crate::progress::line;
use crate::reader::MapReader;
use crate::scene::{drawn, scene};
use crate::semantic::{semantic_map, similarities};
use crate::stable::{lacking, stable_map};

/// Draws a map.
///
/// # Errors
/// A user fault where there is nothing to draw, a data fault for a damaged tile.
pub async fn render(args: &RenderArgs) -> Ending {
    fits(args)?;
    let reader = MapReader::open(&args.map.map, args.map.version).await?;
    let picture = picture(args, &reader).await?;
    let extension = args.out.extension().unwrap_or_default();
    if extension.eq_ignore_ascii_case("svg") {
        write_file(&args.out, picture.svg.as_bytes())?;
    } else {
        write_file(&args.out, &png(&picture)?)?;
    }
    DONE
}

/// That nothing is asked for which the view does not show.
fn fits(args: &RenderArgs) -> Result<(), Fault> {
    let has_before = matches!(args.view, Shown::Changes | Shown::Labels);
    match args.since {
        Some(_) if !has_before => {
            let view = args.view.to_possible_value();
            let view = view.map_or_else(String::new, |view| view.get_name().to_owned());
            let fault = format!("--since is for the views changes and labels, found {view}");
            Err(Fault::user(fault).next("leave it out, or choose one of them with --view"))
        }
        _ => Ok(()),
    }
}

async fn picture(args: &RenderArgs, reader: &MapReader) -> Result<Picture, Fault> {
    let (scene, sites) = scene(reader, args.site.as_deref()).await?;
    if let (None, [first, _, ..]) = (&args.site, sites.as_slice()) {
        line(&format!(
            "drawing site {first} of {}; choose another with --site",
            sites.join(", ")
        ));
    }
    let site = args.site.as_ref().or(sites.first());
    let site = site.map(String::as_str).unwrap_or_default();
    let canvas = Canvas {
        width_px: args.width_px,
        zoom: args.zoom,
    };
    let nothing = |what: &str, plans: &str| {
        Fault::user(format!("the map has no {what} of {site}"))
            .next(format!("map it with the plan {plans}"))
    };
    match args.view {
        Shown::Map => drawn(reader, &scene, canvas),
        Shown::Changes => {
            let since = earlier(reader, args.since).await?;
            let changes = changes(reader, site, since).await?;
            if changes.is_empty() {
                line(&format!("nothing of {site} changed since version {since}"));
            }
            drawn(reader, &scene.with_changes(changes), canvas)
        }
        Shown::Labels => {
            let placed = placings(reader, &args.map.map, site, args.since).await?;
            if placed.values().all(Vec::is_empty) {
                return Err(nothing("labels", "labels, parking or car_park"));
            }
            drawn(reader, &scene.with_placings(&placed), canvas)
        }
        Shown::Metric => {
            let found = metric_map(reader, site).await?;
            let found = found
                .ok_or_else(|| nothing("adjusted poses", "lifelong, metric_map or car_park"))?;
            drawn(reader, &found.scene, canvas)
        }
        Shown::Views => {
            let found = semantic_map(reader, site).await?;
            views(&found.ok_or_else(|| nothing("views", "semantic_map"))?)
        }
        Shown::Similarities => {
            let found = similarities(reader, site).await?;
            let found = found.ok_or_else(|| nothing("relocations", "relocate"))?;
            matrix(&found, args.width_px)
        }
        Shown::Stable => {
            let found = stable_map(reader, site).await?;
            let lacking = lacking(reader).unwrap_or(WarpedLabels::NAME);
            stable(
                &found.ok_or_else(|| nothing(lacking, "stable_map"))?,
                args.width_px,
            )
        }
    }
}

/// The version that changes are since: the one asked for, or the newest before the one that is drawn.
async fn earlier(reader: &MapReader, asked: Option<u64>) -> Result<u64, Fault> {
    if let Some(asked) = asked {
        return Ok(asked);
    }
    let drawn = reader.map.version.version;
    let numbers = Version::numbers(&reader.map.store).await?;
    let before = numbers.into_iter().rev().find(|number| *number < drawn);
    before.ok_or_else(|| {
        Fault::user(format!("version {drawn} is the oldest of the map"))
            .next("choose two versions: --since N --version M; `evermap versions` lists them")
    })
}
