//! How floating point numbers are ordered: NaN is greater than any other, whatever its sign.

use std::cmp::Ordering;

/// How two numbers are ordered.
pub fn order<N: PartialOrd>(left: &N, right: &N) -> Ordering {
    let is_nan = |value: &N| value.partial_cmp(value).is_none();
    let order = left.partial_cmp(right);
    order.unwrap_or_else(|| is_nan(left).cmp(&is_nan(right)))
}
