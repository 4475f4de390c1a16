//! `evermap import`.

use std::path::Path;

use evermap_datasets::import::{ImageImport, Imported, Kitti};
use evermap_engine::sql::Term;
use evermap_schemas::Fault;

use crate::arguments::ImportArgs;
use crate::ending::{Ending, Lost};
use crate::output::outside_of_maps;
use crate::progress::line;
use crate::quantity::of;

/// Turns other recordings into MCAP.
///
/// # Errors
/// A user fault that says what to do instead, where another program converts better.
pub async fn import(args: &ImportArgs) -> Ending {
    let term = Term::of_task();
    let is_stopped = || term.is_over();
    match args {
        ImportArgs::Images {
            description,
            folder,
            out,
        } => {
            outside_of_maps(out)?;
            let import = ImageImport::load(description)?;
            let import = match folder {
                Some(folder) => import.within(folder),
                None => import,
            };
            tell(out, &import.write(out, &is_stopped)?)
        }
        ImportArgs::Kitti {
            poses,
            times,
            images,
            calibration,
            out,
        } => {
            outside_of_maps(out)?;
            let (poses, times) = (poses.clone(), times.clone());
            let (images, calibration) = (images.clone(), calibration.clone());
            let kitti = Kitti {
                poses,
                times,
                images,
                calibration,
            };
            tell(out, &kitti.write(out, &is_stopped)?)
        }
        ImportArgs::Rosbag { files } => {
            let what = files.first().map_or("the bag", String::as_str);
            Err(Fault::user(format!("{what}: bags are converted by their own tools"))
                .next(
                    "ROS 1 (.bag): `mcap convert in.bag out.mcap` (https://mcap.dev/guides/cli); ROS 2 (.db3): \
                     `ros2 bag convert -i in -o out.yaml` with `storage_id: mcap`; then use the MCAP file as it is",
                )
                .into())
        }
    }
}

fn tell(out: &Path, imported: &Imported) -> Ending {
    let (images, poses) = (
        of(imported.images as u64, "image"),
        of(imported.poses as u64, "pose"),
    );
    line(&format!("{}: {images}, {poses}", out.display()));
    Ok(Lost::default())
}
