//! `evermap import`.

use evermap_schemas::Fault;

use crate::arguments::ImportArgs;
use crate::ending::Ending;

/// Turns other recordings into MCAP.
///
/// # Errors
/// A user fault that says what to do instead, where another program converts better.
pub async fn import(args: &ImportArgs) -> Ending {
    match args {
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
