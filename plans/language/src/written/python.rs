//! A step that is a function in Python.

use std::collections::BTreeMap;

use super::step::{ports, sound_values};
use super::{WrittenStep, from_plan, is_null};
use crate::fault::PlanFaults;
use crate::plan::{Body, Grain, PythonStep};
use crate::suggest::{listed, one_line, quoted};
use crate::vocabulary::Host;
use crate::yaml::{Entry, Fields};

pub(super) fn step(
    step: &mut WrittenStep,
    python: &Entry,
    fields: &Fields<'_>,
    host: &dyn Host,
    faults: &mut PlanFaults,
) {
    let before = faults.error_count();
    ports(step, None, fields.get("in"), faults);
    if step.inputs.is_empty() {
        faults.error(
            python.location,
            "`python` needs `in`: the tables that it takes, by argument",
        );
    }
    let file = file(python, host, faults);
    let params = mapping(fields, "with", faults);
    let params = sound_values(params, faults);
    let grain = grain(fields, faults);
    let pixels = pixels(step, fields, faults);
    let output = fields.require("output", "a step with `python`", faults);
    let output = output.map(|entry| entry.value.json(faults));
    let clash = params
        .keys()
        .find(|name| port_names(step).any(|port| port == *name));
    if let Some(name) = clash {
        let message = format!(
            "{} is both a table of `in` and a parameter of `with`",
            quoted(name)
        );
        faults.error(python.location, message);
    }
    if grain == Some(Grain::Rows) && step.inputs.len() > 1 {
        let message =
            "`grain: rows` is for functions of one table; of several it is session, site or map";
        faults.error(python.location, message);
    }
    let (Some((file, function, code)), Some(grain), Some(output)) = (file, grain, output) else {
        return;
    };
    if faults.error_count() == before {
        step.body = Some(Body::Python(Box::new(PythonStep {
            file,
            function,
            code,
            params,
            grain,
            output,
            pixels,
        })));
    }
}

fn port_names(step: &WrittenStep) -> impl Iterator<Item = &str> {
    step.inputs.iter().filter_map(|input| input.port.as_deref())
}

/// The file, relative to the plan itself, the function, and the text of the file.
fn file(
    python: &Entry,
    host: &dyn Host,
    faults: &mut PlanFaults,
) -> Option<(String, String, String)> {
    let text = python.value.text("`python`", faults)?;
    let location = python.value.location;
    let Some((file, function)) = text
        .rsplit_once(':')
        .filter(|(file, name)| !file.is_empty() && !name.is_empty())
    else {
        let message = format!(
            "expected a file and a function, such as `steps.py:speeds`, found {}",
            quoted(text)
        );
        faults.error(location, message);
        return None;
    };
    match host.code(file, faults.origin(location)) {
        Ok(code) => Some((from_plan(file, location, faults), function.to_owned(), code)),
        Err(error) => {
            faults.error(location, one_line(&error));
            None
        }
    }
}

fn mapping<'n>(fields: &Fields<'n>, key: &str, faults: &mut PlanFaults) -> &'n [Entry] {
    let entry = fields.get(key).filter(|entry| !is_null(&entry.value));
    let entries = entry.and_then(|entry| entry.value.mapping(&format!("`{key}`"), faults));
    entries.unwrap_or_default()
}

fn grain(fields: &Fields<'_>, faults: &mut PlanFaults) -> Option<Grain> {
    let entry = fields.require("grain", "a step with `python`", faults)?;
    let name = entry.value.text("`grain`", faults)?;
    let known = Grain::NAMED.iter().find(|(known, _)| *known == name);
    if known.is_none() {
        let names = Grain::NAMED.map(|(name, _)| name);
        let message = format!(
            "expected `grain` to be one of {}, found {}",
            listed(names),
            quoted(name)
        );
        faults.unknown(entry.value.location, message, name, names);
    }
    known.map(|(_, grain)| *grain)
}

fn pixels(
    step: &WrittenStep,
    fields: &Fields<'_>,
    faults: &mut PlanFaults,
) -> BTreeMap<String, String> {
    let mut pixels = BTreeMap::new();
    for entry in mapping(fields, "pixels", faults) {
        let Some(column) = entry.value.text("a column of images", faults) else {
            continue;
        };
        if !port_names(step).any(|port| port == entry.key) {
            let message = format!("`pixels` names {}, no table of `in`", quoted(&entry.key));
            faults.unknown(entry.location, message, &entry.key, port_names(step));
        }
        pixels.insert(entry.key.clone(), column.to_owned());
    }
    pixels
}
