//! Plans by path, or by name where they ship with the program, and the manifests that go with them.

use std::io::ErrorKind;
use std::path::Path;

use evermap_datasets::{Manifest, without_mark};
use evermap_engine::prepare::PlanText;
use evermap_language::{PlanFaults, Source, nearest, utf8};
use evermap_schemas::Fault;

use crate::arguments::{PlanArgs, SessionArgs};
use crate::ending::Failure;
use crate::standard_input::standard_input;

/// The plans that ship: name and text, sorted by name.
pub const PLANS: &[(&str, &str)] = include!(concat!(env!("OUT_DIR"), "/plans.rs"));

/// Reads the plan that the command line names.
///
/// # Errors
/// A user fault that names the plans that ship, or the file's first byte that is no text.
pub fn of(args: &PlanArgs) -> Result<PlanText, Failure> {
    Ok(PlanText {
        manifest: manifest(&args.sessions)?,
        ..read(&args.plan, args.set.clone())?
    })
}

/// The text of the manifest that the command line names.
///
/// # Errors
/// A user fault when it cannot be read.
pub fn manifest(args: &SessionArgs) -> Result<Option<Source>, Fault> {
    let source = args.manifest.as_ref().map(|origin| {
        let text = Manifest::text(Path::new(origin))?;
        let origin = origin.clone();
        Ok(Source { origin, text })
    });
    source.transpose()
}

/// A plan that ships, as it is.
pub fn plain((name, text): &(&str, &str)) -> PlanText {
    PlanText {
        source: Source {
            origin: origin(name),
            text: (*text).to_owned(),
        },
        find,
        settings: Vec::new(),
        manifest: None,
    }
}

fn origin(shipped: &str) -> String {
    format!("plans/library/{shipped}.yaml")
}

/// Reads a plan: a file, `-` for standard input, or the name of a plan that ships.
fn read(plan: &str, settings: Vec<String>) -> Result<PlanText, Failure> {
    let (origin, bytes) = match plan {
        "-" => (plan.to_owned(), standard_input("a plan")?),
        _ => file_or_shipped(Path::new(plan), plan)?,
    };
    let source = source(origin, &bytes).map_err(|faults| Failure::Plan(faults.pretty()))?;
    Ok(PlanText {
        source,
        find,
        settings,
        manifest: None,
    })
}

/// The plan that another extends: a path relative to it, or the name of a plan that ships.
fn find(name: &str, extended_by: &str) -> Result<Source, String> {
    let folder = Path::new(extended_by).parent().unwrap_or(Path::new(""));
    let found = file_or_shipped(&folder.join(name), name);
    let (origin, bytes) = found.map_err(|fault| fault.to_string())?;
    source(origin, &bytes).map_err(|faults| faults.to_string())
}

fn source(origin: String, bytes: &[u8]) -> Result<Source, PlanFaults> {
    let text = without_mark(utf8(bytes, &origin)?).to_owned();
    Ok(Source { origin, text })
}

/// Where a plan is from, and its bytes.
fn file_or_shipped(file: &Path, name: &str) -> Result<(String, Vec<u8>), Fault> {
    let shipped = PLANS.iter().find(|(shipped, _)| *shipped == name);
    if let (Some((name, text)), false) = (shipped, file.is_file()) {
        return Ok((origin(name), text.as_bytes().to_vec()));
    }
    let bytes = evermap_datasets::read_bytes(file).map_err(|error| {
        let names = || PLANS.iter().map(|(name, _)| *name);
        let fault = match error.kind() {
            ErrorKind::NotFound => Fault::user(format!("there is no plan {}", file.display())),
            _ => Fault::user(format!("cannot read the plan {}: {error}", file.display())),
        };
        match nearest(name, names()) {
            Some(near) => fault.next(format!("did you mean {near}?")),
            None => fault.next(format!(
                "give a YAML file, or one of the plans that ship: {}",
                names().collect::<Vec<_>>().join(", ")
            )),
        }
    })?;
    Ok((file.display().to_string(), bytes))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use evermap_engine::prepare;

    use super::*;

    #[test]
    fn a_plan_is_a_file_that_ends() {
        let fault = file_or_shipped(Path::new("/dev/zero"), "zero").unwrap_err();
        assert!(
            fault.to_string().contains("a device, and no file"),
            "{fault}"
        );
    }

    #[test]
    fn a_plan_that_is_nowhere_names_those_that_ship() {
        let Err(Failure::Fault(fault)) = read("no_such_plan", vec![]) else {
            unreachable!("there is none")
        };
        assert!(fault.to_string().contains("no_such_plan"), "{fault}");
        assert!(
            PLANS
                .iter()
                .all(|(name, _)| fault.to_string().contains(name)),
            "{fault}"
        );
    }

    #[test]
    fn a_file_goes_before_a_name_and_must_be_text() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.yaml");
        std::fs::write(&path, b"plan: a\n\xff").unwrap();
        let refused = read(path.to_str().unwrap(), vec![]);
        assert!(matches!(refused, Err(Failure::Plan(text)) if text.contains("UTF-8")));
        std::fs::write(&path, "plan: a").unwrap();
        assert_eq!(
            read(path.to_str().unwrap(), vec![]).unwrap().source.text,
            "plan: a"
        );
        std::fs::write(&path, "\u{feff}plan: a").unwrap();
        let marked = read(path.to_str().unwrap(), vec![]).unwrap();
        assert_eq!(marked.source.text, "plan: a");
    }

    #[test]
    fn a_shipped_plan_as_printed_is_the_same_plan() {
        let registry = crate::operators::registry();
        for shipped in PLANS {
            let mut text = plain(shipped);
            let plan = prepare::parse(&text, &registry).unwrap();
            text.source.text = plan.to_string();
            let mut again = prepare::parse(&text, &registry).unwrap();
            // Tests are not printed, and what is said of places is said of other ones.
            again.tests = plan.tests.clone();
            again.warnings = plan.warnings.clone();
            for (again, step) in again.steps.iter_mut().zip(&plan.steps) {
                (again.position, again.body_location) = (step.position, step.body_location);
            }
            assert_eq!(again, plan);
        }
    }

    #[test]
    fn what_a_plan_extends_is_beside_it_or_ships() {
        let folder = tempfile::tempdir().unwrap();
        let (plan, base) = (
            folder.path().join("a.yaml"),
            folder.path().join("base.yaml"),
        );
        std::fs::write(&base, "plan: base").unwrap();
        let found = |name: &str| find(name, plan.to_str().unwrap());
        assert_eq!(found("base.yaml").unwrap().text, "plan: base");
        let shipped = found("lifelong").unwrap();
        assert_eq!(shipped.origin, "plans/library/lifelong.yaml");
        assert!(found("no_such_plan").unwrap_err().contains("car_park"));
        std::fs::write(&base, b"\xff").unwrap();
        assert!(found("base.yaml").unwrap_err().contains("UTF-8"));
    }
}
