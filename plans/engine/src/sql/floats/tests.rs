#![allow(clippy::unwrap_used)]
use std::sync::Arc;

use arrow::array::{ArrayRef, Float64Array};
use arrow::util::display::array_value_to_string;
use datafusion::logical_expr::Accumulator;
use datafusion::prelude::SessionContext;

use crate::sql::floats::FloatSum;
use crate::sql::floats::statistics::Statistic;
use crate::sql::measures::Moving;
use crate::sql::{Limits, context};

/// Groups of two numbers each, of which one is NaN with a sign, or infinite; and both zeros.
const TABLES: &str = "WITH t AS (SELECT * FROM (VALUES \
    (1, 1, 1.5), (2, 1, -CAST('NaN' AS DOUBLE)), (3, 2, CAST('inf' AS DOUBLE)), (4, 2, CAST('inf' AS DOUBLE)), \
    (5, 3, CAST('-inf' AS DOUBLE)), (6, 3, 2.0), (7, 4, CAST(NULL AS DOUBLE))) t (i, g, x)), \
    z AS (SELECT * FROM (VALUES (1, 0.0), (2, CAST('-0.0' AS DOUBLE)), (3, 1.0)) z (i, x)), \
    d AS (SELECT CAST(1 AS DECIMAL(5, 2)) AS d) ";

fn at(partitions: usize) -> SessionContext {
    let limits = Limits {
        partitions,
        ..Limits::default()
    };
    context(limits).unwrap()
}

/// The rows of a query, each with `|` between its values.
async fn rows(context: &SessionContext, query: &str) -> Vec<String> {
    let frame = context.sql(&format!("{TABLES}{query}")).await.unwrap();
    let mut rows = Vec::new();
    for batch in frame.collect().await.unwrap() {
        for row in 0..batch.num_rows() {
            let values = batch.columns().iter();
            let values = values.map(|column| array_value_to_string(column, row).unwrap());
            rows.push(values.collect::<Vec<_>>().join("|"));
        }
    }
    rows
}

async fn all_answer(expected: &[(&str, &[&str])]) {
    for partitions in [1, 3] {
        let context = at(partitions);
        for (query, expected) in expected {
            assert_eq!(rows(&context, query).await, *expected, "{query}");
        }
    }
}

#[tokio::test]
async fn nan_is_greatest_and_infinity_is_found_in_groups_and_windows() {
    all_answer(&[
        ("SELECT min(x), max(x) FROM t", &["-inf|NaN"]),
        (
            "SELECT g, min(x), max(x) FROM t GROUP BY g ORDER BY g",
            &["1|1.5|NaN", "2|inf|inf", "3|-inf|2.0", "4||"],
        ),
        (
            "SELECT min(CAST(x AS REAL)), max(CAST(x AS REAL)) FROM t GROUP BY g ORDER BY g",
            &["1.5|NaN", "inf|inf", "-inf|2.0", "|"],
        ),
        (
            "SELECT max(x) OVER (ORDER BY i ROWS BETWEEN 1 PRECEDING AND CURRENT ROW) FROM t ORDER BY i",
            &["1.5", "NaN", "NaN", "inf", "inf", "2.0", "2.0"],
        ),
        ("SELECT i FROM t WHERE x IS NOT NULL ORDER BY x DESC, i LIMIT 2", &["2", "3"]),
        // All others are told by DataFusion.
        ("SELECT min(i), max(g), max(CAST(i AS VARCHAR)) FROM t", &["1|4|7"]),
    ])
    .await;
}

