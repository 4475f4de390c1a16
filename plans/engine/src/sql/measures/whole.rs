//! All rows of a partition, or of one group.

use arrow::array::ArrayRef;
use datafusion::common::{Result, ScalarValue};
use datafusion::logical_expr::Accumulator;

use crate::sql::measures::{Spread, both};

/// What is known of all rows.
#[derive(Debug)]
pub struct OfAll<M: Spread> {
    measure: M,
    known: Option<M::Aggregate>,
}

impl<M: Spread> OfAll<M> {
    /// Of no rows yet.
    pub fn new(measure: M) -> Self {
        let known = None;
        Self { measure, known }
    }

    fn add(&mut self, parts: Vec<Option<M::Aggregate>>) {
        for part in parts {
            self.known = both(&self.measure, self.known, part);
        }
    }
}

impl<M: Spread> Accumulator for OfAll<M> {
    fn update_batch(&mut self, values: &[ArrayRef]) -> Result<()> {
        self.add(self.measure.parts(values));
        Ok(())
    }

    fn merge_batch(&mut self, states: &[ArrayRef]) -> Result<()> {
        self.add(self.measure.of_columns(states));
        Ok(())
    }

    fn state(&mut self) -> Result<Vec<ScalarValue>> {
        let columns = self.measure.columns(vec![self.known]);
        let columns = columns.iter();
        columns
            .map(|column| ScalarValue::try_from_array(column, 0))
            .collect()
    }

    fn evaluate(&mut self) -> Result<ScalarValue> {
        self.measure.answer(self.known)
    }

    fn size(&self) -> usize {
        size_of_val(self)
    }
}
