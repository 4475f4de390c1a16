//! What is wrong with a session manifest, with line and column.

use evermap_datasets::manifest::faulty_role;
use evermap_language::{Position, Source, role_places};
use evermap_schemas::{Fault, roles};

/// A fault of opening logs. Where it is of what their manifest says of a role, it points to that.
pub fn located(fault: Fault, manifest: Option<&Source>) -> Fault {
    let place = manifest.and_then(|manifest| {
        let role = faulty_role(&fault)?;
        let [name, topics] = role_places(manifest, role)?;
        let is_played = |known: &roles::Role| known.name == role && known.messages().is_some();
        let Position { line, column, .. } = match roles::ALL.iter().any(is_played) {
            true => topics,
            false => name,
        };
        Some(format!("{}:{line}:{column}", manifest.origin))
    });
    match place {
        Some(place) => Fault { place, ..fault },
        None => fault,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_of_a_role_points_into_the_manifest() {
        let manifest = Source {
            origin: "lot.yaml".to_owned(),
            text: "site: lot\nroles:\n  frames:\n    - /a\n  odometri: /odom\n".to_owned(),
        };
        let place = |fault: Fault| located(fault, Some(&manifest)).place;
        let fault = |at: &str| Fault::user("expected something else").at(at);
        assert_eq!(place(fault("roles.frames")), "lot.yaml:4:5");
        assert_eq!(place(fault("roles.odometri")), "lot.yaml:5:3");
        assert_eq!(place(fault("roles.imu")), "roles.imu");
        assert_eq!(place(fault("drive.mcap")), "drive.mcap");
        let alone = located(fault("roles.frames"), None);
        assert_eq!(alone.place, "roles.frames");
    }
}
