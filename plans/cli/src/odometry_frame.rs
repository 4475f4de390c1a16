//! Odometry of another frame than the vehicle's: a message names the frame whose pose it has, and poses are read as the
//! vehicle's.

use std::collections::BTreeSet;

use datafusion::prelude::SessionContext;
use evermap_algorithms::geometry::pose::Pose;
use evermap_catalog::{USUAL_VEHICLE, VehicleFrame, footing};
use evermap_datasets::manifest::Vehicle;
use evermap_datasets::{Dataset, Session};
use evermap_engine::program::Program;
use evermap_engine::quoted;
use evermap_engine::sql::{Limits, context};
use evermap_schemas::roles::{Transform, frame_names};
use evermap_schemas::{Fault, rows};
use serde_json::Value;

use crate::coordinate_frames::{TRANSFORMS, texts_of};
use crate::reader::answered;

/// What is the same but for how it was computed: metres, and radians.
const SAME: f64 = 1e-6;

/// Sessions that are looked at, at most: logs of a fleet are alike, and each costs some milliseconds.
pub(crate) const LOOKED_AT: usize = 16;

/// The frame that the steps of a program take for the vehicle's.
pub fn vehicle(program: &Program) -> &str {
    let mut given = program.given(Vehicle::PARAMETER);
    given.find_map(Value::as_str).unwrap_or(USUAL_VEHICLE)
}

/// What a person is told of the first [`LOOKED_AT`] sessions whose odometry is of a frame that fixed transforms tie to the vehicle's elsewhere
/// than at it. Nothing of a session whose messages name no frame, or one that no transforms tie to it.
///
/// # Errors
/// A fault of ours.
pub async fn notes(dataset: &Dataset, vehicle: &str) -> Result<Vec<String>, Fault> {
    let mut notes = Vec::new();
    for session in dataset.sessions.iter().take(LOOKED_AT) {
        // A table of all sessions looks at the files of all.
        let context = context(Limits::one_partition())?;
        dataset.of_session(session).register(&context)?;
        // What cannot be read of a log is told where its rows are read.
        let Some(frame) = child_of(&context, session).await else {
            continue;
        };
        if frame == frame_names::plain(vehicle) {
            continue;
        }
        let transforms = fixed_transforms(&context, &session.name).await;
        let note = apart(&transforms.unwrap_or_default(), &frame, vehicle);
        notes.extend(note.map(|note| format!("session {}: {note}", session.name)));
    }
    Ok(notes)
}

/// What the first [`LOOKED_AT`] sessions play with transforms that move no vehicle: the roles, and what a person is told of
/// them.
pub async fn unmoved(dataset: &Dataset) -> (BTreeSet<&'static str>, Vec<String>) {
    let (mut roles, mut notes) = (BTreeSet::new(), Vec::new());
    for session in dataset.sessions.iter().take(LOOKED_AT) {
        for (role, why) in dataset.unmoved(session).await {
            let topics = session.roles.topics(role).join(", ");
            notes.push(format!(
                "session {}: nothing comes of {role}, as {topics} moves no vehicle: {why}",
                session.name
            ));
            roles.insert(role);
        }
    }
    (roles, notes)
}

/// The frame whose pose the first message of a session's odometry has; `None` where it names none. Transforms are chosen
/// by it.
async fn child_of(context: &SessionContext, session: &Session) -> Option<String> {
    let topic = session.roles.topics("odometry").first()?;
    if session.roles.topics("transforms").contains(topic) {
        return None;
    }
    let (topic, name) = (quoted::name(topic), quoted::text(&session.name));
    let first = format!("SELECT child_frame_id FROM {topic} WHERE session = {name} LIMIT 1");
    // Messages of other types have no such member.
    let found = texts_of::<1>(context, &first).await.ok()?;
    let [frame] = found.into_iter().next()?;
    let frame = frame_names::plain(&frame);
    (!frame.is_empty()).then(|| frame.to_owned())
}

