//! `evermap render`.

use crate::arguments::RenderArgs;
use crate::commands::layers::open;
use crate::draw::{Look, draw, png};
use crate::ending::{DONE, Ending};
use crate::output::write_file;
use crate::progress::line;
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
