//! Folds: exact, associative accumulation, so that the result does not depend on partitions, threads or machines.
//!
//! ```text
//!   rows ──lift──► states by key ──merge──► one state per key ──finish──► row
//!          (each partition, each session)     (wherever they meet)
//! ```
//! A state is integer or fixed point. It travels between phases as a [`StateRow`]: the key and the state, serialised.

use std::collections::BTreeMap;

use arrow::array::RecordBatch;
use evermap_schemas::{Bytes, Fault, LayerRow, Record, record, rows};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::kernel::{Folding, Rows};
use crate::{Emit, Sides};

/// Bytes of states that a lift may hold before it passes them on.
const STATE_BUDGET_BYTES: usize = 256 << 20;

/// A fold with typed keys and states.
pub trait Fold: Send + Sync + Sized + 'static {
    /// The operator's parameters.
    type Params;
    /// A driving row.
    type Row: Record;
    /// Names what is accumulated within a site; the order of keys is the order of the output rows.
    type Key: Ord + Clone + Serialize + DeserializeOwned + Send + Sync;
    /// What is accumulated: integers, so that [`Fold::merge`] is exactly associative and commutative.
    type State: Serialize + DeserializeOwned + Send + Sync;
    /// The output row.
    type Output: LayerRow;

    /// Prepares for a site; sides are empty where states are merged.
    ///
    /// # Errors
    /// A data fault when the sides make no sense.
    fn prepare(params: &Self::Params, sides: &Sides) -> Result<Self, Fault>;

    /// Adds rows to the states.
    ///
    /// # Errors
    /// Only for what makes the whole run senseless; a bad row is skipped with [`Emit::skip`].
    fn lift(
        &self,
        rows: Vec<Self::Row>,
        states: &mut BTreeMap<Self::Key, Self::State>,
        emit: &mut Emit<'_>,
    ) -> Result<(), Fault>;

    /// All states of a key, of which there is at least one, as one. The order of states cannot matter.
    ///
    /// # Errors
    /// A data fault when the states cannot be of the same key (a damaged artifact).
    fn merge(&self, states: Vec<Self::State>) -> Result<Self::State, Fault>;

    /// The output row of a site's key; `None` where the state says that there is nothing to show.
    ///
    /// # Errors
    /// As [`Fold::lift`].
    fn finish(
        &self,
        site: &str,
        key: &Self::Key,
        state: Self::State,
    ) -> Result<Option<Self::Output>, Fault>;

    /// Bytes that one state holds, roughly: when the states of a lift outgrow their budget they are passed on early,
    /// which cannot change the result.
    fn state_bytes(&self, state: &Self::State) -> usize;
}

record! {
    /// A fold's state on its way from one phase to the next.
    #[layer("states", key(site, key))]
    pub struct StateRow {
        /// Site that the state belongs to.
        site: String,
        /// The key, serialised.
        key: Bytes,
        /// The state, serialised.
        state: Bytes,
    }
}

/// A typed fold, prepared for a site.
pub(crate) struct Folded<F>(pub(crate) F);

impl<F: Fold> Folding for Folded<F> {
    fn lifter<'a>(&'a self, site: &str) -> Box<dyn Rows + 'a> {
        Box::new(Lifter {
            fold: &self.0,
            site: site.to_owned(),
            states: BTreeMap::new(),
        })
    }

    fn finish(
        &self,
        site: &str,
        key: &Bytes,
        states: Vec<Bytes>,
        emit: &mut Emit<'_>,
    ) -> Result<(), Fault> {
        let states = states.iter().map(decode).collect::<Result<_, _>>()?;
        let merged = self.0.merge(states)?;
        let row = self.0.finish(site, &decode(key)?, merged)?;
        emit.rows(row.into_iter().collect())
    }
}

struct Lifter<'a, F: Fold> {
    fold: &'a F,
    site: String,
    states: BTreeMap<F::Key, F::State>,
}

impl<F: Fold> Lifter<'_, F> {
    fn flush(&mut self, emit: &mut Emit<'_>) -> Result<(), Fault> {
        for (key, state) in std::mem::take(&mut self.states) {
            emit.rows(vec![StateRow {
                site: self.site.clone(),
                key: encode(&key)?,
                state: encode(&state)?,
            }])?;
        }
        Ok(())
    }
}

impl<F: Fold> Rows for Lifter<'_, F> {
    fn push(&mut self, batch: &RecordBatch, emit: &mut Emit<'_>) -> Result<(), Fault> {
        self.fold.lift(rows(batch)?, &mut self.states, emit)?;
        let bytes = |state| self.fold.state_bytes(state);
        if self.states.values().map(bytes).sum::<usize>() > STATE_BUDGET_BYTES {
            self.flush(emit)?;
        }
        Ok(())
    }

    fn close(mut self: Box<Self>, emit: &mut Emit<'_>) -> Result<(), Fault> {
        self.flush(emit)
    }
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
