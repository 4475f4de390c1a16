//! Joins whose columns would not be those that SQL says.
//!
//! Of the columns that USING names an answer has one, with the value of the side that has the row. DataFusion takes the left
//! one where it is named, which is null for rows of the right table alone; `*` has the one whose table comes first in the
//! alphabet, in its place, which is null in a LEFT JOIN where that is the right one. Here `*` says which columns are meant.

use std::ops::ControlFlow;

use datafusion::sql::sqlparser::ast::{
    ExcludeSelectItem, Ident, Join, JoinConstraint, JoinOperator, ObjectName, Select, SelectItem,
    SelectItemQualifiedWildcardKind, Statement, TableFactor, TableWithJoins, VisitMut, VisitorMut,
    WildcardAdditionalOptions,
};
use evermap_schemas::Fault;

use crate::sql::named::known;

/// Reads the joins of a statement as SQL means them.
///
/// # Errors
/// A user fault for a join whose columns would be null where they are not.
pub fn joined(statement: &mut Statement) -> Result<(), Fault> {
    let found = statement.visit(&mut Joined).break_value();
    found.map_or(Ok(()), Err)
}

struct Joined;

impl VisitorMut for Joined {
    type Break = Fault;

    fn pre_visit_select(&mut self, select: &mut Select) -> ControlFlow<Fault> {
        for table in &mut select.from {
            in_joins(&mut table.joins)?;
        }
        let is_plain = |item: &SelectItem| matches!(item, SelectItem::Wildcard(_));
        if !select.projection.iter().any(is_plain) || !is_reordered(&select.from) {
            return ControlFlow::Continue(());
        }
        let Some(columns) = all_columns(&select.from) else {
            return ControlFlow::Break(
                Fault::user("expected the names of columns, found * of a JOIN with USING or NATURAL whose tables cannot be told apart")
                    .next("name the columns, or give each table a name (AS) and write USING"),
            );
        };
        let items = std::mem::take(&mut select.projection);
        for item in items {
            match item {
                SelectItem::Wildcard(options) if has_options(&options) => {
                    return ControlFlow::Break(
                        Fault::user(format!("not supported: *{options} of a JOIN with USING"))
                            .next("name the columns, or write ON"),
                    );
                }
                SelectItem::Wildcard(_) => select.projection.extend(columns.iter().cloned()),
                other => select.projection.push(other),
            }
        }
        ControlFlow::Continue(())
    }

    fn pre_visit_table_factor(&mut self, factor: &mut TableFactor) -> ControlFlow<Fault> {
        match factor {
            TableFactor::NestedJoin {
                table_with_joins, ..
            } => in_joins(&mut table_with_joins.joins),
            _ => ControlFlow::Continue(()),
        }
    }
}

/// `SEMI JOIN` is `LEFT SEMI JOIN`; joins that keep rows of the right table alone name no columns by USING.
fn in_joins(joins: &mut [Join]) -> ControlFlow<Fault> {
    for join in joins {
        let nothing = JoinOperator::CrossJoin(JoinConstraint::None);
        join.join_operator = match std::mem::replace(&mut join.join_operator, nothing) {
            JoinOperator::Semi(constraint) => JoinOperator::LeftSemi(constraint),
            JoinOperator::Anti(constraint) => JoinOperator::LeftAnti(constraint),
            other => other,
        };
        let (side, constraint) = match &join.join_operator {
            JoinOperator::Right(constraint) | JoinOperator::RightOuter(constraint) => {
                ("RIGHT", constraint)
            }
            JoinOperator::FullOuter(constraint) => ("FULL", constraint),
            _ => continue,
        };
        let (said, column) = match constraint {
            JoinConstraint::Using(columns) => {
                let names: Vec<String> = columns.iter().map(ObjectName::to_string).collect();
                let column = names.first().cloned().unwrap_or_default();
                (
                    format!("{side} JOIN … USING ({})", names.join(", ")),
                    column,
                )
            }
            JoinConstraint::Natural => (format!("NATURAL {side} JOIN"), "key".to_owned()),
            _ => continue,
        };
        let next = match side {
            "RIGHT" => "write b LEFT JOIN a USING (…), or ON".to_owned(),
            _ => format!(
                "write ON a.{column} = b.{column}, and coalesce(a.{column}, b.{column}) AS {column}"
            ),
        };
        return ControlFlow::Break(Fault::user(format!("not supported: {said}")).next(next));
    }
    ControlFlow::Continue(())
}

