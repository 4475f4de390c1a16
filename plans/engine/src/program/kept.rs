//! Which stages are kept as artifacts, and which run inside the units of their readers.

use std::collections::{BTreeMap, BTreeSet};

use evermap_language::Input;

use crate::program::reads::is_whole;
use crate::program::{Scope, Stage};

/// Stages at most that lie one upon the other beneath that of a unit. Each query is planned with all that lies beneath
/// it (`PlannedTable`), so that many take time by the square of their number.
const MOST_LEVELS: usize = 32;

/// Decides which stages are kept: those that are written, are read twice, be it by one query (`read_again`), are read at
/// a wider scope or whole, or lie upon [`MOST_LEVELS`] that are not kept. Stages come after all that they read.
pub fn decide(stages: &mut [Stage], written: &[String], read_again: &BTreeSet<Input>) {
    let mut stored = apart(stages, read_again);
    stored.extend(written.iter().cloned());
    let mut levels: BTreeMap<String, usize> = BTreeMap::new();
    for stage in stages {
        let beneath = stage.reads.iter().filter_map(|read| match &read.table {
            Input::Step(name) => levels.get(name).copied(),
            _ => None,
        });
        let beneath = beneath.max().unwrap_or_default();
        stage.stored = stored.contains(&stage.name) || beneath >= MOST_LEVELS;
        if !stage.stored {
            levels.insert(stage.name.clone(), beneath + 1);
        }
    }
}

/// The stages that cannot run inside their reader: there are several, or it needs them otherwise than they are made.
fn apart(stages: &[Stage], read_again: &BTreeSet<Input>) -> BTreeSet<String> {
    let scopes = stages.iter().map(|stage| (&stage.name, stage.scope));
    let scopes: BTreeMap<&String, Scope> = scopes.collect();
    let (mut read_once, mut apart) = (BTreeSet::new(), BTreeSet::new());
    for stage in stages {
        for read in &stage.reads {
            let (Input::Step(name) | Input::New(name)) = &read.table else {
                continue;
            };
            let of_new = matches!(read.table, Input::New(_));
            let again = !read_once.insert(name) || read_again.contains(&read.table);
            let elsewhere = scopes.get(name) != Some(&stage.scope);
            if of_new || again || elsewhere || is_whole(stage, read) {
                apart.insert(name.clone());
            }
        }
    }
    apart
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::program::Task;
    use crate::program::reads::query_read;
    use crate::sql::described::Notes;

    /// A query that reads these steps.
    fn query(name: &str, tables: &[String]) -> Stage {
        let tables = tables.iter().cloned().map(Input::Step);
        Stage {
            name: name.to_owned(),
            task: Task::Sql {
                query: String::new(),
                ordered: false,
                notes: Notes::new(),
            },
            reads: tables.map(|table| query_read(&table)).collect(),
            scope: Scope::Session,
            stored: false,
            once: false,
        }
    }

    /// Steps of which each reads the one before it.
    fn chain(steps: usize) -> Vec<Stage> {
        let name = |step: usize| format!("s{step}");
        let before = |step: usize| step.checked_sub(1).map(name);
        let stage = |step| query(&name(step), before(step).as_slice());
        (0..steps).map(stage).collect()
    }

    fn kept(mut stages: Vec<Stage>, written: &str, read_again: &[Input]) -> Vec<String> {
        let read_again: BTreeSet<Input> = read_again.iter().cloned().collect();
        decide(&mut stages, &[written.to_owned()], &read_again);
        let kept = stages.into_iter().filter(|stage| stage.stored);
        kept.map(|stage| stage.name).collect()
    }

    #[test]
    fn a_step_that_one_query_reads_twice_is_kept() {
        assert_eq!(kept(chain(4), "s3", &[]), ["s3"]);
        let twice = [1, 2].map(|step| Input::Step(format!("s{step}")));
        assert_eq!(kept(chain(4), "s3", &twice), ["s1", "s2", "s3"]);
    }

    #[test]
    fn no_unit_has_more_levels_than_it_may() {
        let last = format!("s{MOST_LEVELS}");
        assert_eq!(kept(chain(MOST_LEVELS + 1), &last, &[]), [last.as_str()]);
        assert_eq!(kept(chain(100), "s99", &[]), ["s32", "s65", "s98", "s99"]);
        // Side by side they are no levels.
        let mut wide: Vec<_> = (0..100)
            .map(|step| query(&format!("s{step}"), &[]))
            .collect();
        let tables: Vec<_> = wide.iter().map(|stage| stage.name.clone()).collect();
        wide.push(query("all", &tables));
        assert_eq!(kept(wide, "all", &[]), ["all"]);
    }
}
