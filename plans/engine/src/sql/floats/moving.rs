//! Windows that move. What is told of one is put together of what is known of parts of it, and nothing is taken away again:
//! NaN and infinity leave no trace, and no digits are lost to values that have left.

use std::fmt::Debug;

use arrow::array::ArrayRef;
use datafusion::common::{Result, ScalarValue, not_impl_err};
use datafusion::logical_expr::Accumulator;

/// What is told of rows.
pub trait Measure: Debug + Send + Sync + 'static {
    /// What is known of rows that follow each other.
    type Part: Copy + Debug + Send + Sync + 'static;

    /// What is known of each row that counts: of nulls nothing is.
    fn parts(&self, values: &[ArrayRef]) -> Vec<Self::Part>;

    /// What is known of rows and of those behind them.
    fn joined(&self, before: Self::Part, after: Self::Part) -> Self::Part;

    /// The answer; `None` stands for no rows.
    fn answer(&self, all: Option<Self::Part>) -> Result<ScalarValue>;
}

/// What is known of the rows of a window, which leave it in the order in which they came. Each row is moved once from those
/// at the back to those in front, so it costs three steps however many rows there are.
#[derive(Debug)]
pub struct Moving<M: Measure> {
    measure: M,
    /// Of each row in front, it and those behind it among these, the foremost row at the end.
    front: Vec<M::Part>,
    /// Of each row at the back.
    back: Vec<M::Part>,
    /// Of all rows at the back.
    behind: Option<M::Part>,
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

    fn push(&mut self, row: M::Part) {
        let behind = self.behind;
        self.behind = Some(behind.map_or(row, |before| self.measure.joined(before, row)));
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

    fn all(&self) -> Option<M::Part> {
        match (self.front.last().copied(), self.behind) {
            (Some(before), Some(after)) => Some(self.measure.joined(before, after)),
            (front, behind) => front.or(behind),
        }
    }
}

impl<M: Measure> Accumulator for Moving<M> {
    fn update_batch(&mut self, values: &[ArrayRef]) -> Result<()> {
        for row in self.measure.parts(values) {
            self.push(row);
        }
        Ok(())
    }

    fn retract_batch(&mut self, values: &[ArrayRef]) -> Result<()> {
        for _ in self.measure.parts(values) {
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
        size_of_val(self) + parts * size_of::<M::Part>()
    }
}