#[tokio::test]
async fn zeros_are_equal_wherever_they_are_compared() {
    all_answer(&[
        (
            "SELECT i FROM z WHERE x IN (0.0, 2.0, 3.0, 4.0) ORDER BY i",
            &["1", "2"],
        ),
        (
            "SELECT i FROM z WHERE nullif(x, 0.0) IS NULL ORDER BY i",
            &["1", "2"],
        ),
        (
            "SELECT CASE x WHEN 0.0 THEN 'zero' WHEN 1.0 THEN 'one' END FROM z ORDER BY i",
            &["zero", "zero", "one"],
        ),
        (
            "SELECT i FROM z WHERE array_has([x, 2.0], 0.0) ORDER BY i",
            &["1", "2"],
        ),
        ("SELECT count(DISTINCT x), sum(DISTINCT i) FROM z", &["2|6"]),
        (
            "SELECT rank() OVER (ORDER BY x) FROM z ORDER BY i",
            &["1", "1", "3"],
        ),
        (
            "SELECT count(*) OVER (PARTITION BY x) FROM z ORDER BY i",
            &["2", "2", "1"],
        ),
        // Windows of one node have one key, whatever they filter, and one may stand on another.
        (
            "SELECT count(*) FILTER (WHERE x > 0.5) OVER w, sum(i) OVER w, sum(i) OVER (PARTITION BY i), rank() OVER (ORDER BY x) \
             FROM z WINDOW w AS (PARTITION BY x ORDER BY i) ORDER BY i",
            &["0|1|1|1", "0|3|2|1", "1|3|3|3"],
        ),
        (
            "SELECT s, count(*) OVER (PARTITION BY s) FROM (SELECT i, x + 0.0 * sum(x) OVER (PARTITION BY x) AS s FROM z) ORDER BY i",
            &["0.0|2", "0.0|2", "1.0|1"],
        ),
        ("SELECT DISTINCT ON (x) i FROM z ORDER BY x, i", &["1", "3"]),
        ("SELECT i FROM z ORDER BY x DESC, i", &["3", "1", "2"]),
        ("SELECT count(*) FROM z GROUP BY x ORDER BY 1", &["1", "2"]),
        ("SELECT count(*) FROM z a JOIN z b ON a.x = b.x", &["5"]),
        (
            "SELECT array_agg(DISTINCT x ORDER BY x) FROM z",
            &["[0.0, 1.0]"],
        ),
    ])
    .await;
}

#[tokio::test]
async fn decimals_beside_doubles_are_doubles() {
    all_answer(&[
        (
            "SELECT i FROM t, d WHERE x > d ORDER BY i",
            &["1", "2", "3", "4", "6"],
        ),
        (
            "SELECT arrow_typeof(coalesce(x, d)) FROM t, d WHERE i = 7",
            &["Float64"],
        ),
        (
            "SELECT 1e-20 = d - d, 1e300 > d, d IN (1e300, 1.0), d = 1 FROM d",
            &["false|true|true|true"],
        ),
    ])
    .await;
}

#[tokio::test]
async fn percentiles_are_as_far_between_two_numbers_as_they_are() {
    all_answer(&[
        (
            "SELECT percentile_cont(0.1234567) WITHIN GROUP (ORDER BY x * 1e6) FROM z WHERE i > 1",
            &["123456.7"],
        ),
        (
            "SELECT percentile_cont(0.5) WITHIN GROUP (ORDER BY x) FROM t WHERE i BETWEEN 3 AND 6 GROUP BY g ORDER BY g",
            &["inf", "-inf"],
        ),
        (
            "SELECT percentile_cont(0.25) WITHIN GROUP (ORDER BY x) FROM (VALUES (-1.5e308), (1.5e308)) v (x)",
            &["-7.5e307"],
        ),
        (
            "SELECT percentile_cont(0.0) WITHIN GROUP (ORDER BY x) FROM t GROUP BY g ORDER BY g",
            &["1.5", "inf", "-inf", ""],
        ),
        (
            "SELECT percentile_cont(r, 0.25), percentile_cont(i, 0.25) FROM (SELECT i, CAST(i AS REAL) AS r FROM t) u",
            &["2.5|2.5"],
        ),
    ])
    .await;
}

#[tokio::test]
async fn statistics_of_infinities_are_no_numbers() {
    const VALUES: &str = "FROM (VALUES (1, CAST('inf' AS DOUBLE), 1.0), (2, 2.0, 2.0), (2, CAST('-inf' AS DOUBLE), 4.0), \
        (3, 1.0, 2.0), (3, 3.0, 4.0)) v (k, a, b)";
    let told = "var_pop(a), var_samp(a), stddev_pop(a), covar_pop(a, b), corr(a, b), regr_sxx(b, a), regr_avgx(b, a)";
    let grouped = format!("SELECT {told} {VALUES} GROUP BY k ORDER BY k");
    let whole = format!("SELECT {told} {VALUES} WHERE k = 1");
    let moving = "SELECT var_pop(a) OVER w, covar_samp(a, b) OVER w, corr(a, b) OVER w";
    let moving = format!(
        "{moving} {VALUES} WINDOW w AS (ORDER BY b, k ROWS BETWEEN 1 PRECEDING AND CURRENT ROW) ORDER BY b, k"
    );
    let one = "NaN||NaN|NaN||NaN|inf";
    all_answer(&[
        (
            &grouped,
            &[
                one,
                "NaN|NaN|NaN|NaN|NaN|NaN|-inf",
                "1.0|2.0|1.0|1.0|1.0|2.0|2.0",
            ],
        ),
        (&whole, &[one]),
        (
            &moving,
            &[
                "NaN||",
                "NaN|NaN|NaN",
                "0.25|0.0|",
                "NaN|NaN|NaN",
                "NaN|NaN|",
            ],
        ),
    ])
    .await;
}

