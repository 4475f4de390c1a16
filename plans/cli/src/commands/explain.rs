//! `evermap explain`.

use std::io::Write;

use evermap_engine::prepare;
use evermap_engine::sql::Limits;

use crate::arguments::ExplainArgs;
use crate::ending::{DONE, Ending, Failure};
use crate::output::print_rows;
use crate::progress::line;
use crate::quantity::of;
use crate::sessions;
use crate::shipped;

/// Shows the plan as composed; on a map, says what a run would recompute.
///
/// # Errors
/// The plan's faults, or what is wrong with the sessions or the map.
pub async fn explain(args: &ExplainArgs) -> Ending {
    let registry = evermap_catalog::registry();
    let Some(map) = &args.map else {
        let plan = prepare::parse(&shipped::of(&args.input)?, &registry);
        let plan = plan.map_err(|faults| Failure::Plan(faults.pretty()))?;
        write!(std::io::stdout(), "{plan}")?;
        return DONE;
    };
    let prepared = sessions::prepare(&args.input, &registry, map).await?;
    let forecasts = prepared.run(&registry, Limits::default()).explain().await?;
    let count = forecasts
        .iter()
        .filter(|forecast| forecast.recompute)
        .count() as u64;
    line(&format!(
        "{count} of {} to compute",
        of(forecasts.len() as u64, "unit")
    ));
    print_rows(args.format, forecasts).await?;
    DONE
}
