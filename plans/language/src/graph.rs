//! From names to a graph: what each input is, in which order steps run, what is not used.

mod order;

use std::collections::{BTreeMap, BTreeSet};

use crate::fault::{Location, PlanFaults, Severity};
use crate::inside::QueryPosition;
use crate::plan::{Body, Input, Plan, PlanTest, Row, Step};
use crate::suggest::quoted;
use crate::vocabulary::Vocabulary;
use crate::written::{LocatedName, WrittenInput, WrittenPlan, WrittenStep, WrittenTest};

/// Names that can be read.
struct Names<'n> {
    /// Steps by name, to their index as written.
    steps: BTreeMap<&'n str, usize>,
    in_order: Vec<&'n str>,
    vocabulary: &'n Vocabulary,
}

/// Resolves every name, records what is wrong, and makes the plan of what is not.
pub(crate) fn plan(written: WrittenPlan, vocabulary: &Vocabulary, faults: &mut PlanFaults) -> Plan {
    let in_order: Vec<&str> = written.steps.iter().map(|s| s.name.name.as_str()).collect();
    let names = Names {
        steps: in_order
            .iter()
            .enumerate()
            .map(|(i, name)| (*name, i))
            .collect(),
        in_order,
        vocabulary,
    };
    let before = faults.error_count();
    let inputs: Vec<Vec<Option<Input>>> = written
        .steps
        .iter()
        .map(|step| names.inputs(step, faults))
        .collect();
    let reads: Vec<Vec<usize>> = inputs.iter().map(|inputs| names.reads(inputs)).collect();
    let order = order::order(&written.steps, &reads, faults);
    let write = names.write(&written.write, faults);
    names.needs(&written.needs, &inputs, faults);
    let tests: Vec<Option<PlanTest>> = written
        .tests
        .iter()
        .map(|test| names.test(test, faults))
        .collect();
    if written.write_is_whole && faults.error_count() == before {
        names.warn_of_unused(&written.steps, &reads, &write, faults);
    }
    let faulty = faulty(&written.steps, &inputs, &order);
    let faulty: BTreeSet<String> = faulty.into_iter().map(str::to_owned).collect();
    let mut steps: Vec<Option<Step>> = written
        .steps
        .into_iter()
        .zip(inputs)
        .map(|(step, inputs)| match faulty.contains(&step.name.name) {
            true => None,
            false => finished(step, inputs),
        })
        .collect();
    Plan {
        steps: order
            .into_iter()
            .filter_map(|index| steps.get_mut(index)?.take())
            .collect(),
        write: written.write.into_iter().map(|named| named.name).collect(),
        tests: tests.into_iter().flatten().collect(),
        name: written.name,
        doc: written.doc,
        needs: written.needs.into_iter().map(|named| named.name).collect(),
        sessions: written.sessions,
        warnings: PlanFaults::default(),
    }
}

/// The step with what its names stand for.
fn finished(step: WrittenStep, resolved: Vec<Option<Input>>) -> Option<Step> {
    let inputs = step.inputs.into_iter().zip(resolved);
    let named = |(input, resolved): (WrittenInput, Option<Input>)| {
        let name = input.port.unwrap_or(input.table.name);
        Some((name, resolved?))
    };
    Some(Step {
        name: step.name.name,
        position: step.name.location.position(),
        inputs: inputs.map(named).collect::<Option<_>>()?,
        body: step.body?,
        body_location: step.body_location,
        once: step.once,
    })
}

