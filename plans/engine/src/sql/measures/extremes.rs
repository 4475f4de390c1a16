//! The least and the greatest value, in an order of its own.

use std::cmp::Ordering;
use std::fmt::{self, Debug, Formatter};
use std::sync::Arc;

use arrow::array::{ArrayRef, AsArray, PrimitiveArray};
use arrow::datatypes::ArrowPrimitiveType;
use datafusion::common::{Result, ScalarValue};

use crate::sql::measures::{Measure, Spread};

/// Which value is looked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Side {
    /// The least.
    Least,
    /// The greatest.
    Greatest,
}

/// The extreme of values of a type; of equal ones the first.
pub struct Extreme<T: ArrowPrimitiveType> {
    side: Side,
    order: fn(&T::Native, &T::Native) -> Ordering,
}

impl<T: ArrowPrimitiveType> Extreme<T> {
    /// On that side of an order.
    pub fn new(side: Side, order: fn(&T::Native, &T::Native) -> Ordering) -> Self {
        Self { side, order }
    }
}

impl<T: ArrowPrimitiveType> Debug for Extreme<T> {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.side)
    }
}

impl<T: ArrowPrimitiveType> Measure for Extreme<T> {
    type Aggregate = T::Native;

    fn parts(&self, values: &[ArrayRef]) -> Vec<Option<T::Native>> {
        let values = values.iter().map(|values| values.as_primitive::<T>());
        values.flat_map(|values| values.iter()).collect()
    }

    fn joined(&self, before: T::Native, after: T::Native) -> T::Native {
        let wanted = match self.side {
            Side::Least => Ordering::Greater,
            Side::Greatest => Ordering::Less,
        };
        match (self.order)(&before, &after) == wanted {
            true => after,
            false => before,
        }
    }

    fn answer(&self, all: Option<T::Native>) -> Result<ScalarValue> {
        ScalarValue::new_primitive::<T>(all, &T::DATA_TYPE)
    }
}

impl<T: ArrowPrimitiveType> Spread for Extreme<T> {
    fn answers(&self, all: Vec<Option<T::Native>>) -> ArrayRef {
        Arc::new(all.into_iter().collect::<PrimitiveArray<T>>())
    }

    fn columns(&self, parts: Vec<Option<T::Native>>) -> Vec<ArrayRef> {
        vec![self.answers(parts)]
    }

    fn of_columns(&self, columns: &[ArrayRef]) -> Vec<Option<T::Native>> {
        self.parts(columns)
    }
}
