//! What DataFusion does not plan where it stands, as people call it. It prints its own structures.

use datafusion::common::SchemaError;

/// What no query may have where it stands, and what is written instead.
pub fn unplanned(message: &str) -> Option<(String, &'static str)> {
    let around = "expected a subquery without columns of the query around it, as this place has none for them";
    if message.contains("OuterReferenceColumn") {
        let next = match message.contains("data_type: List(") {
            true => {
                "take a list apart in a query of its table: FROM (SELECT landmark, unnest(sightings) AS s FROM landmarks)"
            }
            false => "write it as a join: the last row before a time is found by ASOF JOIN",
        };
        return Some((around.to_owned(), next));
    }
    if message.contains("logical expression WindowFunction(") {
        return Some((
            "expected no window function in GROUP BY, WHERE or a condition".to_owned(),
            "compute it in a query within: FROM (SELECT *, row_number() OVER (ORDER BY stamp) AS n FROM poses)",
        ));
    }
    if let Some(known) = subquery(message) {
        return Some(known);
    }
    if let Some((_, behind)) = message.split_once("Projections require unique expression names") {
        let name = behind.split('"').nth(1)?;
        let name = match name.rsplit_once(" AS ") {
            Some((_, alias)) if !alias.ends_with(')') => alias,
            _ => name,
        };
        return Some((
            format!("expected columns of different names, found two called {name}"),
            "name one of them with AS",
        ));
    }
    let (_, node) = message.split_once("Unsupported ast node ")?;
    let node = node.split(|c: char| !c.is_alphanumeric()).next()?;
    let next = match node {
        "Pivot" => "write a column for each value: sum(x) FILTER (WHERE class = 'car') AS car",
        "Unpivot" => "write a SELECT for each column, with UNION ALL between them",
        _ => "",
    };
    Some((format!("not supported: {}", node.to_uppercase()), next))
}

/// What a column is called that several tables have; or a subquery that DataFusion does not take apart and whose columns have
/// other names than in its table: it finds none of these then, in a place that no query says.
pub fn unfound(error: &SchemaError, has_place: bool) -> Option<(String, &'static str)> {
    match error {
        SchemaError::AmbiguousReference { field } => Some((
            format!("expected the table of {}, found it in several", field.name),
            "write its name in front, a.k; behind several USING, which are two at most of one column, that of the first table",
        )),
        SchemaError::FieldNotFound { field, .. } => {
            (field.relation.is_some() && !has_place).then(by_another)
        }
        _ => None,
    }
}

fn by_another() -> (String, &'static str) {
    (
        "expected a subquery in SELECT or WHERE that compares columns of the query around it by =, found another".to_owned(),
        "compute it in a query within, FROM (SELECT *, (SELECT …) AS x FROM …), or write it as a join",
    )
}

/// A subquery where there is none.
fn subquery(message: &str) -> Option<(String, &'static str)> {
    if message.contains("Correlated scalar subquery must be aggregated")
        || message.contains("A GROUP BY clause in a scalar correlated subquery")
    {
        return Some((
            "expected a subquery of one row for each row of the query around it, found one of any number".to_owned(),
            "take one of them, as by max(…), or write it as a join",
        ));
    }
    let others = [
        "Correlated scalar subquery can only be used in",
        "Correlated scalar subquery in the GROUP BY clause",
        "In/Exist/SetComparison subquery can only be used in",
        "logical expression ScalarSubquery(",
        "logical expression InSubquery(",
        "logical expression Exists(",
    ];
    if others.iter().any(|said| message.contains(said)) {
        return Some(by_another());
    }
    if message.contains("logical expression SetComparison(") {
        return Some((
            "expected ANY (SELECT …) or ALL (SELECT …) in WHERE, found it elsewhere".to_owned(),
            "compare with one value: x > (SELECT max(y) FROM …)",
        ));
    }
    let (_, operator) = message.split_once("Unsupported JOIN operator ")?;
    let operator = operator.split(|c: char| !c.is_alphanumeric()).next()?;
    let (name, next) = match operator {
        "CrossApply" => ("CROSS APPLY", "write CROSS JOIN LATERAL"),
        "OuterApply" => ("OUTER APPLY", "write LEFT JOIN LATERAL … ON true"),
        "CrossJoin" => ("CROSS JOIN with a condition", "write JOIN … ON"),
        "StraightJoin" => ("STRAIGHT_JOIN", "write JOIN"),
        "ArrayJoin" | "LeftArrayJoin" | "InnerArrayJoin" => {
            ("ARRAY JOIN", "take a list apart by unnest(…) in SELECT")
        }
        _ => return None,
    };
    Some((format!("not supported: {name}"), next))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn subqueries_and_joins_that_are_not_planned_are_told_in_words() {
        for (message, expected, next) in [
            (
                "Physical plan does not support logical expression InSubquery(InSubquery { expr: Column(Column { name: \"x\" }), subquery: <subquery>, negated: false })",
                "expected a subquery in SELECT or WHERE",
                "in a query within",
            ),
            (
                "Physical plan does not support logical expression ScalarSubquery(<subquery>)",
                "expected a subquery in SELECT or WHERE",
                "as a join",
            ),
            (
                "In/Exist/SetComparison subquery can only be used in Projection, Filter, TableScan, Window functions, Aggregate and Join plan nodes, but was used in [Sort: x]",
                "expected a subquery in SELECT or WHERE",
                "in a query within",
            ),
            (
                "Physical plan does not support logical expression SetComparison(SetComparison { op: Gt })",
                "expected ANY (SELECT …) or ALL (SELECT …) in WHERE",
                "max(y)",
            ),
            (
                "Correlated scalar subquery must be aggregated to return at most one row",
                "expected a subquery of one row for each row of the query around it",
                "max(…)",
            ),
            (
                "Unsupported JOIN operator CrossApply",
                "not supported: CROSS APPLY",
                "LATERAL",
            ),
        ] {
            let told = unplanned(message);
            assert!(
                told.as_ref()
                    .is_some_and(|(said, hint)| said.starts_with(expected) && hint.contains(next)),
                "{message}: {told:?}"
            );
        }
        assert_eq!(unplanned("Unsupported JOIN operator Other"), None);
    }
}