/// Whether `*` would have a column of a right table in the place of a left one.
fn is_reordered(from: &[TableWithJoins]) -> bool {
    let has_using = |join: &Join| match &join.join_operator {
        JoinOperator::Join(constraint)
        | JoinOperator::Inner(constraint)
        | JoinOperator::Left(constraint)
        | JoinOperator::LeftOuter(constraint) => matches!(
            constraint,
            JoinConstraint::Using(_) | JoinConstraint::Natural
        ),
        _ => false,
    };
    let is_mixed = |table: &TableWithJoins| {
        let right = table.joins.iter().map(|join| &join.relation);
        let names: Option<Vec<_>> = std::iter::once(&table.relation)
            .chain(right)
            .map(|relation| name(relation).map(|name| place(&name)))
            .collect();
        table.joins.iter().any(has_using) && !names.is_some_and(|names| names.is_sorted())
    };
    let is_within = |relation: &TableFactor| match relation {
        TableFactor::NestedJoin {
            table_with_joins,
            alias: None,
        } => is_reordered(std::slice::from_ref(table_with_joins.as_ref())),
        _ => false,
    };
    from.iter().any(|table| {
        let mut right = table.joins.iter();
        is_mixed(table) || is_within(&table.relation) || right.any(|join| is_within(&join.relation))
    })
}

/// Where a table comes among others, as DataFusion sorts them.
fn place(name: &ObjectName) -> (usize, Vec<String>) {
    let parts = name.0.iter().filter_map(|part| part.as_ident());
    (name.0.len(), parts.map(known).collect())
}

/// The columns that `*` stands for; `None` where they cannot be said.
fn all_columns(from: &[TableWithJoins]) -> Option<Vec<SelectItem>> {
    let mut columns = Vec::new();
    for table in from {
        columns.push(columns_of(name(&table.relation)?, &[]));
        for join in &table.joins {
            let constraint = match &join.join_operator {
                JoinOperator::LeftSemi(_) | JoinOperator::LeftAnti(_) => continue,
                JoinOperator::Join(constraint)
                | JoinOperator::Inner(constraint)
                | JoinOperator::Left(constraint)
                | JoinOperator::LeftOuter(constraint)
                | JoinOperator::Right(constraint)
                | JoinOperator::RightOuter(constraint)
                | JoinOperator::FullOuter(constraint)
                | JoinOperator::CrossJoin(constraint)
                | JoinOperator::AsOf { constraint, .. } => constraint,
                _ => return None,
            };
            let named_before = match constraint {
                JoinConstraint::Using(columns) => columns.as_slice(),
                JoinConstraint::Natural => return None,
                _ => &[],
            };
            columns.push(columns_of(name(&join.relation)?, named_before));
        }
    }
    Some(columns)
}

/// The columns of a table but for those that are there before.
fn columns_of(table: ObjectName, but: &[ObjectName]) -> SelectItem {
    let but = but.iter().filter_map(|column| column.0.last()?.as_ident());
    // DataFusion takes these names as they are.
    let but = but.map(|column| ObjectName::from(vec![Ident::with_quote('"', known(column))]));
    let but: Vec<ObjectName> = but.collect();
    let options = WildcardAdditionalOptions {
        opt_exclude: (!but.is_empty()).then_some(ExcludeSelectItem::Multiple(but)),
        ..WildcardAdditionalOptions::default()
    };
    let table = SelectItemQualifiedWildcardKind::ObjectName(table);
    SelectItem::QualifiedWildcard(table, options)
}

fn has_options(options: &WildcardAdditionalOptions) -> bool {
    options.opt_ilike.is_some()
        || options.opt_exclude.is_some()
        || options.opt_except.is_some()
        || options.opt_replace.is_some()
        || options.opt_rename.is_some()
        || options.opt_alias.is_some()
}

