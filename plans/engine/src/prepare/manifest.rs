//! The session manifest of a plan, and what is wrong with one, with line and column.

use std::path::{Path, PathBuf};

use evermap_datasets::manifest::{BITS, faulty_role, faulty_session};
use evermap_language::{ManifestPath, Position, Source, entry_position, role_positions};
use evermap_schemas::{Fault, roles};

/// A path as a plan writes it: relative to the working folder, or, where there is no such file, to the plan.
pub fn beside(origin: &str, path: &str) -> PathBuf {
    let here = PathBuf::from(path);
    let there = Path::new(origin).parent().map(|folder| folder.join(path));
    match there {
        Some(there) if !here.exists() && there.exists() => there,
        _ => here,
    }
}

/// A manifest as the plan of this origin names it itself: where it is found beside the plan that says so, from there.
pub fn seen_from_plan(named: ManifestPath, own: &str) -> ManifestPath {
    match beside(&named.origin, &named.path) == Path::new(&named.path) {
        true => named,
        false => ManifestPath {
            path: named.from_plan.clone(),
            origin: own.to_owned(),
            ..named
        },
    }
}

/// A fault of opening logs. Where it is of what their manifest says of a role or a session, it points to that.
pub fn located(fault: Fault, manifest: Option<&Source>) -> Fault {
    let place = manifest.and_then(|manifest| {
        let (Position { line, column, .. }, rest) = place_of_role(&fault, manifest)
            .or_else(|| place_of_session(&fault, manifest))
            .or_else(|| place_of_bits(&fault, manifest))?;
        let place = format!("{}:{line}:{column}", manifest.origin);
        Some(match rest {
            "" => place,
            rest => format!("{place}: {rest}"),
        })
    });
    match place {
        Some(place) => Fault { place, ..fault },
        None => fault,
    }
}

/// Where a manifest says what is wrong of a role; nowhere else is such a fault.
fn place_of_role<'f>(fault: &'f Fault, manifest: &Source) -> Option<(Position, &'f str)> {
    let role = faulty_role(fault)?;
    let [name, topics] = role_positions(manifest, role)?;
    let is_played = |known: &roles::Role| known.name == role && known.messages().is_some();
    match roles::ALL.iter().any(is_played) {
        true => Some((topics, "")),
        false => Some((name, "")),
    }
}

/// Where a manifest says what is wrong of a session, and where else the fault is: at a file.
fn place_of_session<'f>(fault: &'f Fault, manifest: &Source) -> Option<(Position, &'f str)> {
    let (entry, rest) = faulty_session(fault)?;
    Some((entry_position(manifest, entry)?, rest))
}

/// Where a manifest says bits of samples.
fn place_of_bits<'f>(fault: &'f Fault, manifest: &Source) -> Option<(Position, &'f str)> {
    if fault.place != BITS {
        return None;
    }
    Some((entry_position(manifest, BITS)?, ""))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_of_a_role_points_into_the_manifest() {
        let manifest = Source {
            origin: "lot.yaml".to_owned(),
            text: "site: lot\nroles:\n  frames:\n    - /a\n  odometri: /odom\nbits: { /a: 12 }\n"
                .to_owned(),
        };
        let place = |fault: Fault| located(fault, Some(&manifest)).place;
        let fault = |at: &str| Fault::user("expected something else").at(at);
        assert_eq!(place(fault("roles.frames")), "lot.yaml:4:5");
        assert_eq!(place(fault("roles.odometri")), "lot.yaml:5:3");
        assert_eq!(place(fault("roles.imu")), "roles.imu");
        assert_eq!(place(fault("bits")), "lot.yaml:6:7");
        assert_eq!(place(fault("drive.mcap")), "drive.mcap");
        let alone = located(fault("roles.frames"), None);
        assert_eq!(alone.place, "roles.frames");
    }

    #[test]
    fn a_fault_of_a_session_points_into_the_manifest_and_keeps_the_file() {
        let manifest = Source {
            origin: "lot.yaml".to_owned(),
            text: "sessions:\n  - name: a\n    files: [a.mcap, n.mcap]\n  - { name: a, files: [b.mcap] }\n"
                .to_owned(),
        };
        let place = |at: &str| {
            let fault = Fault::user("expected something else").at(at);
            located(fault, Some(&manifest)).place
        };
        let file = place("sessions[0].files[1]: /logs/n.mcap");
        assert_eq!(file, "lot.yaml:3:21: /logs/n.mcap");
        assert_eq!(place("sessions[1].files[0]"), "lot.yaml:4:24");
        assert_eq!(place("sessions[1].name"), "lot.yaml:4:13");
        for nowhere in ["sessions[2].name", "sessions[x].name", "sessions[1].mcap"] {
            assert_eq!(place(nowhere), nowhere);
        }
    }
}
