//! Masks of images that a plan is given, by camera: those of cameras that no session has.

use std::collections::BTreeSet;

use evermap_catalog::{ALL_CAMERAS, MASK};
use evermap_datasets::Dataset;
use evermap_engine::program::Program;
use evermap_engine::sql::{Limits, context};
use evermap_language::listed;
use evermap_schemas::Fault;
use evermap_schemas::roles::frame_names;
use serde_json::Value;

use crate::coordinate_frames::{IMAGES, cameras_of};

/// The cameras that the masks of a program are for, by name.
pub fn masked(program: &Program) -> BTreeSet<&str> {
    let given = program.given(MASK).filter_map(Value::as_object);
    let cameras = given.flat_map(|masks| masks.keys().map(String::as_str));
    cameras.filter(|camera| *camera != ALL_CAMERAS).collect()
}

/// That masks are for cameras that none of the sessions has, and which there are; `None` where all are, or nobody knows
/// the cameras of a session.
///
/// # Errors
/// A fault of ours.
pub async fn warning(masked: &BTreeSet<&str>, dataset: &Dataset) -> Result<Option<String>, Fault> {
    if masked.is_empty() || dataset.sessions.is_empty() {
        return Ok(None);
    }
    let context = context(Limits::one_partition())?;
    dataset.register(&context)?;
    let mut cameras = BTreeSet::new();
    for session in &dataset.sessions {
        match cameras_of(&context, &session.name, IMAGES).await {
            Ok(found) => cameras.extend(found),
            Err(_) => return Ok(None),
        }
    }
    Ok(idle(masked, &cameras))
}

fn idle(masked: &BTreeSet<&str>, cameras: &BTreeSet<String>) -> Option<String> {
    let known: BTreeSet<&str> = cameras
        .iter()
        .map(|name| frame_names::plain(name))
        .collect();
    let idle = masked
        .iter()
        .filter(|name| !known.contains(frame_names::plain(name)));
    let idle: Vec<&str> = idle.copied().collect();
    if idle.is_empty() {
        return None;
    }
    Some(format!(
        "`{MASK}` names {}, which no session given has: their cameras are {}",
        listed(idle),
        listed(known)
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mask_of_a_camera_that_there_is_not_is_told_with_those_that_there_are() {
        let cameras = ["/front", "rear"].map(str::to_owned);
        let cameras = BTreeSet::from(cameras);
        assert_eq!(idle(&BTreeSet::from(["front", "/rear"]), &cameras), None);
        let said = idle(&BTreeSet::from(["left", "rear"]), &cameras);
        let expected =
            "`mask` names `left`, which no session given has: their cameras are `front`, `rear`";
        assert_eq!(said.as_deref(), Some(expected));
    }
}