/// The fixed transforms of a session, of its first [`TRANSFORMS`].
///
/// # Errors
/// A resource fault when a log cannot be read.
pub(crate) async fn fixed_transforms(
    context: &SessionContext,
    session: &str,
) -> Result<Vec<Transform>, Fault> {
    let session = quoted::text(session);
    let fixed = format!(
        "SELECT * FROM (SELECT * FROM transforms WHERE session = {session} LIMIT {TRANSFORMS}) WHERE fixed"
    );
    let mut found = Vec::new();
    for batch in answered(context, &fixed).await? {
        found.extend(rows::<Transform>(&batch)?);
    }
    Ok(found)
}

/// The vehicle in a frame (`frame_from_vehicle`), and what the vehicle is called; `None` where no fixed transforms tie
/// the two.
pub(crate) fn tied(transforms: &[Transform], frame: &str, vehicle: &str) -> Option<(Pose, String)> {
    let of = |name: &str| {
        let vehicle_frame = name.to_owned();
        footing(transforms.to_vec(), &VehicleFrame { vehicle_frame })
    };
    let (of_frame, of_vehicle) = (of(frame), of(vehicle));
    if of_frame.root != of_vehicle.root {
        return None;
    }
    let from_root = |found: Option<Pose>| found.unwrap_or_else(Pose::identity);
    let frame_from_root = from_root(of_frame.vehicle_from_root);
    let vehicle_from_root = from_root(of_vehicle.vehicle_from_root);
    let frame_from_vehicle = frame_from_root.compose(&vehicle_from_root.inverse());
    Some((frame_from_vehicle, of_vehicle.vehicle))
}

/// That odometry is of a frame which these fixed transforms tie to the vehicle's, elsewhere than at it.
fn apart(transforms: &[Transform], frame: &str, vehicle: &str) -> Option<String> {
    let (apart, vehicle) = tied(transforms, frame, vehicle)?;
    let [x, y, z, _, _, _, qw] = apart.to_array();
    let (metres, turned) = (x.hypot(y).hypot(z), 2.0 * qw.abs().min(1.0).acos());
    (metres > SAME || turned > SAME.sqrt()).then(|| {
        format!(
            "odometry is of {frame}, {metres:.2} m and {:.1}° from {vehicle}, and read as if it were of {vehicle}; say \
             `defaults: {{ vehicle_frame: {frame} }}` in a session manifest",
            turned.to_degrees()
        )
    })
}

#[cfg(test)]
mod tests {
    use evermap_schemas::{Pose, Stamp};

    use super::*;

    fn fixed(parent: &str, child: &str, x: f64) -> Transform {
        Transform {
            site: String::new(),
            session: String::new(),
            stamp: Stamp(0),
            parent: parent.to_owned(),
            child: child.to_owned(),
            parent_from_child: Pose {
                x,
                ..Pose::IDENTITY
            },
            fixed: true,
        }
    }

    #[test]
    fn odometry_of_a_frame_elsewhere_on_the_vehicle_is_told_and_of_one_at_it_is_not() {
        let told = |transforms: &[Transform], frame| apart(transforms, frame, "base_link");
        let mast = [
            fixed("base_link", "mast", 0.5),
            fixed("mast", "imu_link", 1.5),
        ];
        let said = "odometry is of imu_link, 2.00 m and 0.0° from base_link, and read as if it were of base_link; say \
                    `defaults: { vehicle_frame: imu_link }` in a session manifest";
        assert_eq!(told(&mast, "imu_link").as_deref(), Some(said));
        assert_eq!(told(&mast, "base_link"), None);
        assert_eq!(told(&mast, "nowhere"), None);
        assert_eq!(told(&[], "base_footprint"), None);
        assert_eq!(
            told(
                &[fixed("base_footprint", "base_link", 0.0)],
                "base_footprint"
            ),
            None
        );
        assert!(
            told(
                &[fixed("base_footprint", "base_link", 0.1)],
                "base_footprint"
            )
            .is_some()
        );
        let apart = [
            fixed("base_link", "mast", 0.5),
            fixed("body", "imu_link", 1.5),
        ];
        assert_eq!(told(&apart, "imu_link"), None);
    }
}
