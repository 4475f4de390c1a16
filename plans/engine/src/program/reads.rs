//! What steps read of the tables that a plan gives them.

use std::collections::BTreeMap;

use evermap_contract::{Entry, Phase, Port, Reach};
use evermap_language::Input;

use crate::program::{Read, Role, Stage, Task};

/// Whether an operator needs the whole table, as a side or for the site's only group.
pub fn is_whole(stage: &Stage, read: &Read) -> bool {
    let runs = matches!(
        &stage.task,
        Task::Op {
            phase: Phase::Run,
            ..
        }
    );
    matches!(read.role, Role::Side(_)) || runs && read.reach == Reach::Site
}

/// What a phase of an operator reads of the tables that a plan gives to its ports.
pub fn operator_reads(entry: &Entry, phase: Phase, inputs: &BTreeMap<String, Input>) -> Vec<Read> {
    let read = |port: &Port, role| {
        let columns = port.layer.columns.iter();
        Some(Read {
            table: inputs.get(port.name)?.clone(),
            role,
            reach: port.reach,
            columns: columns.map(|column| column.name.to_owned()).collect(),
            pixels: port.pixels.map(str::to_owned),
        })
    };
    let driving = read(&entry.driving(phase).port, Role::Driving);
    let sides = entry.sides(phase).iter();
    let sides = sides.map(|port| read(port, Role::Side(port.name.to_owned())));
    std::iter::once(driving).chain(sides).flatten().collect()
}

/// A table that a query names: what belongs to the unit, and whatever columns are used.
pub fn query_read(table: &Input) -> Read {
    Read {
        table: table.clone(),
        role: Role::Query,
        reach: Reach::Session,
        columns: Vec::new(),
        pixels: None,
    }
}
