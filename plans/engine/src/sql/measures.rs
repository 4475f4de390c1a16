//! What is told of rows, put together of what is known of some of them: of all rows, of groups, and of windows that move.

mod extremes;
mod groups;
mod moving;
mod whole;

use std::fmt::Debug;

use arrow::array::ArrayRef;
use datafusion::common::{Result, ScalarValue};

pub use extremes::{Extreme, Side};
pub use groups::OfGroups;
pub use moving::Moving;
pub use whole::OfAll;

/// What is told of rows.
pub trait Measure: Debug + Send + Sync + 'static {
    /// What is known of rows that follow each other.
    type Aggregate: Copy + Debug + Send + Sync + 'static;

    /// What is known of each row: of one that does not count, as of a null, nothing is.
    fn parts(&self, values: &[ArrayRef]) -> Vec<Option<Self::Aggregate>>;

    /// What is known of rows and of those behind them.
    fn joined(&self, before: Self::Aggregate, after: Self::Aggregate) -> Self::Aggregate;

    /// The answer; `None` stands for no rows.
    fn answer(&self, all: Option<Self::Aggregate>) -> Result<ScalarValue>;
}

/// What is told of groups, too, of which each partition knows a part.
pub trait Spread: Measure {
    /// The answers, in a column.
    fn answers(&self, all: Vec<Option<Self::Aggregate>>) -> ArrayRef;

    /// What is known, as columns.
    fn columns(&self, parts: Vec<Option<Self::Aggregate>>) -> Vec<ArrayRef>;

    /// What such columns say.
    fn of_columns(&self, columns: &[ArrayRef]) -> Vec<Option<Self::Aggregate>>;
}

/// What is known of rows and of those behind them, of which there may be none.
pub fn both<M: Measure>(
    measure: &M,
    before: Option<M::Aggregate>,
    after: Option<M::Aggregate>,
) -> Option<M::Aggregate> {
    match (before, after) {
        (Some(before), Some(after)) => Some(measure.joined(before, after)),
        (before, after) => before.or(after),
    }
}
