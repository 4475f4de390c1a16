//! `evermap explain`.

use std::io::Write;

use evermap_engine::map::{VersionInfo, versions};
use evermap_engine::prepare;
use evermap_engine::sql::Limits;
use evermap_schemas::Fault;

use crate::arguments::ExplainArgs;
use crate::ending::{DONE, Ending, Failure};
use crate::operators;
use crate::output::{print_batch, print_rows};
use crate::progress::line;
use crate::quantity::of;
use crate::reader::MapReader;
use crate::sessions;
use crate::shipped;

/// Shows the plan as composed; on a map, says what a run would recompute, or where the time of the last one went.
///
/// # Errors
/// The plan's faults, or what is wrong with the sessions or the map.
pub async fn explain(args: &ExplainArgs) -> Ending {
    let registry = operators::registry();
    let Some(map) = &args.map else {
        let plan = prepare::composed(&shipped::of(&args.input)?, &registry);
        let plan = plan.map_err(|faults| Failure::Plan(faults.pretty()))?;
        write!(std::io::stdout(), "{plan}")?;
        return DONE;
    };
    if args.analyze {
        return analyze(args, map).await;
    }
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

/// What the units of the newest version that the plan made were at work on, those first that took longest.
async fn analyze(args: &ExplainArgs, map: &str) -> Ending {
    let registry = operators::registry();
    let plan = prepare::parse(&shipped::of(&args.input)?, &registry);
    let plan = plan.map_err(|faults| Failure::Plan(faults.pretty()))?.name;
    let reader = MapReader::open(map, None).await?;
    let made = versions(&reader.map.store).await?;
    let Some(VersionInfo { version, .. }) = made.iter().rev().find(|made| made.plan == plan) else {
        return Err(
            Fault::user(format!("plan {plan} made no version of this map"))
                .next("`evermap versions` lists what made each")
                .into(),
        );
    };
    let work = reader.ask(&work_of(*version)).await?;
    if work.iter().all(|batch| batch.num_rows() == 0) {
        line(&format!(
            "nothing is known of the work on version {version}: it was done before, or by an older evermap"
        ));
    }
    for batch in work {
        print_batch(args.format, batch).await?;
    }
    DONE
}

/// The query for the work on a version.
fn work_of(version: u64) -> String {
    format!(
        "SELECT step, n['node'] AS node, n['of'] AS of, count(*) AS units, sum(n['seconds']) AS seconds,
           sum(n['rows']) AS rows, sum(n['bytes']) AS bytes
         FROM (SELECT step, unnest(nodes) AS n FROM runs WHERE version = {version} AND NOT cached) AS done
         GROUP BY step, n['node'], n['of']
         HAVING sum(n['seconds']) > 0
         ORDER BY seconds DESC"
    )
}
