//! What every operator must satisfy, whatever it computes. The laws run on every registered operator, on the example
//! of its page; [`run`], the naive engine, is also what an operator's own tests use.
//!
//! | law | says |
//! |---|---|
//! | example | the page's input gives the page's output |
//! | batches | the same rows in batches of 1, 2, 3 … give the same output |
//! | partitions | so do they in 1, 2, 3 partitions, run in either order |
//! | order of input | shuffled input rows give the same output: order comes from the grain |
//! | empty | no rows in give no rows out, and no error |
//! | determinism | twice the same |
//! | schema | the output has the layer's schema, and no two rows have the same key |
//! | parameters | each says what it means, defaults survive a round trip, and an unknown one is refused |

use std::collections::BTreeMap;

use arrow::array::{RecordBatch, UInt32Array};
use arrow::compute::{partition, take_record_batch};
use evermap_schemas::Fault;
use serde_json::{Value, json};

pub use crate::naive::{Outcome, Split, inputs_of, run, sort};
pub use crate::table::{JsonRow, difference, json_rows, lacking, port_schema, table};
use crate::{Entry, Example};

/// How close floating-point results on a page must come.
const PAGE_TOLERANCE: f64 = 1e-6;

/// Holds an operator to every law.
///
/// # Errors
/// A bug fault that names the law and says how it was broken.
pub fn check(entry: &Entry) -> Result<(), Fault> {
    let example = entry
        .page
        .example()
        .filter(|example| !example.inputs.is_empty() && !example.output.is_empty())
        .ok_or_else(|| {
            broken(
                entry,
                "example",
                "the page has no section `## Example` with input and output tables",
            )
        })?;
    let params = Value::Object(example.params.clone());
    let inputs = example_inputs(entry, &example)?;
    let whole = run(entry, &params, &inputs, Split::default())?;
    if let Some(text) = difference(&whole.rows, &example.output, PAGE_TOLERANCE)? {
        return Err(broken(entry, "example", &text));
    }
    let trial = Trial {
        entry,
        params,
        inputs,
        whole,
    };
    trial.splits()?;
    trial.shuffled()?;
    trial.empty()?;
    schema(entry, &trial.whole.rows)?;
    parameters(entry)
}

/// The tables of a page's example, by port.
///
/// # Errors
/// A bug fault where the page names a port or a column that there is not.
pub fn example_inputs(
    entry: &Entry,
    example: &Example,
) -> Result<BTreeMap<String, RecordBatch>, Fault> {
    let inputs = example.inputs.iter().map(|(name, rows)| {
        let port = entry
            .port(name)
            .ok_or_else(|| broken(entry, "example", &format!("there is no port {name}")))?;
        Ok((name.clone(), table(&port_schema(port), rows)?))
    });
    inputs.collect()
}

fn broken(entry: &Entry, law: &str, text: &str) -> Fault {
    Fault::bug(format!(
        "operator {} breaks the law of {law}: {text}",
        entry.name
    ))
}

/// The example of an operator's page, and what comes of it.
struct Trial<'a> {
    entry: &'a Entry,
    params: Value,
    inputs: BTreeMap<String, RecordBatch>,
    whole: Outcome,
}

impl Trial<'_> {
    /// Whether the same comes of it when it is run in this way.
    fn same(
        &self,
        law: &str,
        how: &str,
        inputs: &BTreeMap<String, RecordBatch>,
        split: Split,
    ) -> Result<(), Fault> {
        let (whole, other) = (&self.whole, run(self.entry, &self.params, inputs, split)?);
        if *whole == other {
            return Ok(());
        }
        let text = format!("{how} gives {other:?}, not {whole:?}");
        Err(broken(self.entry, law, &text))
    }

    fn splits(&self) -> Result<(), Fault> {
        for batch_rows in [1, 2, 3, usize::MAX] {
            for (partitions, law) in [(1, "batches"), (2, "partitions"), (3, "partitions")] {
                for reverse in [false, true] {
                    let split = Split {
                        batch_rows,
                        partitions,
                        reverse,
                    };
                    self.same(law, &format!("{split:?}"), &self.inputs, split)?;
                }
            }
        }
        Ok(())
    }

    fn shuffled(&self) -> Result<(), Fault> {
        let reversed = self.inputs.iter().map(|(port, rows)| {
            let order = UInt32Array::from_iter_values((0..rows.num_rows() as u32).rev());
            Ok((port.clone(), take_record_batch(rows, &order)?))
        });
        let reversed = reversed.collect::<Result<_, Fault>>()?;
        self.same(
            "order of input",
            "reversed input",
            &reversed,
            Split::default(),
        )
    }

    fn empty(&self) -> Result<(), Fault> {
        let outcome = run(self.entry, &self.params, &BTreeMap::new(), Split::default())?;
        match outcome.rows.num_rows() {
            0 => Ok(()),
            _ => Err(broken(self.entry, "empty", "rows came out of nothing")),
        }
    }
}

