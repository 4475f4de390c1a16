//! Floating point numbers as Postgres has them: NaN is the greatest, -0.0 is 0.0, and what has left a window
//! is forgotten. DataFusion starts at the greatest finite number, and takes what leaves a window
//! from a sum that is NaN or infinite by then.

mod aggregates;
mod decimals;
mod order;
mod percentile;
mod statistics;
mod sums;

use std::sync::Arc;

use datafusion::common::Result;
use datafusion::execution::FunctionRegistry;
use datafusion::logical_expr::AggregateUDF;
use datafusion::prelude::SessionContext;

use crate::sql::floats::aggregates::{FloatAggregate, Of};
use crate::sql::floats::decimals::DoublesBesideDecimals;
use crate::sql::floats::statistics::STATISTICS;
use crate::sql::measures::Side;

pub use order::order;
pub use sums::FloatSum;

/// Has a context compare floating point numbers, and tell those of groups and windows, as Postgres does.
///
/// # Errors
/// When the context lacks one of the functions that are replaced.
pub fn sound_floats(context: &SessionContext) -> Result<()> {
    let others = [
        ("min", Of::Extreme(Side::Least)),
        ("max", Of::Extreme(Side::Greatest)),
        ("percentile_cont", Of::Percentile),
    ];
    let statistics = STATISTICS.map(|(name, statistic)| (name, Of::Statistic(statistic)));
    for (name, of) in others.into_iter().chain(statistics) {
        let inner = context.udaf(name)?;
        context.register_udaf(AggregateUDF::new_from_impl(FloatAggregate { inner, of }));
    }
    let state = context.state_ref();
    let mut state = state.write();
    // Scans are told of the least and the greatest of columns so far, by their bits, and leave out what other aggregates
    // beside them still look for: `max(y * 2)` beside `min(x)`.
    let optimizer = &mut state.config_mut().options_mut().optimizer;
    optimizer.enable_aggregate_dynamic_filter_pushdown = false;
    state.register_function_rewrite(Arc::new(DoublesBesideDecimals))
}

#[cfg(test)]
mod tests;
