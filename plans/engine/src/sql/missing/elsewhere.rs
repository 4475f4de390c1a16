//! Functions that other databases have, and what is written here in their place.

/// What is written here for a function of another database.
pub fn written_here(name: &str) -> Option<&'static str> {
    let mut known = ELSEWHERE.iter();
    known
        .find(|(names, _)| names.contains(&name))
        .map(|(_, here)| *here)
}

/// Functions of Postgres and DuckDB, and what is written here instead.
const ELSEWHERE: [(&[&str], &str); 17] = [
    (&["sign"], "signum(x)"),
    (&["typeof", "pg_typeof"], "arrow_typeof(x)"),
    (&["time_bucket"], "date_bin(INTERVAL '1 minute', stamp)"),
    (&["strftime"], "to_char(stamp, '%H:%M')"),
    (&["first", "arbitrary"], "first_value(x ORDER BY stamp)"),
    (&["last"], "last_value(x ORDER BY stamp)"),
    (
        &["arg_max", "argmax", "max_by"],
        "last_value(x ORDER BY y): x where y is the largest",
    ),
    (
        &["arg_min", "argmin", "min_by"],
        "first_value(x ORDER BY y): x where y is the smallest",
    ),
    (&["len"], "length(text), or array_length(list)"),
    (
        &["regexp_extract", "regexp_matches"],
        "regexp_match(text, pattern)[1]",
    ),
    (&["epoch"], "extract(epoch FROM x)"),
    (
        &["epoch_ms", "epoch_ns", "epoch_us"],
        "CAST(stamp AS BIGINT): nanoseconds since 1970",
    ),
    (
        &["age", "date_diff", "datediff"],
        "a - b, and extract(epoch FROM a - b) for seconds",
    ),
    (&["count_if", "countif"], "count(*) FILTER (WHERE …)"),
    (
        &["mode"],
        "(SELECT x FROM … GROUP BY x ORDER BY count(*) DESC LIMIT 1)",
    ),
    (
        &["list_agg", "list", "group_concat"],
        "array_agg(x), or string_agg(text, ', ')",
    ),
    (
        &["unnest", "explode"],
        "it in a SELECT: FROM (SELECT landmark, unnest(sightings) AS s FROM landmarks)",
    ),
];

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::sync::Arc;

    use arrow::array::{ArrayRef, Float64Array, RecordBatch};

    use super::*;
    use crate::error::OrFault;
    use crate::sql::{Limits, context, read_only};

    #[tokio::test]
    async fn a_function_of_another_database_is_named_with_what_is_written_here() {
        let context = context(Limits::one_partition()).unwrap();
        let lanes = RecordBatch::try_from_iter([(
            "x",
            Arc::new(Float64Array::from(vec![1.0])) as ArrayRef,
        )]);
        context.register_batch("lanes", lanes.unwrap()).unwrap();
        for (name, call) in [
            ("sign", "sign(x)"),
            ("pg_typeof", "pg_typeof(x)"),
            ("first", "first(x)"),
            ("max_by", "max_by(x, x)"),
            ("count_if", "count_if(x > 1)"),
            ("mode", "mode() WITHIN GROUP (ORDER BY x)"),
        ] {
            let fault = read_only(&context, &format!("SELECT {call} FROM lanes")).await;
            let fault = fault.err().unwrap();
            assert_eq!(fault.message, format!("there is no function `{name}`"));
            assert!(fault.next.starts_with("write "), "{fault}");
        }
        // There is none that a query could find.
        let state = context.state();
        for name in ELSEWHERE.iter().flat_map(|(names, _)| *names) {
            let known = state.scalar_functions().contains_key(*name)
                || state.aggregate_functions().contains_key(*name)
                || state.window_functions().contains_key(*name);
            assert!(!known, "{name}");
        }
        for query in [
            "SELECT signum(-2.0), arrow_typeof(1), length('a'), regexp_match('ab', 'b')[1]",
            "SELECT date_bin(INTERVAL '1 minute', now()), to_char(now(), '%H:%M')",
            "SELECT first_value(x ORDER BY x), last_value(x ORDER BY x), array_agg(x) FROM lanes",
            "SELECT count(*) FILTER (WHERE x > 1), string_agg('a', ', ') FROM lanes",
        ] {
            read_only(&context, query).await.unwrap();
        }
    }

    #[tokio::test]
    async fn a_list_of_another_table_is_told_to_be_taken_apart_in_a_query() {
        let context = context(Limits::one_partition()).unwrap();
        let lists = "(SELECT [1, 2] AS l) AS a";
        for from in [
            "a, unnest(l) AS t(s)",
            "a CROSS JOIN unnest(a.l)",
            "a, LATERAL unnest(a.l) AS t(s)",
        ] {
            let from = from.replacen('a', lists, 1);
            let query = format!("SELECT * FROM {from}");
            let fault = match read_only(&context, &query).await {
                Ok(frame) => frame.collect().await.or_fault().unwrap_err(),
                Err(fault) => fault,
            };
            assert!(fault.next.contains("(SELECT landmark, unnest("), "{fault}");
        }
    }
}