#[tokio::test]
async fn a_level_line_tells_all_and_an_upright_one_nothing() {
    const VALUES: &str = "FROM (VALUES (1, 1.0, 5.0), (1, 2.0, 5.0), (2, 3.0, 6.0), (2, 3.0, 7.0), (3, 1.0, NULL)) v (k, x, y)";
    let told = "SELECT regr_r2(y, x), regr_slope(y, x), corr(y, x), regr_count(y, x)";
    let grouped = format!("{told} {VALUES} GROUP BY k ORDER BY k");
    let moving = format!(
        "SELECT regr_r2(y, x) OVER (ORDER BY y ROWS BETWEEN 1 PRECEDING AND CURRENT ROW) {VALUES} WHERE k = 1"
    );
    all_answer(&[
        (&grouped, &["1.0|0.0||2", "|||2", "|||0"]),
        (&moving, &["", "1.0"]),
    ])
    .await;
}

#[tokio::test]
async fn columns_are_called_as_they_were() {
    let ours = at(1);
    let plain = SessionContext::new();
    for query in [
        "SELECT min(x), max(x), stddev(x), count(DISTINCT x), nullif(x, 0.0) FROM z GROUP BY x",
        "SELECT rank() OVER (PARTITION BY x ORDER BY x DESC), x IN (0.0, x), CASE x WHEN 0.0 THEN 1 END FROM z",
        "SELECT coalesce(x, d), x > d, x BETWEEN d AND 2 FROM z, d ORDER BY x, d",
    ] {
        let query = format!("{TABLES}{query}");
        let mut names = Vec::new();
        for context in [&ours, &plain] {
            let frame = context.sql(&query).await.unwrap();
            let plan = frame.create_physical_plan().await.unwrap();
            let fields = plan.schema().fields().clone();
            names.push(
                fields
                    .iter()
                    .map(|field| field.name().clone())
                    .collect::<Vec<_>>(),
            );
        }
        assert_eq!(names[0], names[1], "{query}");
    }
}

fn column(values: &[f64]) -> [ArrayRef; 1] {
    [Arc::new(Float64Array::from(values.to_vec()))]
}

/// What is told of each window of so many values.
fn moved(mut moving: impl Accumulator, values: &[f64], width: usize) -> Vec<f64> {
    let answers = (0..values.len()).map(|place| {
        moving
            .update_batch(&column(&values[place..=place]))
            .unwrap();
        if let Some(gone) = place.checked_sub(width) {
            moving.retract_batch(&column(&values[gone..=gone])).unwrap();
        }
        f64::try_from(moving.evaluate().unwrap()).unwrap()
    });
    answers.collect()
}

#[test]
fn a_window_that_moves_forgets_what_has_left_it() {
    let mut values: Vec<f64> = (0..100)
        .map(|place| f64::from(place * place % 17))
        .collect();
    for (place, bad) in [
        (10, f64::NAN),
        (30, f64::INFINITY),
        (31, f64::NEG_INFINITY),
        (60, 1e300),
    ] {
        values[place] = bad;
    }
    for width in [1, 2, 5, 20] {
        let sums = moved(Moving::new(FloatSum { is_mean: false }), &values, width);
        let means = moved(Moving::new(FloatSum { is_mean: true }), &values, width);
        let spreads = moved(Moving::new(Statistic::VariancePopulation), &values, width);
        for place in 0..values.len() {
            let window = &values[(place + 1).saturating_sub(width)..=place];
            let count = window.len() as f64;
            let (sum, finite) = (
                window.iter().sum::<f64>(),
                window.iter().all(|value| *value < 1e9),
            );
            assert!(
                sums[place] == sum || sums[place].is_nan() && sum.is_nan(),
                "{width}, {place}"
            );
            if sum.is_finite() && finite {
                let mean = sum / count;
                let off = window
                    .iter()
                    .map(|value| (value - mean).powi(2))
                    .sum::<f64>()
                    / count;
                assert_eq!(means[place], mean, "{width}, {place}");
                assert!((spreads[place] - off).abs() < 1e-9, "{width}, {place}");
            }
        }
    }
}
