//! The vehicle's own body in the images of its cameras.

use std::collections::BTreeMap;

use evermap_contract::{Fault, Sides};
use evermap_schemas::layers::BodyMask;
use evermap_vision::{Grey, decode_labels};

use super::rig::frame;

/// Masks by session and camera, from the port `body_masks`: not 0 where a pixel shows the vehicle.
///
/// # Errors
/// A data fault for a mask that does not decode, or as [`Sides::rows`].
pub(crate) fn bodies(sides: &Sides) -> Result<BTreeMap<(String, String), Grey>, Fault> {
    let masks = sides.rows::<BodyMask>("body_masks")?.into_iter();
    let mask = |row: BodyMask| {
        let decoded = decode_labels(&row.png.0).map_err(|error| {
            Fault::data(error.to_string()).at(format!("body mask of {}", row.camera))
        })?;
        Ok(((row.session, frame(&row.camera).to_owned()), decoded))
    };
    masks.map(mask).collect()
}
