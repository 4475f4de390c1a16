//! The zone of instants that a query makes: `now()`, `to_timestamp(…)`, casts to `timestamptz`.

use std::sync::Arc;

use datafusion::prelude::SessionContext;

/// That of all stamps.
const UTC: &str = "UTC";

/// Has those who read get instants with their zone, UTC as that of stamps. DataFusion's have none, so that clients take them
/// for some local time. Steps of plans keep what they had: their rows must not depend on who reads.
pub fn in_utc(context: &SessionContext) {
    let functions: Vec<_> = {
        let state = context.state_ref();
        let mut state = state.write();
        state.config_mut().options_mut().execution.time_zone = Some(UTC.to_owned());
        let options = Arc::clone(state.config_options());
        let functions = state.scalar_functions().values();
        let in_zone = functions.filter_map(|known| known.inner().with_updated_config(&options));
        in_zone.collect()
    };
    for function in functions {
        context.register_udf(function);
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use arrow::datatypes::{DataType, TimeUnit};

    use super::*;
    use crate::sql::{Limits, context, read_only};

    #[tokio::test]
    async fn instants_that_a_query_makes_have_the_zone_of_stamps() {
        let context = context(Limits::one_partition()).unwrap();
        in_utc(&context);
        let query = "SELECT now() AS a, current_timestamp AS b, to_timestamp(0) AS c, \
             '2026-01-01'::timestamptz AS d, TIMESTAMP '2026-01-01' AS e";
        let frame = read_only(&context, query).await.unwrap();
        let rows = frame.collect().await.unwrap();
        let schema = rows[0].schema();
        let found: Vec<bool> = schema
            .fields()
            .iter()
            .map(|field| {
                let utc = DataType::Timestamp(TimeUnit::Nanosecond, Some(UTC.into()));
                *field.data_type() == utc
            })
            .collect();
        assert_eq!(found, [true, true, true, true, false], "{schema:?}");
        let said = "SELECT CAST('2026-01-01T12:00:00'::timestamptz AS TEXT) AS said";
        let rows = read_only(&context, said).await.unwrap();
        let rows = rows.collect().await.unwrap();
        let said = arrow::util::display::array_value_to_string(rows[0].column(0), 0).unwrap();
        assert_eq!(said, "2026-01-01T12:00:00Z");
    }
}
