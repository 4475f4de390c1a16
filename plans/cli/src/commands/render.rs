//! `evermap render`.

use evermap_engine::map::Map;
use evermap_schemas::Fault;

use crate::arguments::{RenderArgs, Shown};
use crate::commands::layers::open;
use crate::draw::{Look, Picture, Scene, draw, matrix, png, views};
use crate::ending::{DONE, Ending};
use crate::metric::metric;
use crate::output::write_file;
use crate::progress::line;
use crate::report;
use crate::scene::scene;
use crate::semantic::{semantic, similarities};

/// Views that a picture shows.
const VIEWS: usize = 3;

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
    let site = args.site.as_ref().or(sites.first());
    let site = site.map(String::as_str).unwrap_or_default();
    let picture = picture(args, &map, scene, site).await?;
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

async fn picture(args: &RenderArgs, map: &Map, scene: Scene, site: &str) -> Result<Picture, Fault> {
    let registry = evermap_catalog::registry();
    let look = Look {
        width_px: args.width_px,
        zoom: args.zoom,
    };
    let nothing = |what: &str, plans: &str| {
        Fault::user(format!("the map has no {what} of {site}"))
            .next(format!("map it with the plan {plans}"))
    };
    match args.view {
        Shown::Map => draw(&scene, look),
        Shown::Metric => {
            let found = metric(map, &registry, site).await?;
            let found = found
                .ok_or_else(|| nothing("adjusted poses", "lifelong, metric_map or car_park"))?;
            draw(&report::metric::scene(found), look)
        }
        Shown::Views => {
            let found = semantic(map, &registry, site, VIEWS).await?;
            views(&found.ok_or_else(|| nothing("views", "semantic_map"))?)
        }
        Shown::Similarities => {
            let found = similarities(map, &registry, site).await?;
            let found = found.ok_or_else(|| nothing("relocations", "relocate"))?;
            matrix(&found, args.width_px)
        }
    }
}
