//! Groups, all at once.

use arrow::array::{Array, ArrayRef, BooleanArray};
use datafusion::common::Result;
use datafusion::logical_expr::{EmitTo, GroupsAccumulator};

use crate::sql::measures::{Spread, both};

/// What is known of groups.
#[derive(Debug)]
pub struct OfGroups<M: Spread> {
    measure: M,
    known: Vec<Option<M::Aggregate>>,
}

/// Whether a filter lets a row through.
fn passes(filter: Option<&BooleanArray>, row: usize) -> bool {
    filter.is_none_or(|filter| filter.is_valid(row) && filter.value(row))
}

impl<M: Spread> OfGroups<M> {
    /// Of no groups yet.
    pub fn new(measure: M) -> Self {
        let known = Vec::new();
        Self { measure, known }
    }

    fn add(
        &mut self,
        parts: Vec<Option<M::Aggregate>>,
        groups: &[usize],
        filter: Option<&BooleanArray>,
        count: usize,
    ) {
        self.known.resize(count, None);
        for (row, (part, group)) in parts.into_iter().zip(groups).enumerate() {
            if passes(filter, row)
                && let Some(known) = self.known.get_mut(*group)
            {
                *known = both(&self.measure, *known, part);
            }
        }
    }
}

impl<M: Spread> GroupsAccumulator for OfGroups<M> {
    fn update_batch(
        &mut self,
        values: &[ArrayRef],
        group_indices: &[usize],
        opt_filter: Option<&BooleanArray>,
        total_num_groups: usize,
    ) -> Result<()> {
        let parts = self.measure.parts(values);
        self.add(parts, group_indices, opt_filter, total_num_groups);
        Ok(())
    }

    fn merge_batch(
        &mut self,
        values: &[ArrayRef],
        group_indices: &[usize],
        total_num_groups: usize,
    ) -> Result<()> {
        let parts = self.measure.of_columns(values);
        self.add(parts, group_indices, None, total_num_groups);
        Ok(())
    }

    fn evaluate(&mut self, emit_to: EmitTo) -> Result<ArrayRef> {
        let known = emit_to.take_needed(&mut self.known);
        Ok(self.measure.answers(known))
    }

    fn state(&mut self, emit_to: EmitTo) -> Result<Vec<ArrayRef>> {
        let known = emit_to.take_needed(&mut self.known);
        Ok(self.measure.columns(known))
    }

    fn convert_to_state(
        &self,
        values: &[ArrayRef],
        opt_filter: Option<&BooleanArray>,
    ) -> Result<Vec<ArrayRef>> {
        let parts = self.measure.parts(values).into_iter().enumerate();
        let parts = parts.map(|(row, part)| part.filter(|_| passes(opt_filter, row)));
        Ok(self.measure.columns(parts.collect()))
    }

    fn size(&self) -> usize {
        self.known.capacity() * size_of::<Option<M::Aggregate>>()
    }
}
