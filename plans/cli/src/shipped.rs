//! Plans by path, or by name where they ship with the program.

use evermap_engine::prepare::PlanText;
use evermap_language::utf8;
use evermap_schemas::Fault;

use crate::ending::Failure;

/// The plans that ship: name and text, sorted by name.
pub const PLANS: &[(&str, &str)] = include!(concat!(env!("OUT_DIR"), "/plans.rs"));

/// Reads a plan: a file, `-` for standard input, or the name of a plan that ships.
///
/// # Errors
/// A user fault that names the plans that ship, or the file's first byte that is no text.
pub fn read(plan: &str, settings: Vec<String>) -> Result<PlanText, Failure> {
    let shipped = PLANS.iter().find(|(name, _)| *name == plan);
    let file = std::path::Path::new(plan);
    if let (Some((name, text)), false) = (shipped, file.is_file()) {
        return Ok(PlanText {
            text: (*text).to_owned(),
            origin: format!("{name}.yaml"),
            settings,
        });
    }
    let bytes = match plan {
        "-" => std::io::read_to_string(std::io::stdin()).map(String::into_bytes),
        _ => std::fs::read(file),
    };
    let bytes = bytes.map_err(|error| {
        let names: Vec<_> = PLANS.iter().map(|(name, _)| *name).collect();
        Fault::user(format!("cannot read the plan {plan}: {error}")).next(format!(
            "give a YAML file, or one of the plans that ship: {}",
            names.join(", ")
        ))
    })?;
    let text = utf8(&bytes, plan)
        .map_err(|faults| Failure::Plan(faults.pretty()))?
        .to_owned();
    Ok(PlanText {
        text,
        origin: plan.to_owned(),
        settings,
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

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
            read(path.to_str().unwrap(), vec![]).unwrap().text,
            "plan: a"
        );
    }
}
