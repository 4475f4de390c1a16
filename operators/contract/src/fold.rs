//! Folds: exact, associative accumulation, so that the result does not depend on partitions, threads or machines.
//!
//! ```text
//!   rows ──lift──► states by key ──merge──► one state per key ──finish──► row
//!          (each partition, each session)     (wherever they meet)
//! ```
//! A state is integer or fixed point. It travels between phases as a [`StateRow`]: the key and the state, serialised.

use std::collections::BTreeMap;

use arrow::array::RecordBatch;
use evermap_schemas::{Bytes, Fault, LayerRow, record};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::{Emit, Kernel, Sides};

/// A fold with typed keys and states.
pub trait Fold: Send + Sync + 'static {
    /// Names what is accumulated; the order of keys is the order of the output rows within a site.
    type Key: Ord + Clone + Serialize + DeserializeOwned + Send + Sync;
    /// What is accumulated: integers, so that [`Fold::merge`] is exactly associative and commutative.
    type State: Serialize + DeserializeOwned + Send + Sync;
    /// The output row.
    type Row: LayerRow;

    /// Adds rows to the states.
    ///
    /// # Errors
    /// As [`crate::Mapper::map`].
    fn lift(
        &self,
        rows: &RecordBatch,
        sides: &Sides,
        states: &mut BTreeMap<(String, Self::Key), Self::State>,
        emit: &mut Emit<'_>,
    ) -> Result<(), Fault>;

    /// Adds one state to another. Associative and commutative, exactly.
    ///
    /// # Errors
    /// A data fault when the states cannot be of the same key (a damaged artifact).
    fn merge(&self, into: &mut Self::State, from: Self::State) -> Result<(), Fault>;

    /// The output row of a site's key; `None` where the state says that there is nothing to show.
    ///
    /// # Errors
    /// As [`crate::Mapper::map`].
    fn finish(
        &self,
        site: &str,
        key: &Self::Key,
        state: Self::State,
    ) -> Result<Option<Self::Row>, Fault>;

    /// Bytes that one state holds, roughly: when the states of a lift outgrow their budget they are passed on early,
    /// which cannot change the result.
    fn state_bytes(&self, state: &Self::State) -> usize;
}

record! {
    /// A fold's state on its way from one phase to the next.
    pub struct StateRow {
        /// Site that the state belongs to.
        site: String,
        /// The key, serialised.
        key: Bytes,
        /// The state, serialised.
        state: Bytes,
    }
}
impl LayerRow for StateRow {
    const NAME: &'static str = "states";
    const DOC: &'static str = "A fold's state on its way from one phase to the next.";
    const KEY: &'static [&'static str] = &["site", "key"];
}

/// A fold without its types: what the engine runs.
pub trait FoldKernel: Send + Sync {
    /// Rows to [`StateRow`] batches. States are passed on whenever they exceed `budget_bytes`, and at the end.
    ///
    /// # Errors
    /// As [`Fold::lift`].
    fn lifter(&self, sides: &Sides, budget_bytes: usize) -> Box<dyn Lifter + '_>;

    /// Merges states of one key.
    ///
    /// # Errors
    /// A data fault when a state does not deserialise, or as [`Fold::merge`].
    fn merge(&self, states: Vec<Bytes>) -> Result<Bytes, Fault>;

    /// The output rows (one or none) of a site's key.
    ///
    /// # Errors
    /// As [`Fold::finish`].
    fn finish(
        &self,
        site: &str,
        key: &Bytes,
        state: Bytes,
        emit: &mut Emit<'_>,
    ) -> Result<(), Fault>;
}

/// A lift at work. The batches it emits are [`StateRow`]s.
pub trait Lifter: Send {
    /// Takes rows.
    ///
    /// # Errors
    /// As [`Fold::lift`].
    fn push(&mut self, rows: &RecordBatch, emit: &mut Emit<'_>) -> Result<(), Fault>;

    /// Passes on what is left.
    ///
    /// # Errors
    /// When the reader has gone.
    fn close(&mut self, emit: &mut Emit<'_>) -> Result<(), Fault>;
}

/// The kernel of a typed fold.
pub fn fold<F: Fold>(fold: F) -> Kernel {
    Kernel::Fold(Box::new(Erased(fold)))
}

struct Erased<F>(F);

struct LifterOf<'a, F: Fold> {
    fold: &'a F,
    sides: Sides,
    budget_bytes: usize,
    states: BTreeMap<(String, F::Key), F::State>,
}

fn encode<T: Serialize>(value: &T) -> Result<Bytes, Fault> {
    postcard::to_stdvec(value)
        .map(Bytes)
        .map_err(|error| Fault::bug(format!("a fold's state does not serialise: {error}")))
}

fn decode<T: DeserializeOwned>(bytes: &Bytes) -> Result<T, Fault> {
    postcard::from_bytes(&bytes.0).map_err(|error| {
        Fault::data(format!(
            "expected a fold's state, found {} other bytes: {error}",
            bytes.0.len()
        ))
        .next("delete the artifact and run again")
    })
}

impl<F: Fold> LifterOf<'_, F> {
    fn flush(&mut self, emit: &mut Emit<'_>) -> Result<(), Fault> {
        for ((site, key), state) in std::mem::take(&mut self.states) {
            emit.rows(vec![StateRow {
                site,
                key: encode(&key)?,
                state: encode(&state)?,
            }])?;
        }
        Ok(())
    }
}

impl<F: Fold> Lifter for LifterOf<'_, F> {
    fn push(&mut self, rows: &RecordBatch, emit: &mut Emit<'_>) -> Result<(), Fault> {
        self.fold.lift(rows, &self.sides, &mut self.states, emit)?;
        let held: usize = self
            .states
            .values()
            .map(|state| self.fold.state_bytes(state))
            .sum();
        if held > self.budget_bytes {
            self.flush(emit)
        } else {
            Ok(())
        }
    }

    fn close(&mut self, emit: &mut Emit<'_>) -> Result<(), Fault> {
        self.flush(emit)
    }
}

impl<F: Fold> FoldKernel for Erased<F> {
    fn lifter(&self, sides: &Sides, budget_bytes: usize) -> Box<dyn Lifter + '_> {
        Box::new(LifterOf {
            fold: &self.0,
            sides: sides.clone(),
            budget_bytes,
            states: BTreeMap::new(),
        })
    }

    fn merge(&self, states: Vec<Bytes>) -> Result<Bytes, Fault> {
        let mut states = states.into_iter();
        let Some(first) = states.next() else {
            return Err(Fault::bug("merge of no states"));
        };
        let mut merged: Option<F::State> = None;
        for state in states {
            let into = match merged.as_mut() {
                Some(into) => into,
                None => merged.insert(decode(&first)?),
            };
            self.0.merge(into, decode(&state)?)?;
        }
        merged.map_or(Ok(first), |state| encode(&state))
    }

    fn finish(
        &self,
        site: &str,
        key: &Bytes,
        state: Bytes,
        emit: &mut Emit<'_>,
    ) -> Result<(), Fault> {
        let row = self.0.finish(site, &decode(key)?, decode(&state)?)?;
        emit.rows(row.into_iter().collect())
    }
}