fn schema(entry: &Entry, rows: &RecordBatch) -> Result<(), Fault> {
    let key: Vec<_> = entry
        .output
        .key
        .iter()
        .filter_map(|name| rows.column_by_name(name).cloned())
        .collect();
    if key.len() != entry.output.key.len() {
        return Err(broken(entry, "schema", "a key column is missing"));
    }
    let distinct = if rows.num_rows() == 0 {
        0
    } else {
        partition(&key)?.len()
    };
    if distinct == rows.num_rows() {
        Ok(())
    } else {
        Err(broken(entry, "schema", "two rows have the same key"))
    }
}

fn parameters(entry: &Entry) -> Result<(), Fault> {
    let normal = entry.normalise(&entry.defaults)?;
    if normal != entry.defaults {
        return Err(broken(
            entry,
            "parameters",
            &format!("{} became {normal}", entry.defaults),
        ));
    }
    if entry.normalise(&json!({ "no_such_parameter": 1 })).is_ok() {
        return Err(broken(entry, "parameters", "an unknown one was accepted"));
    }
    if let Some(parameter) = entry
        .parameters()
        .iter()
        .find(|parameter| parameter.doc.is_empty())
    {
        let text = format!("`{}` has no doc comment", parameter.name);
        return Err(broken(entry, "parameters", &text));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::{Emit, Fold, Key, Losses, Operator, Pixels, Port, Sides, Stream, Work};
    use evermap_schemas::layers::VehiclePose;
    use evermap_schemas::{Pose, Stamp, batch, record};
    use schemars::JsonSchema;
    use serde::{Deserialize, Serialize};

    record! {
        /// Poses counted.
        #[layer("counts", key(site))]
        pub struct Count {
            /// Site.
            site: String,
            /// How many.
            poses: u64,
        }
    }

    #[derive(Clone, Default, Serialize, Deserialize, JsonSchema)]
    #[serde(default)]
    struct Params {
        /// Added to each count.
        bias: u64,
    }

    const PAGE: &str = "# counts\n\nCounts.\n\n## Example\n\nWith `bias = 0`:\n\nInput `poses`:\n\n\
        | site | session | stamp |\n|---|---|---|\n| s | a | 1 |\n| s | a | 2 |\n| s | b | 1 |\n| t | c | 1 |\n\n\
        Output:\n\n| site | poses |\n|---|---|\n| s | 3 |\n| t | 1 |\n";

    fn poses() -> Port {
        Port::site::<VehiclePose>("poses")
    }

    struct Folded;
    struct Counter;
    impl Fold for Counter {
        type Params = Params;
        type Row = VehiclePose;
        type Key = ();
        type State = u64;
        type Output = Count;
        fn prepare(_: &Params, _: &Sides) -> Result<Self, Fault> {
            Ok(Counter)
        }
        fn lift(
            &self,
            rows: Vec<VehiclePose>,
            states: &mut BTreeMap<(), u64>,
            _: &mut Emit<'_>,
        ) -> Result<(), Fault> {
            *states.entry(()).or_default() += rows.len() as u64;
            Ok(())
        }
        fn merge(&self, states: Vec<u64>) -> Result<u64, Fault> {
            Ok(states.into_iter().sum())
        }
        fn finish(&self, site: &str, _: &(), poses: u64) -> Result<Option<Count>, Fault> {
            let site = site.to_owned();
            Ok(Some(Count { site, poses }))
        }
        fn state_bytes(&self, _: &u64) -> usize {
            8
        }
    }
    impl Operator for Folded {
        const NAME: &'static str = "counts";
        const VERSION: u32 = 1;
        const PAGE: &'static str = PAGE;
        type Params = Params;
        type Output = Count;
        fn work() -> Work<Params> {
            Work::fold::<Counter>(poses(), vec![])
        }
    }

    struct Grouped;
    impl Operator for Grouped {
        const NAME: &'static str = "counts";
        const VERSION: u32 = 1;
        const PAGE: &'static str = PAGE;
        type Params = Params;
        type Output = Count;
        fn work() -> Work<Params> {
            Work::group(
                poses(),
                Key::SITE,
                vec![],
                |_, rows: Vec<VehiclePose>, _, emit| {
                    let site = rows[0].site.clone();
                    let poses = rows.len() as u64;
                    emit.rows(vec![Count { site, poses }])
                },
            )
        }
    }

    /// Depends on batch boundaries: a defect that the laws must find.
    struct Careless;
    struct Last(Option<Count>);
    impl Stream for Last {
        type Params = Params;
        type Row = VehiclePose;
        fn open(_: &Params, _: &Sides) -> Result<Self, Fault> {
            Ok(Last(None))
        }
        fn push(
            &mut self,
            rows: Vec<VehiclePose>,
            _: &Pixels,
            _: &mut Emit<'_>,
        ) -> Result<(), Fault> {
            let site = rows[0].site.clone();
            let poses = rows.len() as u64;
            self.0 = Some(Count { site, poses });
            Ok(())
        }
        fn close(self, emit: &mut Emit<'_>) -> Result<(), Fault> {
            emit.rows(self.0.into_iter().collect())
        }
    }
    impl Operator for Careless {
        const NAME: &'static str = "counts";
        const VERSION: u32 = 1;
        const PAGE: &'static str = PAGE;
        type Params = Params;
        type Output = Count;
        fn work() -> Work<Params> {
            Work::stream::<Last>(poses(), Key::SITE, vec![])
        }
    }

    /// Counts poses of sites that have counts already, and takes those.
    struct Again;
    impl Operator for Again {
        const NAME: &'static str = "counts";
        const VERSION: u32 = 1;
        const PAGE: &'static str = "# counts\n\nCounts.\n\n## Example\n\nInput `poses`:\n\n\
            | site | session | stamp |\n|---|---|---|\n| s | a | 1 |\n| s | b | 2 |\n| t | c | 1 |\n\n\
            Input `counts`:\n\n| site | poses |\n|---|---|\n| s | 5 |\n| u | 1 |\n\n\
            Output:\n\n| site | poses |\n|---|---|\n| s | 7 |\n";
        type Params = Params;
        type Output = Count;
        fn work() -> Work<Params> {
            let counts = Port::site::<Count>("counts").needed();
            Work::group(
                poses(),
                Key::SITE,
                vec![counts],
                |_, rows: Vec<VehiclePose>, mut sides, emit| {
                    let before: Vec<Count> = sides.take("counts")?;
                    let taken = sides.rows::<Count>("counts")?;
                    let site = rows[0].site.clone();
                    let poses = before[0].poses + (rows.len() + taken.len()) as u64;
                    emit.rows(vec![Count { site, poses }])
                },
            )
        }
    }

    #[test]
    fn where_a_needed_table_is_empty_there_is_nothing_to_do() {
        let entry = Entry::of::<Again>();
        check(&entry).unwrap();
        let job = |rows: Vec<Count>| {
            let counts = BTreeMap::from([inputs_of("counts", rows).unwrap()]);
            let counts = counts.into_iter().map(|(port, rows)| (port, vec![rows]));
            let sides = Sides::new(counts.collect());
            crate::Job::new(&entry, &entry.defaults, crate::Phase::Run, sides).unwrap()
        };
        let site = || "s".to_owned();
        assert!(job(vec![]).is_idle());
        assert!(
            !job(vec![Count {
                site: site(),
                poses: 0
            }])
            .is_idle()
        );
    }

    #[test]
    fn rows_are_held_that_wait_for_the_rest_of_their_key() {
        let pose = |site: &str, stamp: i64| VehiclePose {
            site: site.to_owned(),
            session: "a".to_owned(),
            stamp: Stamp(stamp),
            map_from_vehicle: Pose::IDENTITY,
        };
        let (begun, ended) = ([pose("s", 1), pose("s", 2)], [pose("s", 3), pose("t", 1)]);
        let batches = [begun, ended].map(|rows| batch(rows.to_vec()).unwrap());
        let held = |entry: &Entry| {
            let sides = Sides::default();
            let job = crate::Job::new(entry, &entry.defaults, crate::Phase::Run, sides).unwrap();
            let mut worker = job.worker();
            let (mut pass, mut losses) = (|_: RecordBatch| Ok::<(), Fault>(()), Losses::default());
            let mut emit = Emit::new(&mut pass, &mut losses);
            let mut after = |batch: &RecordBatch| {
                worker.push(batch, &mut emit).unwrap();
                worker.held()
            };
            [after(&batches[0]), after(&batches[1])]
        };
        assert_eq!(held(&Entry::of::<Grouped>()), [2, 1]);
        assert_eq!(held(&Entry::of::<Careless>()), [0, 0]);
    }

    #[test]
    fn sound_operators_pass() {
        check(&Entry::of::<Folded>()).unwrap();
        check(&Entry::of::<Grouped>()).unwrap();
    }

    #[test]
    fn a_careless_operator_is_caught() {
        let text = check(&Entry::of::<Careless>()).unwrap_err().to_string();
        assert!(text.contains("law of batches"), "{text}");
    }

    #[test]
    fn a_reference_has_one_table_of_parameters() {
        let text = Entry::of::<Grouped>().reference();
        assert!(
            text.contains("| `bias` | integer | of at least 0 | 0 | Added to each count. |"),
            "{text}"
        );
        assert!(
            text.contains("| `poses` | `poses` | all rows of one site, by"),
            "{text}"
        );
    }
}