/// What a table is called in a query.
fn name(table: &TableFactor) -> Option<ObjectName> {
    match table {
        TableFactor::Table {
            alias: Some(alias), ..
        }
        | TableFactor::Derived {
            alias: Some(alias), ..
        } => Some(ObjectName::from(vec![alias.name.clone()])),
        TableFactor::Table {
            name, args: None, ..
        } => Some(name.clone()),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use arrow::util::display::array_value_to_string;

    use crate::error::OrFault;
    use crate::sql::{Limits, context, read_only};

    /// `a` and `z` both have the key 2.
    const TABLES: &str =
        "WITH a (g, v) AS (VALUES (2, 20), (3, 30)), z (g, w) AS (VALUES (1, 10), (2, 22))";

    /// The columns of a query, and its rows as texts, ascending.
    async fn asked(query: &str) -> (String, String) {
        let context = context(Limits::one_partition()).unwrap();
        let frame = read_only(&context, &format!("{TABLES} {query}")).await;
        assert!(frame.is_ok(), "{query}: {:?}", frame.err());
        let frame = frame.unwrap();
        let names: Vec<String> = frame
            .schema()
            .fields()
            .iter()
            .map(|f| f.name().clone())
            .collect();
        let mut rows = Vec::new();
        for batch in frame.collect().await.unwrap() {
            for row in 0..batch.num_rows() {
                let columns = batch.columns().iter();
                let values = columns.map(|column| array_value_to_string(column, row).unwrap());
                rows.push(values.collect::<Vec<_>>().join(","));
            }
        }
        rows.sort();
        (names.join(","), rows.join(" "))
    }

    #[tokio::test]
    async fn columns_that_using_names_have_the_value_of_the_side_that_has_the_row() {
        for (query, names, rows) in [
            (
                "SELECT * FROM z LEFT JOIN a USING (g)",
                "g,w,v",
                "1,10, 2,22,20",
            ),
            (
                "SELECT * FROM z LEFT JOIN a USING (G)",
                "g,w,v",
                "1,10, 2,22,20",
            ),
            ("SELECT g, v FROM z LEFT JOIN a USING (g)", "g,v", "1, 2,20"),
            (
                "SELECT *, 1 AS n FROM z LEFT JOIN a USING (g) WHERE a.g IS NULL",
                "g,w,v,n",
                "1,10,,1",
            ),
            (
                "SELECT * FROM a LEFT JOIN z USING (g)",
                "g,v,w",
                "2,20,22 3,30,",
            ),
            ("SELECT * FROM a JOIN z USING (g)", "g,v,w", "2,20,22"),
            ("SELECT * FROM z JOIN a USING (g)", "g,w,v", "2,22,20"),
            (
                "SELECT * FROM z LEFT JOIN a USING (g) LEFT JOIN (VALUES (1, 5)) AS b (g, u) USING (g)",
                "g,w,v,u",
                "1,10,,5 2,22,20,",
            ),
            ("SELECT * FROM z SEMI JOIN a ON z.g = a.g", "g,w", "2,22"),
            ("SELECT * FROM z ANTI JOIN a ON z.g = a.g", "g,w", "1,10"),
            (
                "SELECT coalesce(a.g, z.g) AS g, v, w FROM a FULL JOIN z ON a.g = z.g",
                "g,v,w",
                "1,,10 2,20,22 3,30,",
            ),
        ] {
            let found = asked(query).await;
            assert_eq!(found, (names.to_owned(), rows.to_owned()), "{query}");
        }
    }

    #[tokio::test]
    async fn what_is_written_for_columns_that_several_tables_have_is_told() {
        let context = context(Limits::one_partition()).unwrap();
        let chain = "FROM a JOIN z USING (g) JOIN (VALUES (2, 5)) AS b (g, u) USING (g)";
        let query = format!("{TABLES} SELECT g {chain}");
        let fault = read_only(&context, &query).await.err().unwrap().to_string();
        let said = "user: expected the table of g, found it in several (at line 1, column ";
        assert!(fault.contains(said), "{fault}");
        assert!(
            fault.contains("; write its name in front, a.k; behind several USING"),
            "{fault}"
        );
        let found = asked(&format!("SELECT a.g, u {chain}")).await;
        assert_eq!(found, ("g,u".to_owned(), "2,5".to_owned()));
        // Columns of the subquery have other names than in its table.
        let query = "SELECT v, (SELECT count(*) FROM z WHERE z.w > a.v) FROM a";
        let frame = read_only(&context, &format!("{TABLES} {query}")).await;
        let fault = frame.unwrap().create_physical_plan().await.or_fault();
        let fault = fault.err().unwrap().to_string();
        assert!(
            fault.contains("that compares columns of the query around it by =, found another"),
            "{fault}"
        );
    }

    #[tokio::test]
    async fn columns_that_would_be_null_are_refused() {
        let context = context(Limits::one_partition()).unwrap();
        for (query, said) in [
            (
                "SELECT g FROM a RIGHT JOIN z USING (g)",
                "user: not supported: RIGHT JOIN … USING (g); write b LEFT JOIN a USING (…), or ON",
            ),
            (
                "SELECT g FROM a FULL OUTER JOIN z USING (g)",
                "FULL JOIN … USING (g); write ON a.g = b.g, and coalesce(a.g, b.g) AS g",
            ),
            (
                "SELECT 1 FROM (a NATURAL RIGHT JOIN z)",
                "not supported: NATURAL RIGHT JOIN",
            ),
            (
                "SELECT 1 WHERE EXISTS (SELECT g FROM a NATURAL FULL JOIN z)",
                "not supported: NATURAL FULL JOIN",
            ),
            (
                "SELECT * FROM z NATURAL LEFT JOIN a",
                "found * of a JOIN with USING or NATURAL",
            ),
            (
                "SELECT * FROM (z LEFT JOIN a USING (g)) JOIN z AS y ON y.g = z.g",
                "found * of a JOIN with USING or NATURAL",
            ),
            (
                "SELECT * EXCLUDE (v) FROM z LEFT JOIN a USING (g)",
                "of a JOIN with USING; name the columns, or write ON",
            ),
        ] {
            let fault = read_only(&context, &format!("{TABLES} {query}")).await;
            let fault = fault.err().unwrap().to_string();
            assert!(fault.contains(said), "{query}: {fault}");
        }
    }
}
