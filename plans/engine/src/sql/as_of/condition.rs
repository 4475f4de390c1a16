//! When rows match.

use std::fmt;
use std::sync::Arc;

use arrow::compute::SortOptions;
use datafusion::logical_expr::Operator;
use datafusion::physical_expr::PhysicalExpr;

/// Which row of the right table belongs to one of the left.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Matching {
    /// The last whose time is not later.
    NotLater,
    /// The last whose time is earlier.
    Earlier,
    /// The first whose time is not earlier.
    NotEarlier,
    /// The first whose time is later.
    Later,
}

impl Matching {
    /// What `left op right` asks for; `None` for operators that order no times.
    pub fn of(op: Operator) -> Option<Self> {
        match op {
            Operator::GtEq => Some(Self::NotLater),
            Operator::Gt => Some(Self::Earlier),
            Operator::LtEq => Some(Self::NotEarlier),
            Operator::Lt => Some(Self::Later),
            _ => None,
        }
    }

    /// Whether rows of equal times match.
    pub fn with_equal(self) -> bool {
        matches!(self, Self::NotLater | Self::NotEarlier)
    }
}

impl fmt::Display for Matching {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NotLater => ">=",
            Self::Earlier => ">",
            Self::NotEarlier => "<=",
            Self::Later => "<",
        })
    }
}

/// A value of a plan that runs.
pub type Value = Arc<dyn PhysicalExpr>;

/// A value of the left table, and one of the right.
pub type Pair = (Value, Value);

/// When rows match; of pairs the first value is of the left table.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Condition<V> {
    /// Values that are equal.
    pub keys: Vec<(V, V)>,
    /// The times.
    pub times: (V, V),
    /// Which time is wanted.
    pub matching: Matching,
    /// Where this is not true of the two rows, there is no match.
    pub limit: Option<V>,
}

impl<V> Condition<V> {
    /// All values: those of keys, the times, the limit.
    pub fn values(&self) -> impl Iterator<Item = &V> {
        let pairs = self.keys.iter().chain(std::iter::once(&self.times));
        let values = pairs.flat_map(|(left, right)| [left, right]);
        values.chain(&self.limit)
    }

    /// How rows of equal keys are ordered by time: so that of those that were merged the wanted one is the last.
    pub fn time_order(&self) -> SortOptions {
        SortOptions {
            descending: matches!(self.matching, Matching::NotEarlier | Matching::Later),
            nulls_first: true,
        }
    }
}

/// How rows are ordered by keys.
pub const KEY_ORDER: SortOptions = SortOptions {
    descending: false,
    nulls_first: true,
};

impl<V: fmt::Display> fmt::Display for Condition<V> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (left, right) = &self.times;
        write!(f, "{left} {} {right}", self.matching)?;
        for (left, right) in &self.keys {
            write!(f, ", {left} = {right}")?;
        }
        match &self.limit {
            Some(limit) => write!(f, ", within {limit}"),
            None => Ok(()),
        }
    }
}
