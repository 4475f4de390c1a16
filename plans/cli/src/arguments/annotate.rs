//! The command line of `annotate`.

use std::path::PathBuf;

use clap::Args;
use evermap_schemas::roles::annotations::is_word;

use crate::annotate::is_blank;
use crate::annotate::pixels::Program;
use crate::arguments::MapArgs;

/// Arguments of `annotate`.
#[derive(Debug, Args)]
#[command(group = clap::ArgGroup::new("what").args(["import", "export"]).required(true))]
pub struct AnnotateArgs {
    /// The map that is looked at.
    #[command(flatten)]
    pub map: MapArgs,
    /// Site of the labels [default: the only one].
    #[arg(long, value_name = "NAME")]
    pub site: Option<String>,
    /// What the labels mark: any word, as `parking_space` [default: what each says itself]. Features that say another kind
    /// are left out. With --export, only these.
    #[arg(long, value_name = "WORD", value_parser = said)]
    pub kind: Option<String>,
    /// Labels to say: GeoJSON in the map's metres; annotations of a mosaic by COCO, CVAT, Label Studio or YOLO; or boxes around
    /// people in camera images by COCO, CVAT or Label Studio.
    #[arg(long, value_name = "FILE", requires = "out")]
    pub import: Option<PathBuf>,
    /// The mosaic that annotations in pixels are of, as `evermap export --format png` wrote it with its world file beside it.
    #[arg(long, value_name = "PNG")]
    pub mosaic: Option<PathBuf>,
    /// The folder of camera images that boxes are drawn on, as `evermap export person_questions --format coco` wrote it. A box
    /// that is left says that it is a person, one that is gone that it is none, a new one that somebody was missed.
    #[arg(
        long,
        value_name = "DIR",
        requires = "import",
        conflicts_with = "mosaic"
    )]
    pub images: Option<PathBuf>,
    /// Who says so [default: the user's name].
    #[arg(long, value_name = "NAME", value_parser = said)]
    pub author: Option<String>,
    /// Log of annotations. What it says already counts; what is new is written to its next part.
    #[arg(long, value_name = "LOG", value_parser = log)]
    pub out: Option<PathBuf>,
    /// File to write: the labels that there are, where they are in this version of the map.
    #[arg(long, value_name = "FILE")]
    pub export: Option<PathBuf>,
    /// In pixels of --mosaic, for another program, without what was rejected [default: GeoJSON in the map's metres].
    #[arg(long, value_name = "PROGRAM", requires_all = ["export", "mosaic"])]
    pub program: Option<Program>,
}

fn said(text: &str) -> Result<String, String> {
    match !is_blank(text) && is_word(text) {
        true => Ok(text.to_owned()),
        false => Err(format!("expected a name or a word, found {text:?}")),
    }
}

fn log(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    match path.extension() {
        Some(extension) if extension == "mcap" => Ok(path),
        _ => Err(format!("expected a file that ends in .mcap, found {text}")),
    }
}
