//! One step: an operator with ports and parameters, a query, or a function in Python.

use std::collections::BTreeSet;

use serde_json::{Map, Value};

use super::{
    BODY_KEYS, LocatedName, STEP_KEYS, StepContext, WrittenInput, WrittenStep, is_null, python,
};
use crate::fault::{Location, PlanFaults};
use crate::inside::QueryPosition;
use crate::plan::Body;
use crate::suggest::{listed, one_line, quoted};
use crate::vocabulary::{Host, OperatorSpec, ParameterFault};
use crate::yaml::{Entry, Fields, Kind};

pub(super) fn step(
    entry: &Entry,
    context: &StepContext<'_>,
    faults: &mut PlanFaults,
) -> WrittenStep {
    let mut step = WrittenStep {
        name: LocatedName {
            name: entry.key.clone(),
            location: entry.location,
        },
        inputs: Vec::new(),
        body: None,
        body_location: entry.location,
        once: false,
        is_sound: true,
    };
    let what = format!("step {}", quoted(&entry.key));
    let Some(fields) = Fields::of(&entry.value, &what, &STEP_KEYS, faults) else {
        return step;
    };
    if let Some(once) = fields.get("once") {
        step.once = once.value.boolean("`once`", faults).unwrap_or_default();
    }
    let bodies: Vec<&Entry> = BODY_KEYS.iter().filter_map(|key| fields.get(key)).collect();
    match bodies.as_slice() {
        [body] => {
            step.body_location = body.value.location;
            refuse_others(&fields, &body.key, faults);
            match body.key.as_str() {
                "op" => operator(&mut step, body, &fields, context, faults),
                "sql" => query(&mut step, body, context, faults),
                _ => python::step(&mut step, body, &fields, context.around.host, faults),
            }
        }
        [] => {
            let message = format!("{what} has none of {}", listed(BODY_KEYS));
            faults.error(entry.location, message);
            ports(&mut step, None, fields.get("in"), faults);
        }
        [first, second, ..] => {
            let (first, second, location) = (&first.key, &second.key, second.location);
            let message = format!("{what} has both `{first}` and `{second}`; it is one of them");
            faults.error(location, message);
            ports(&mut step, None, fields.get("in"), faults);
        }
    }
    step
}

/// Refuses keys that belong to a step of another kind.
fn refuse_others(fields: &Fields<'_>, body: &str, faults: &mut PlanFaults) {
    let (keys, why): (&[&str], _) = match body {
        "sql" => (
            &["in", "with", "grain", "output", "pixels"],
            "a query names its tables and columns itself",
        ),
        "op" => (&["grain", "output", "pixels"], "an operator has its own"),
        _ => return,
    };
    let owner = |key: &str| match key {
        "in" | "with" => "`op` and `python`",
        _ => "`python`",
    };
    for entry in keys.iter().filter_map(|key| fields.get(key)) {
        let (key, owner) = (&entry.key, owner(&entry.key));
        faults.error(entry.location, format!("`{key}` belongs to {owner}; {why}"));
    }
}

impl WrittenStep {
    pub(super) fn reads(&mut self, port: Option<&str>, table: LocatedName, is_implied: bool) {
        self.inputs.push(WrittenInput {
            port: port.map(str::to_owned),
            table,
            is_implied,
        });
    }
}

fn operator(
    step: &mut WrittenStep,
    op: &Entry,
    fields: &Fields<'_>,
    context: &StepContext<'_>,
    faults: &mut PlanFaults,
) {
    let name = op.value.text("`op`", faults);
    let vocabulary = context.around.vocabulary;
    let spec = name.and_then(|name| vocabulary.operator(name));
    if let (Some(name), None) = (name, spec) {
        let message = format!("unknown operator {}", quoted(name));
        let known = vocabulary.operator_names();
        faults.unknown(op.value.location, message, name, known);
    }
    ports(step, spec.map(|spec| (spec, op)), fields.get("in"), faults);
    let Some(spec) = spec else {
        return;
    };
    let params = parameters(spec, op, fields.get("with"), context, faults);
    step.body = params.map(|params| Body::Op {
        op: spec.name.clone(),
        params,
    });
}

/// Reads `in`. Without an operator the ports cannot be checked, but what they name can. A port
/// that is not named, or given nothing, takes the table of its own name, unless it is optional.
pub(super) fn ports(
    step: &mut WrittenStep,
    spec: Option<(&OperatorSpec, &Entry)>,
    inputs: Option<&Entry>,
    faults: &mut PlanFaults,
) {
    let given = inputs.filter(|entry| !is_null(&entry.value));
    let entries = match given {
        Some(entry) => match entry.value.mapping("`in`", faults) {
            Some(entries) => entries,
            None => return,
        },
        None => &[],
    };
    let named = entries.iter().filter(|entry| !is_null(&entry.value));
    for entry in named.clone() {
        let what = format!("port {}", quoted(&entry.key));
        if let Some(name) = entry.value.text(&what, faults) {
            let name = name.to_owned();
            let location = entry.value.location;
            step.reads(Some(&entry.key), LocatedName { name, location }, false);
        }
    }
    let Some((spec, op)) = spec else {
        return;
    };
    for entry in entries.iter().filter(|e| spec.port(&e.key).is_none()) {
        unknown_port(spec, entry, faults);
    }
    for port in spec.ports.iter().filter(|port| !port.optional) {
        if named.clone().all(|entry| entry.key != port.name) {
            let name = port.name.clone();
            let location = given.map_or(op.value.location, |entry| entry.value.location);
            step.reads(Some(&port.name), LocatedName { name, location }, true);
        }
    }
}

