//! Columns of an answer that would have one name: `SELECT stamp, CAST(stamp AS DATE)`. Others call both `stamp`, and
//! DataFusion refuses them, as a cast has the name of what it casts. Here the later ones are `stamp_1`, `stamp_2` ….

use std::collections::HashSet;
use std::convert::Infallible;
use std::ops::ControlFlow;

use datafusion::sql::sqlparser::ast::{
    Expr, Ident, Select, SelectItem, Statement, VisitMut, VisitorMut,
};

/// Names the columns of a statement's queries apart. What has a name of its own keeps it.
pub fn named_apart(statement: &mut Statement) {
    let ControlFlow::Continue(()) = statement.visit(&mut Apart);
}

struct Apart;

impl VisitorMut for Apart {
    type Break = Infallible;

    fn pre_visit_select(&mut self, select: &mut Select) -> ControlFlow<Infallible> {
        if select.projection.len() > 1 {
            apart(&mut select.projection);
        }
        ControlFlow::Continue(())
    }
}

fn apart(items: &mut [SelectItem]) {
    let mut taken: HashSet<String> = items.iter().filter_map(name).collect();
    let mut seen = HashSet::new();
    for item in items {
        let SelectItem::UnnamedExpr(expr) = item else {
            continue;
        };
        if seen.insert(path(expr).join(".")) {
            continue;
        }
        let called = last(expr);
        let mut free = (1_usize..).map(|number| format!("{called}_{number}"));
        if let Some(alias) = free.find(|alias| !taken.contains(alias)) {
            taken.insert(alias.clone());
            *item = SelectItem::ExprWithAlias {
                expr: expr.clone(),
                alias: Ident::with_quote('"', alias),
            };
        }
    }
}

/// What a column is called.
fn name(item: &SelectItem) -> Option<String> {
    match item {
        SelectItem::UnnamedExpr(expr) => Some(last(expr)),
        SelectItem::ExprWithAlias { alias, .. } => Some(known(alias)),
        _ => None,
    }
}

/// What a cast, or an expression in parentheses, has its name from.
fn named(expr: &Expr) -> &Expr {
    match expr {
        Expr::Cast { expr, .. } | Expr::Nested(expr) => named(expr),
        other => other,
    }
}

/// What tells a column from another: all parts of its name, or the expression as it is written.
fn path(expr: &Expr) -> Vec<String> {
    match named(expr) {
        Expr::Identifier(name) => vec![known(name)],
        Expr::CompoundIdentifier(names) => names.iter().map(known).collect(),
        other => vec![other.to_string()],
    }
}

/// The last part of a column's name.
fn last(expr: &Expr) -> String {
    path(expr).pop().unwrap_or_default()
}

/// A name as it is looked up: in small letters, unless it stands in quotes.
pub fn known(name: &Ident) -> String {
    match name.quote_style {
        Some(_) => name.value.clone(),
        None => name.value.to_lowercase(),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use crate::sql::{Limits, context, read_only};

    #[tokio::test]
    async fn columns_of_one_name_are_told_apart() {
        let context = context(Limits::one_partition()).unwrap();
        let cases: [(&str, &[&str]); 7] = [
            ("x, x::INT", &["x", "x_1"]),
            (
                "x, CAST(X AS DOUBLE), (x), 2 AS x_1",
                &["x", "x_2", "x_3", "x_1"],
            ),
            ("t.x, CAST(t.x AS INT) FROM t ORDER BY x", &["x", "x_1"]),
            ("count(*), count(*)", &["count(*)", "count(*)_1"]),
            ("a.x, b.x FROM t AS a, t AS b", &["x", "x"]),
            (
                "n.x, n.x_1 FROM (SELECT x, x::INT FROM t) AS n",
                &["x", "x_1"],
            ),
            // DataFusion names a cast by what it casts, with its table.
            ("CAST(x AS INT), x + 1 AS y", &["t.x", "y"]),
        ];
        for (columns, expected) in cases {
            let from = if columns.contains("FROM") {
                ""
            } else {
                "FROM t"
            };
            let query = format!("WITH t AS (SELECT 7 AS x) SELECT {columns} {from}");
            let frame = read_only(&context, &query).await.unwrap();
            let names: Vec<String> = frame
                .schema()
                .fields()
                .iter()
                .map(|f| f.name().clone())
                .collect();
            assert_eq!(names, expected, "{query}");
            let rows = frame.collect().await.unwrap();
            assert_eq!(rows[0].num_rows(), 1, "{query}");
        }
        let frame = read_only(&context, "SELECT 1, 1").await.unwrap();
        assert_eq!(frame.schema().fields()[1].name(), "1_1");
        let said = read_only(&context, "SELECT 1 AS a, 2 AS a").await;
        let said = said.err().unwrap().to_string();
        assert!(
            said.contains("two called a; name one of them with AS"),
            "{said}"
        );
    }
}