/// The steps at fault, those that have no order, and those that read any of them.
fn faulty<'s>(
    steps: &'s [WrittenStep],
    inputs: &'s [Vec<Option<Input>>],
    order: &[usize],
) -> BTreeSet<&'s str> {
    let order: BTreeSet<usize> = order.iter().copied().collect();
    let mut readers = BTreeMap::<&str, Vec<&str>>::new();
    let mut open = Vec::new();
    for (index, (step, inputs)) in steps.iter().zip(inputs).enumerate() {
        let name = step.name.name.as_str();
        if !step.is_sound || inputs.iter().any(Option::is_none) || !order.contains(&index) {
            open.push(name);
        }
        for input in inputs.iter().flatten() {
            if let Input::Step(read) | Input::New(read) | Input::Previous(read) = input {
                readers.entry(read).or_default().push(name);
            }
        }
    }
    let mut faulty = BTreeSet::new();
    while let Some(step) = open.pop() {
        if faulty.insert(step) {
            open.extend(readers.get(step).into_iter().flatten());
        }
    }
    faulty
}

impl Names<'_> {
    fn inputs(&self, step: &WrittenStep, faults: &mut PlanFaults) -> Vec<Option<Input>> {
        let resolve = |input: &WrittenInput| {
            let what = match &input.port {
                Some(port) => format!("port {}", quoted(port)),
                None => format!("the query of {}", quoted(&step.name.name)),
            };
            if input.is_implied && !self.has_table_for(input, step) {
                let message = format!("{what} is not connected, and no other table has its name");
                faults.error(input.table.location, message);
                return None;
            }
            let mut tried = PlanFaults::default();
            let found = self.input(&input.table, &what, &mut tried);
            if tried.is_empty() {
                return found;
            }
            let mut table = input.table.clone();
            if let Some(Body::Sql { query }) = &step.body {
                table.location =
                    faults.inside(step.body_location, query, QueryPosition::Word(&table.name));
            }
            self.input(&table, &what, faults)
        };
        step.inputs.iter().map(resolve).collect()
    }

    /// Whether there is a table of a port's own name, which is not the step that has the port.
    fn has_table_for(&self, port: &WrittenInput, step: &WrittenStep) -> bool {
        let name = port.table.name.as_str();
        let is_other_step = self.steps.contains_key(name) && name != step.name.name;
        is_other_step || self.vocabulary.is_source(name)
    }

    /// What a name that is read stands for.
    fn input(&self, named: &LocatedName, what: &str, faults: &mut PlanFaults) -> Option<Input> {
        let name = named.name.as_str();
        if let Some(layer) = name.strip_prefix(Input::PREVIOUS) {
            return self.previous(layer, named.location, faults);
        }
        if let Some(step) = name.strip_prefix(Input::NEW) {
            let location = named.location;
            let named = LocatedName {
                name: step.to_owned(),
                location,
            };
            self.step(&named, "`new.`", faults)?;
            return Some(Input::New(step.to_owned()));
        }
        if self.steps.contains_key(name) {
            return Some(Input::Step(name.to_owned()));
        }
        if self.vocabulary.is_source(name) {
            return Some(Input::Source(name.to_owned()));
        }
        let message = format!(
            "{what} reads {}, which is neither a step nor a source",
            quoted(name)
        );
        let known = self.in_order.iter().copied();
        faults.unknown(
            named.location,
            message,
            name,
            known.chain(self.vocabulary.source_names()),
        );
        None
    }

    /// Another plan may have published the layer, so that an unknown name is only a warning.
    fn previous(&self, layer: &str, location: Location, faults: &mut PlanFaults) -> Option<Input> {
        if layer.is_empty() {
            faults.error(
                location,
                "`previous.` must be followed by the name of a layer",
            );
            return None;
        }
        if !self.steps.contains_key(layer) {
            let message = format!(
                "`previous.` is followed by {}, no step of this plan",
                quoted(layer)
            );
            let known = self.in_order.iter().copied();
            faults.unknown_as(Severity::Warning, location, message, layer, known);
        }
        Some(Input::Previous(layer.to_owned()))
    }

    /// The steps a step reads, by index.
    fn reads(&self, inputs: &[Option<Input>]) -> Vec<usize> {
        let step = |input: &Option<Input>| match input {
            Some(Input::Step(name) | Input::New(name)) => self.steps.get(name.as_str()).copied(),
            _ => None,
        };
        let indices: BTreeSet<usize> = inputs.iter().filter_map(step).collect();
        indices.into_iter().collect()
    }

    /// A name that must be a step; `what` is what names it.
    fn step(&self, named: &LocatedName, what: &str, faults: &mut PlanFaults) -> Option<usize> {
        let name = named.name.as_str();
        if let Some(index) = self.steps.get(name) {
            return Some(*index);
        }
        let is_table = self.vocabulary.is_source(name) || name.starts_with(Input::PREVIOUS);
        let message = if is_table {
            format!(
                "{what} names {}, which is a source, not a step",
                quoted(name)
            )
        } else {
            format!("{what} names {}, which is not a step", quoted(name))
        };
        faults.unknown(named.location, message, name, self.in_order.iter().copied());
        None
    }

    fn write(&self, write: &[LocatedName], faults: &mut PlanFaults) -> Vec<usize> {
        let mut seen = BTreeSet::new();
        let mut indices = Vec::new();
        for named in write {
            if !seen.insert(named.name.as_str()) {
                let name = quoted(&named.name);
                faults.error(named.location, format!("`write` names {name} twice"));
                continue;
            }
            indices.extend(self.step(named, "`write`", faults));
        }
        indices
    }

    /// What a plan needs of sessions are sources that its steps read.
    fn needs(&self, needs: &[LocatedName], inputs: &[Vec<Option<Input>>], faults: &mut PlanFaults) {
        let known = || self.vocabulary.source_names();
        let are_whole = inputs.iter().flatten().all(Option::is_some);
        for need in needs {
            let name = need.name.as_str();
            let reads = |input: &Input| matches!(input, Input::Source(source) if source == name);
            let said = quoted(name);
            if !known().any(|known| known == name) {
                let message = format!("`needs` names {said}, which is not a source");
                faults.unknown(need.location, message, name, known());
            } else if are_whole && !inputs.iter().flatten().flatten().any(reads) {
                let message = format!("`needs` names {said}, which no step reads");
                faults.error(need.location, message);
            }
        }
    }

    fn test(&self, test: &WrittenTest, faults: &mut PlanFaults) -> Option<PlanTest> {
        let mut given = Vec::new();
        let mut sound = true;
        for (named, rows) in &test.given {
            match self.input(named, "`given`", faults) {
                Some(input) => given.push((input, rows.clone())),
                None => sound = false,
            }
        }
        let mut made = |key: &str, tables: &[(LocatedName, Vec<Row>)]| {
            let mut made = Vec::new();
            for (named, rows) in tables {
                sound &= self.step(named, key, faults).is_some();
                if test.given.iter().any(|(given, _)| given.name == named.name) {
                    let name = quoted(&named.name);
                    let message = format!("{name} is given, so that expecting it tests nothing");
                    faults.error(named.location, message);
                }
                made.push((named.name.clone(), rows.clone()));
            }
            made
        };
        let expect = made("`expect`", &test.expect);
        let contains = made("`contains`", &test.contains);
        sound.then(|| PlanTest {
            name: test.name.name.clone(),
            position: test.name.location.position(),
            given,
            expect,
            contains,
            tolerance: test.tolerance,
        })
    }

    fn warn_of_unused(
        &self,
        steps: &[WrittenStep],
        reads: &[Vec<usize>],
        write: &[usize],
        faults: &mut PlanFaults,
    ) {
        let read: BTreeSet<usize> = reads.iter().flatten().copied().collect();
        let needed = order::reachable(reads, write);
        for (index, step) in steps.iter().enumerate() {
            if needed.contains(&index) {
                continue;
            }
            let name = quoted(&step.name.name);
            let message = if read.contains(&index) {
                format!("step {name} feeds only steps that are not written")
            } else {
                format!("step {name} is neither read nor written")
            };
            faults.warning(step.name.location, message);
        }
    }
}
