//! Columns of an answer that would have one name: `SELECT stamp, CAST(stamp AS DATE)`. Others call both `stamp`, and
//! DataFusion refuses them, as a cast has the name of what it casts. Here the later ones are `stamp_1`, `stamp_2` …. So are
//! casts of what rows are ordered by, `SELECT CAST(stamp AS DATE) … ORDER BY stamp`: DataFusion has the column itself beside
//! them until rows are in order. Where rows are distinct, they are ordered by columns of the answer alone: a cast among these is
//! said by its place, as DataFusion finds it by nothing else.
//!
//! What is one name to DataFusion may be written in several ways: `sum(X)` and `SUM(x)`, `x + 1` and `(x)::INT + 1`, and `x`
//! and `t.x` where there is no table but `t`.

use std::collections::HashSet;
use std::convert::Infallible;
use std::ops::ControlFlow;

use datafusion::sql::sqlparser::ast::{
    Distinct, Expr, Ident, ObjectNamePart, OrderByKind, Query, Select, SelectItem, SetExpr,
    Statement, TableFactor, Value, VisitMut, VisitorMut, visit_expressions, visit_expressions_mut,
};

/// Names the columns of a statement's queries apart. What has a name of its own keeps it.
pub fn named_apart(statement: &mut Statement) {
    let ControlFlow::Continue(()) = statement.visit(&mut Apart);
}

struct Apart;

impl VisitorMut for Apart {
    type Break = Infallible;

    fn pre_visit_query(&mut self, query: &mut Query) -> ControlFlow<Infallible> {
        if let (SetExpr::Select(select), Some(order)) = (query.body.as_mut(), &mut query.order_by)
            && let OrderByKind::Expressions(order) = &mut order.kind
        {
            if matches!(select.distinct, Some(Distinct::Distinct)) {
                for by in order.iter_mut() {
                    if let Some(place) = place_of_cast(&by.expr, &select.projection) {
                        by.expr = Expr::Value(Value::Number(place.to_string(), false).into());
                    }
                }
            }
            let by = order.iter().map(|by| &by.expr);
            let by = ordered_by(by, &select.projection);
            let table = only_table(select);
            apart(&mut select.projection, &by, table.as_deref());
        }
        ControlFlow::Continue(())
    }

    fn pre_visit_select(&mut self, select: &mut Select) -> ControlFlow<Infallible> {
        if select.projection.len() > 1 {
            let table = only_table(select);
            apart(&mut select.projection, &[], table.as_deref());
        }
        ControlFlow::Continue(())
    }
}

/// What rows are ordered by, columns and what functions make of them, but for values that are columns of the answer.
fn ordered_by<'e>(by: impl Iterator<Item = &'e Expr>, items: &[SelectItem]) -> Vec<Vec<String>> {
    let is_item = |by: &Expr| {
        let mut items = items.iter();
        items.any(|item| matches!(item, SelectItem::UnnamedExpr(expr) if expr == by))
    };
    let mut ordered = Vec::new();
    for by in by.filter(|by| !is_item(by)) {
        let _ = visit_expressions(by, |found| {
            if let Expr::Identifier(_) | Expr::CompoundIdentifier(_) | Expr::Function(_) = found {
                ordered.push(path(found));
            }
            ControlFlow::<()>::Continue(())
        });
    }
    ordered
}

/// The place in an answer, from 1 on, of the cast that rows are ordered by: as it is written, or by the name that it has from
/// what it casts. `None` where there is none, or others of that name.
fn place_of_cast(by: &Expr, items: &[SelectItem]) -> Option<usize> {
    let called = match by {
        Expr::Identifier(name) => Some(known(name)),
        _ => None,
    };
    let is_meant = |item: &SelectItem| match item {
        SelectItem::UnnamedExpr(expr) if expr == by => true,
        // Of what a table has nobody knows how many there are.
        item => name(item).is_none_or(|name| called.as_ref() == Some(&name)),
    };
    let mut meant = items.iter().enumerate().filter(|(_, item)| is_meant(item));
    match (meant.next()?, meant.next()) {
        ((place, SelectItem::UnnamedExpr(expr)), None) => is_cast(expr).then_some(place + 1),
        _ => None,
    }
}

/// Whether it is a cast of one of these, which may be named with their table or without.
fn casts_one(expr: &Expr, ordered: &[Vec<String>]) -> bool {
    let cast = path(expr);
    let mut ordered = ordered.iter();
    is_cast(expr) && ordered.any(|by| by.ends_with(&cast) || cast.ends_with(by))
}

fn is_cast(expr: &Expr) -> bool {
    match expr {
        Expr::Nested(expr) => is_cast(expr),
        other => matches!(other, Expr::Cast { .. }),
    }
}

/// What the table of a query is called that has one.
fn only_table(select: &Select) -> Option<String> {
    let [table] = select.from.as_slice() else {
        return None;
    };
    match &table.relation {
        _ if !table.joins.is_empty() => None,
        TableFactor::Table {
            alias: Some(alias), ..
        }
        | TableFactor::Derived {
            alias: Some(alias), ..
        } => Some(known(&alias.name)),
        TableFactor::Table { name, .. } => name.0.last()?.as_ident().map(known),
        _ => None,
    }
}

