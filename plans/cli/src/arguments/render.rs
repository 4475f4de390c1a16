//! Arguments of `render` and `report`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use crate::arguments::MapArgs;

/// What a picture shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Shown {
    /// The ground from above, lanes, intersections, trajectories.
    Map,
    /// What is gone, new and moved since an earlier version: poses, lanes, intersections, parking spaces, labels.
    Changes,
    /// Each label as often as there are versions: where each of them places it.
    Labels,
    /// The metric map: trajectories before and after, landmarks, loop closures.
    Metric,
    /// The semantic map: labels over images, and the graphs of views.
    Views,
    /// How much each query of a relocation run looks like each view of the map.
    Similarities,
    /// The stable map: labels before, with what others saw behind what moves, what is inferred, all of it, beside images.
    Stable,
}

/// Arguments of `render`.
#[derive(Debug, Args)]
pub struct RenderArgs {
    /// The map.
    #[command(flatten)]
    pub map: MapArgs,
    /// Picture to write: `.png` or `.svg`.
    #[arg(long, value_name = "FILE", value_parser = picture)]
    pub out: PathBuf,
    /// What is drawn.
    #[arg(long, default_value = "map")]
    pub view: Shown,
    /// Earlier version that changes are since [default: the one before], or that outlines of labels begin with [default: the
    /// oldest].
    #[arg(long, value_name = "N")]
    pub since: Option<u64>,
    /// Site to draw [default: the first by name].
    #[arg(long, value_name = "NAME")]
    pub site: Option<String>,
    /// Zoom level of tiles; 0 is the finest [default: by the picture's size].
    #[arg(long, value_name = "Z")]
    pub zoom: Option<u32>,
    /// Width of the picture, pixels.
    #[arg(long, value_name = "N", default_value_t = 1600, value_parser = clap::value_parser!(u32).range(200..=16_384))]
    pub width_px: u32,
}

/// Arguments of `report`.
#[derive(Debug, Args)]
pub struct ReportArgs {
    /// The map.
    #[command(flatten)]
    pub map: MapArgs,
    /// Page to write.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Site to draw [default: the first by name].
    #[arg(long, value_name = "NAME")]
    pub site: Option<String>,
}

fn picture(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    let extension = path
        .extension()
        .unwrap_or_default()
        .to_string_lossy()
        .to_lowercase();
    if ["png", "svg"].contains(&extension.as_str()) {
        Ok(path)
    } else {
        Err(format!(
            "expected a file that ends in .png or .svg, found {text}"
        ))
    }
}
