//! What programs ask of Postgres' own tables, and a map has none of: keys, indexes, memberships, access lists.
//!
//! Drivers and psql ask for them all the same, in ways that the planner does not know. Of such tables alone an answer
//! without rows is true, and keeps the program going; a query of a layer is never answered so.

use std::ops::ControlFlow;
use std::sync::Arc;

use arrow::datatypes::{DataType, Field};
use datafusion::common::{DFSchema, TableReference};
use datafusion::logical_expr::{EmptyRelation, LogicalPlan};
use datafusion::sql::parser::Statement as Parsed;
use datafusion::sql::resolve::resolve_table_references;
use datafusion::sql::sqlparser::ast::{
    ArrayElemTypeDef, CastKind, DataType as SqlType, Expr, FunctionArguments, Query, SelectItem,
    SetExpr, Statement, Value, visit_expressions_mut,
};

/// Schemas of Postgres' own.
const OWN: [&str; 2] = ["pg_catalog", "information_schema"];

/// Whether a statement reads tables, and Postgres' own alone.
pub fn is_of_catalog(statement: &Statement) -> bool {
    let parsed = Parsed::Statement(Box::new(statement.clone()));
    let Ok((tables, _)) = resolve_table_references(&parsed, true) else {
        return false;
    };
    let own = |table: &TableReference| match table.schema() {
        Some(schema) => OWN.contains(&schema),
        None => table.table().starts_with("pg_"),
    };
    !tables.is_empty() && tables.iter().all(own)
}

/// The statement with lists of what a map has none of, `ARRAY(SELECT …)`, as null.
pub fn without_lists(mut statement: Statement) -> Statement {
    let _ = visit_expressions_mut(&mut statement, |found| {
        if let Expr::Function(call) = found
            && matches!(call.args, FunctionArguments::Subquery(_))
            && call.name.to_string().eq_ignore_ascii_case("array")
        {
            *found = no_list();
        }
        ControlFlow::<()>::Continue(())
    });
    statement
}

/// `NULL::text[]`.
fn no_list() -> Expr {
    let texts = ArrayElemTypeDef::SquareBracket(Box::new(SqlType::Text), None);
    Expr::Cast {
        kind: CastKind::DoubleColon,
        expr: Box::new(Expr::Value(Value::Null.into())),
        data_type: SqlType::Array(texts),
        array: false,
        format: None,
    }
}

/// No rows, with the columns that a query names; none where it names not each.
pub fn no_rows(statement: &Statement) -> Option<LogicalPlan> {
    let Statement::Query(query) = statement else {
        return None;
    };
    let names = names(query)?.into_iter().enumerate();
    // Postgres lets columns have one name: here each has a table of its own.
    let fields = names.map(|(number, name)| {
        let table = TableReference::bare(number.to_string());
        (
            Some(table),
            Arc::new(Field::new(name, DataType::Utf8, true)),
        )
    });
    let schema = DFSchema::new_with_metadata(fields.collect(), Default::default()).ok()?;
    Some(LogicalPlan::EmptyRelation(EmptyRelation {
        produce_one_row: false,
        schema: Arc::new(schema),
    }))
}

fn names(query: &Query) -> Option<Vec<String>> {
    let mut body = query.body.as_ref();
    while let SetExpr::SetOperation { left, .. } = body {
        body = left;
    }
    match body {
        SetExpr::Query(query) => names(query),
        SetExpr::Select(select) => select.projection.iter().map(name).collect(),
        _ => None,
    }
}

fn name(item: &SelectItem) -> Option<String> {
    match item {
        SelectItem::ExprWithAlias { alias, .. } => Some(alias.value.clone()),
        SelectItem::UnnamedExpr(Expr::Identifier(name)) => Some(name.value.clone()),
        SelectItem::UnnamedExpr(Expr::CompoundIdentifier(parts)) => {
            Some(parts.last()?.value.clone())
        }
        SelectItem::UnnamedExpr(_) => Some("?column?".to_owned()),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use datafusion::sql::sqlparser::dialect::PostgreSqlDialect;
    use datafusion::sql::sqlparser::parser::Parser;

    fn parsed(text: &str) -> Statement {
        Parser::parse_sql(&PostgreSqlDialect {}, text)
            .unwrap()
            .remove(0)
    }

    #[test]
    fn only_what_asks_for_postgres_own_tables_alone_is_of_the_catalog() {
        for (text, expected) in [
            ("SELECT 1 FROM pg_catalog.pg_class", true),
            (
                "SELECT 1 FROM pg_index i JOIN information_schema.tables t ON true",
                true,
            ),
            ("WITH x AS (SELECT 1 FROM pg_class) SELECT * FROM x", true),
            ("SELECT 1 FROM lanes", false),
            ("SELECT 1 FROM pg_class, lanes", false),
            (
                "SELECT (SELECT max(x) FROM landmarks) FROM pg_catalog.pg_class",
                false,
            ),
            ("SELECT 1", false),
        ] {
            assert_eq!(is_of_catalog(&parsed(text)), expected, "{text}");
        }
    }

    #[test]
    fn lists_of_what_is_not_there_are_null_and_columns_keep_their_names() {
        let query = parsed(
            "SELECT r.rolname, ARRAY(SELECT 1 FROM pg_roles b) AS memberof, NULL, NULL, f(1) FROM pg_roles r",
        );
        let without = without_lists(query.clone()).to_string();
        assert!(without.contains("NULL::TEXT[] AS memberof"), "{without}");
        let plan = no_rows(&query).unwrap();
        let names: Vec<_> = plan
            .schema()
            .fields()
            .iter()
            .map(|field| field.name().as_str())
            .collect();
        assert_eq!(
            names,
            ["rolname", "memberof", "?column?", "?column?", "?column?"]
        );
        assert!(no_rows(&parsed("SELECT * FROM pg_roles")).is_none());
    }
}