fn unknown_port(spec: &OperatorSpec, entry: &Entry, faults: &mut PlanFaults) {
    let known = spec.ports.iter().map(|port| port.name.as_str());
    let (port, operator) = (quoted(&entry.key), quoted(&spec.name));
    let ports = listed(known.clone());
    let message = format!("{operator} has no port {port}; its ports are {ports}");
    faults.unknown(entry.location, message, &entry.key, known);
}

/// The parameters that `with` gives, and those of the plan's defaults that the operator has.
fn parameters(
    spec: &OperatorSpec,
    op: &Entry,
    with: Option<&Entry>,
    context: &StepContext<'_>,
    faults: &mut PlanFaults,
) -> Option<Value> {
    let given = match with.filter(|entry| !is_null(&entry.value)) {
        Some(entry) => entry.value.mapping("`with`", faults)?,
        None => &[],
    };
    let is_given = |name: &str| given.iter().any(|entry| entry.key == name);
    let is_parameter = |name: &str| spec.parameter_names().any(|known| known == name);
    let defaults = context.defaults.iter();
    let entries: Vec<&Entry> = defaults
        .filter(|default| is_parameter(&default.key) && !is_given(&default.key))
        .chain(given)
        .collect();
    let before = faults.error_count();
    let params = values(spec, &entries, context.around.host, faults);
    for fault in context.around.host.parameter_faults(&spec.name, &params) {
        match entries.iter().find(|entry| entry.key == fault.parameter) {
            None => faults.error(with.unwrap_or(op).value.location, fault.message),
            Some(entry) => misfit(spec, entry, fault, faults),
        }
    }
    (faults.error_count() == before).then_some(params)
}

/// Checks parameters without the others of their step: what is wrong with them together does not show.
pub(crate) fn check_alone(
    spec: &OperatorSpec,
    entries: &[&Entry],
    host: &dyn Host,
    faults: &mut PlanFaults,
) {
    let params = values(spec, entries, host, faults);
    for fault in host.parameter_faults(&spec.name, &params) {
        if let Some(entry) = entries.iter().find(|entry| entry.key == fault.parameter) {
            misfit(spec, entry, fault, faults);
        }
    }
}

/// The values of parameters, with files in the place of their paths.
fn values(
    spec: &OperatorSpec,
    entries: &[&Entry],
    host: &dyn Host,
    faults: &mut PlanFaults,
) -> Value {
    let mut values = sound_values(entries.iter().copied(), faults);
    for entry in entries.iter().filter(|entry| spec.takes_files(&entry.key)) {
        if let (Kind::Mapping(named), Some(Value::Object(files))) =
            (&entry.value.kind, values.get_mut(&entry.key))
        {
            named
                .iter()
                .for_each(|named| read(named, files, host, faults));
        }
    }
    Value::Object(values)
}

/// Puts a file in the place of its path; nothing, where it cannot be read.
fn read(named: &Entry, files: &mut Map<String, Value>, host: &dyn Host, faults: &mut PlanFaults) {
    let Kind::Text(path) = &named.value.kind else {
        return;
    };
    let location = named.value.location;
    let named_by = match location {
        Location::Text(_) => faults.origin(location),
        Location::Setting(_) => "",
    };
    match host.file(path, named_by) {
        Ok(file) => drop(files.insert(named.key.clone(), file)),
        Err(found) => {
            files.remove(&named.key);
            let message = format!("expected a file for {}, found {found}", quoted(&named.key));
            faults.error(location, one_line(&message));
        }
    }
}

/// Records what is wrong with a parameter: at its value, or the entry in it that is at fault, or at its name where the
/// operator has none of that name.
fn misfit(spec: &OperatorSpec, entry: &Entry, fault: ParameterFault, faults: &mut PlanFaults) {
    let ParameterFault {
        entry: within,
        message,
        ..
    } = fault;
    match spec.parameter_names().any(|known| known == entry.key) {
        true => {
            let within = entry.value.get(&within).map(|within| &within.value);
            faults.error(within.unwrap_or(&entry.value).location, message);
        }
        false => faults.unknown(entry.location, message, &entry.key, spec.parameter_names()),
    }
}

/// The entries whose values are such that JSON has them.
pub(super) fn sound_values<'e>(
    entries: impl IntoIterator<Item = &'e Entry>,
    faults: &mut PlanFaults,
) -> Map<String, Value> {
    let mut values = Map::new();
    for entry in entries {
        let before = faults.error_count();
        let value = entry.value.json(faults);
        if faults.error_count() == before {
            values.insert(entry.key.clone(), value);
        }
    }
    values
}

fn query(step: &mut WrittenStep, sql: &Entry, context: &StepContext<'_>, faults: &mut PlanFaults) {
    let Some(query) = sql.value.text("`sql`", faults) else {
        return;
    };
    if query.trim().is_empty() {
        faults.error(sql.value.location, "`sql` is empty");
        return;
    }
    match context.around.host.tables(query) {
        Ok(tables) => {
            let mut seen = BTreeSet::new();
            for name in tables {
                if seen.insert(name.clone()) {
                    let location = sql.value.location;
                    step.reads(None, LocatedName { name, location }, false);
                }
            }
            step.body = Some(Body::Sql {
                query: query.to_owned(),
            });
        }
        Err(fault) => {
            let (line, column) = fault.at.unwrap_or((1, 1));
            let location =
                faults.inside(sql.value.location, query, QueryPosition::At(line, column));
            faults.error(location, one_line(&fault.message));
        }
    }
}
