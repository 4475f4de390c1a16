//! How long an interval is.

use std::cmp::Ordering;

use arrow::datatypes::{DataType, IntervalMonthDayNano, IntervalUnit};

/// What intervals are that a query says.
pub const WHOLE: DataType = DataType::Interval(IntervalUnit::MonthDayNano);

/// Nanoseconds of a day.
const DAY: i128 = 86_400_000_000_000;

/// How long an interval is, ns.
pub fn length(interval: IntervalMonthDayNano) -> i128 {
    let days = 30 * i128::from(interval.months) + i128::from(interval.days);
    days * DAY + i128::from(interval.nanoseconds)
}

/// How two intervals are ordered; those of one length by their parts, in whatever order they come.
pub fn order(left: &IntervalMonthDayNano, right: &IntervalMonthDayNano) -> Ordering {
    let by_length = length(*left).cmp(&length(*right));
    by_length.then_with(|| left.cmp(right))
}