/// An expression as DataFusion names it: what is one name there is one text here.
fn key(expr: &Expr, table: Option<&str>) -> String {
    let mut expr = expr.clone();
    let _ = visit_expressions_mut(&mut expr, |part| {
        while let Expr::Nested(inner) | Expr::Cast { expr: inner, .. } = part {
            let inner = std::mem::replace(inner.as_mut(), Expr::Value(Value::Null.into()));
            *part = inner;
        }
        let one_name = match part {
            Expr::Identifier(name) => Some(known(name)),
            Expr::CompoundIdentifier(names) => {
                let is_table = |name: &Ident| table == Some(known(name).as_str());
                if names.len() > 1 && names.first().is_some_and(is_table) {
                    names.remove(0);
                }
                names.iter_mut().for_each(quote);
                match names.as_slice() {
                    [name] => Some(name.value.clone()),
                    _ => None,
                }
            }
            Expr::Function(call) => {
                call.name.0.iter_mut().for_each(|part| {
                    if let ObjectNamePart::Identifier(name) = part {
                        quote(name);
                    }
                });
                None
            }
            Expr::Exists { negated, .. } => Some(format!("EXISTS {negated}")),
            Expr::InSubquery { negated, .. } => Some(format!("IN {negated}")),
            Expr::Subquery(query) => match query.body.as_ref() {
                SetExpr::Select(select) => select.projection.first().and_then(name),
                _ => None,
            },
            _ => None,
        };
        if let Some(name) = one_name {
            *part = Expr::Identifier(Ident::with_quote('"', name));
        }
        ControlFlow::<()>::Continue(())
    });
    expr.to_string()
}

/// Writes a name as it is looked up.
fn quote(name: &mut Ident) {
    *name = Ident::with_quote('"', known(name));
}

/// Names items apart, and casts of what rows are ordered by.
fn apart(items: &mut [SelectItem], ordered: &[Vec<String>], table: Option<&str>) {
    let mut taken: HashSet<String> = items.iter().filter_map(name).collect();
    taken.extend(ordered.iter().filter_map(|column| column.last().cloned()));
    let mut seen = HashSet::new();
    for item in items {
        let SelectItem::UnnamedExpr(expr) = item else {
            continue;
        };
        if !casts_one(expr, ordered) && seen.insert(key(expr, table)) {
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
        let cases: [(&str, &[&str]); 26] = [
            ("x, x::INT", &["x", "x_1"]),
            (
                "x, CAST(X AS DOUBLE), (x), 2 AS x_1",
                &["x", "x_2", "x_3", "x_1"],
            ),
            ("t.x, CAST(t.x AS INT) FROM t ORDER BY x", &["x", "x_1"]),
            ("count(*), count(*)", &["count(*)", "count(*)_1"]),
            ("count(*), COUNT(*)", &["count(*)", "COUNT(*)_1"]),
            (
                "x IN (SELECT 7), x IN (SELECT 8)",
                &["IN", "x IN (SELECT 8)_1"],
            ),
            (
                "(SELECT 1 AS k), (SELECT 2 AS K)",
                &["k", "(SELECT 2 AS K)_1"],
            ),
            ("max(X), MAX(x) FROM t", &["max(t.x)", "MAX(x)_1"]),
            ("x, t.x", &["x", "x_1"]),
            (
                "x + 1, (t.x)::INT + 1",
                &["t.x + Int64(1)", "(t.x)::INT + 1_1"],
            ),
            (
                "rank() OVER (ORDER BY x) AS r, a.x + 1 AS s, x FROM t AS a",
                &["r", "s", "x"],
            ),
            ("'a', 'A'", &["Utf8(\"a\")", "Utf8(\"A\")"]),
            (
                "a.x + 1, b.x + 1 FROM t AS a, t AS b",
                &["a.x + Int64(1)", "b.x + Int64(1)"],
            ),
            ("a.x, b.x FROM t AS a, t AS b", &["x", "x"]),
            (
                "n.x, n.x_1 FROM (SELECT x, x::INT FROM t) AS n",
                &["x", "x_1"],
            ),
            // DataFusion names a cast by what it casts, with its table.
            ("CAST(x AS INT), x + 1 AS y", &["t.x", "y"]),
            ("x::TEXT FROM t ORDER BY x LIMIT 1", &["x_1"]),
            ("(t.x::TEXT), x FROM t ORDER BY x + 1", &["x_1", "x"]),
            ("x::TEXT FROM t GROUP BY x ORDER BY t.x", &["x_1"]),
            ("max(x)::TEXT FROM t ORDER BY max(x)", &["max(x)_1"]),
            // What is in order anyway has the name that it has elsewhere.
            ("x::TEXT FROM t ORDER BY x::TEXT", &["t.x"]),
            ("x::TEXT FROM t ORDER BY 1", &["t.x"]),
            ("(x) FROM t ORDER BY x", &["x"]),
            ("DISTINCT x::TEXT FROM t ORDER BY x", &["t.x"]),
            ("DISTINCT x::TEXT FROM t ORDER BY x::TEXT DESC", &["t.x"]),
            (
                "DISTINCT x + 1 AS y, (t.x::TEXT) FROM t ORDER BY X, y",
                &["y", "t.x"],
            ),
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
        // By the column, and not by what is made of it.
        let query = "SELECT x::TEXT FROM (VALUES (9), (10)) AS t(x) ORDER BY x";
        let frame = read_only(&context, query).await.unwrap();
        let rows = frame.collect().await.unwrap();
        let first = arrow::util::display::array_value_to_string(rows[0].column(0), 0).unwrap();
        assert_eq!(first, "9");
        // Distinct ones by what is in the answer.
        let query = "SELECT DISTINCT x::TEXT FROM (VALUES (9), (10)) AS t(x) ORDER BY x";
        let frame = read_only(&context, query).await.unwrap();
        let rows = frame.collect().await.unwrap();
        let first = arrow::util::display::array_value_to_string(rows[0].column(0), 0).unwrap();
        assert_eq!(first, "10");
        let other = "SELECT DISTINCT x::TEXT FROM (VALUES (9), (10)) AS t(x) ORDER BY t.x";
        assert!(read_only(&context, other).await.is_err());
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
