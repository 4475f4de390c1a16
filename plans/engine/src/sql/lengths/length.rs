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

/// The interval of the same length that stands for all of them: without months, where so many days fit, and with less than a
/// day of nanoseconds. Those of other lengths come before it, or behind it, by months, days and nanoseconds, too.
pub fn plain(interval: IntervalMonthDayNano) -> IntervalMonthDayNano {
    let length = length(interval);
    let fitting = |count: i128| count.clamp(i128::from(i32::MIN), i128::from(i32::MAX));
    let days = length.div_euclid(DAY);
    let over = days - fitting(days);
    let months = fitting((over + 29 * over.signum()) / 30);
    let days = fitting(days - 30 * months);
    let nanoseconds = length - (30 * months + days) * DAY;
    // No part is larger than that of the interval, or what fits.
    IntervalMonthDayNano::new(months as i32, days as i32, nanoseconds as i64)
}
