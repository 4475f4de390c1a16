//! Windows that move. What is told of one is put together of what is known of parts of it, and nothing is taken away again:
//! NaN and infinity leave no trace, and no digits are lost to values that have left.

use arrow::array::ArrayRef;
use datafusion::common::{Result, ScalarValue, not_impl_err};
use datafusion::logical_expr::Accumulator;

use crate::sql::measures::{Measure, both};

/// What is known of the rows of a window, which leave it in the order in which they came. Each row is moved once from those
/// at the back to those in front, so it costs three steps however many rows there are.
#[derive(Debug)]
pub struct Moving<M: Measure> {
    measure: M,
    /// Of each row in front, it and those behind it among these, the foremost row at the end.
    front: Vec<M::Aggregate>,
    /// Of each row at the back.
    back: Vec<M::Aggregate>,
    /// Of all rows at the back.
    behind: Option<M::Aggregate>,
}

impl<M: Measure> Moving<M> {
    /// Of no rows yet.
    pub fn new(measure: M) -> Self {
        Self {
            measure,
            front: Vec::new(),
            back: Vec::new(),
            behind: None,
        }
    }

    fn push(&mut self, row: M::Aggregate) {
        self.behind = both(&self.measure, self.behind, Some(row));
        self.back.push(row);
    }

    fn pop(&mut self) {
        if self.front.is_empty() {
            self.behind = None;
            while let Some(row) = self.back.pop() {
                let after = self.front.last().copied();
                let part = after.map_or(row, |after| self.measure.joined(row, after));
                self.front.push(part);
            }
        }
        self.front.pop();
    }

    fn all(&self) -> Option<M::Aggregate> {
        both(&self.measure, self.front.last().copied(), self.behind)
    }
}

impl<M: Measure> Accumulator for Moving<M> {
    fn update_batch(&mut self, values: &[ArrayRef]) -> Result<()> {
        for row in self.measure.parts(values).into_iter().flatten() {
            self.push(row);
        }
        Ok(())
    }

    fn retract_batch(&mut self, values: &[ArrayRef]) -> Result<()> {
        for _ in self.measure.parts(values).into_iter().flatten() {
            self.pop();
        }
        Ok(())
    }

    fn supports_retract_batch(&self) -> bool {
        true
    }

    fn state(&mut self) -> Result<Vec<ScalarValue>> {
        not_impl_err!("partial answers of a window that moves")
    }

    fn merge_batch(&mut self, _: &[ArrayRef]) -> Result<()> {
        not_impl_err!("partial answers of a window that moves")
    }

    fn evaluate(&mut self) -> Result<ScalarValue> {
        self.measure.answer(self.all())
    }

    fn size(&self) -> usize {
        let parts = self.front.capacity() + self.back.capacity();
        size_of_val(self) + parts * size_of::<M::Aggregate>()
    }
}
