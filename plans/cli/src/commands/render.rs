//! `evermap render`.

use evermap_schemas::Fault;

use crate::arguments::{RenderArgs, Shown};
use crate::commands::layers::open;
use crate::draw::{Look, draw, png};
use crate::ending::{DONE, Ending};
use crate::metric::metric;
use crate::output::write_file;
use crate::progress::line;
use crate::report;
use crate::scene::scene;

/// Draws a map.
///
/// # Errors
/// A user fault where there is nothing to draw, a data fault for a damaged tile.
pub async fn render(args: &RenderArgs) -> Ending {
    let map = open(&args.map).await?;
    let (scene, sites) = scene(&map, &evermap_catalog::registry(), args.site.as_deref()).await?;
    if let (None, [first, _, ..]) = (&args.site, sites.as_slice()) {
        line(&format!(
            "drawing site {first} of {}; choose another with --site",
            sites.join(", ")
        ));
    }
    let scene = match args.view {
        Shown::Map => scene,
        Shown::Metric => {
            let site = args.site.as_ref().or(sites.first());
            let site = site.map(String::as_str).unwrap_or_default();
            let found = metric(&map, &evermap_catalog::registry(), site).await?;
            report::metric::scene(found.ok_or_else(|| {
                Fault::user(format!("the map has no adjusted poses of {site}"))
                    .next("map it with the plan lifelong, metric_map or car_park")
            })?)
        }
    };
    let picture = draw(
        &scene,
        Look {
            width_px: args.width_px,
            zoom: args.zoom,
        },
    )?;
    let is_svg = args
        .out
        .extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case("svg"));
    if is_svg {
        write_file(&args.out, picture.svg.as_bytes())?;
    } else {
        write_file(&args.out, &png(&picture)?)?;
    }
    DONE
}
