//! What programs ask of Postgres' own tables, and a map has none of: constraints, memberships, access lists.
//!
//! Drivers and psql ask for them all the same, in ways that the planner does not know. Of such tables alone an answer
//! without rows is true, and keeps the program going; a query of a layer is never answered so.

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::sync::Arc;

use arrow::datatypes::{DataType, Field};
use datafusion::common::{DFSchema, ScalarValue, TableReference};
use datafusion::logical_expr::{EmptyRelation, LogicalPlan};
use datafusion::prelude::SessionContext;
use datafusion::sql::parser::Statement as Parsed;
use datafusion::sql::resolve::resolve_table_references;
use datafusion::sql::sqlparser::ast::{
    AccessExpr, ArrayElemTypeDef, BinaryOperator, CastKind, DataType as SqlType, Expr, Function,
    FunctionArguments, ObjectName, Query, SelectItem, SetExpr, Statement, Value, ValueWithSpan,
    visit_expressions, visit_expressions_mut, visit_relations,
};
use datafusion_postgres::datafusion_pg_catalog::pg_catalog::create_pg_table_is_visible;

use crate::serve::postgres::expression::expression;
use crate::serve::postgres::functions::constant;
use crate::serve::postgres::keys::of_key;

/// Schemas of Postgres' own.
const OWN: [&str; 2] = ["pg_catalog", "information_schema"];

/// Those of its tables that have rows of a map: an answer without rows is no answer to what reads them alone.
const FILLED: [&str; 13] = [
    "generate_series",
    "columns",
    "key_column_usage",
    "pg_am",
    "pg_attribute",
    "pg_class",
    "pg_database",
    "pg_index",
    "pg_namespace",
    "pg_tables",
    "table_constraints",
    "tables",
    "unnest",
];

/// Those of them that have no rows of anything that a client asks for by the rows of others.
const EMPTY: [&str; 3] = ["pg_attrdef", "pg_collation", "pg_sequence"];

/// Those with the keys of layers: who asks for these and is not understood is told so, and not that there are none.
const OF_KEYS: [&str; 2] = ["pg_constraint", "pg_index"];

/// Columns of Postgres' tables that the library leaves out: lists of options and of rights, of which a map has none.
const LISTS: [&str; 5] = ["datacl", "nspacl", "relacl", "reloptions", "typacl"];

/// Columns with the numbers of the columns of a key, of which clients ask for one by its place: counted from 0, as lists here are
/// not.
const KEYS: [&str; 3] = ["confkey", "conkey", "indkey"];

/// Functions of Postgres on what a map has none of: their answer is null.
const OF_NOTHING: [&str; 17] = [
    "col_description",
    "json_build_object",
    "obj_description",
    "pg_advisory_unlock_all",
    "pg_database_size",
    "pg_get_function_arguments",
    "pg_get_function_identity_arguments",
    "pg_get_function_result",
    "pg_get_indexdef",
    "pg_get_serial_sequence",
    "pg_get_viewdef",
    "pg_size_pretty",
    "pg_table_size",
    "pg_tablespace_location",
    "pg_total_relation_size",
    "shobj_description",
    "to_regclass",
];

/// Names that clients have for one function, or that the library has no function for.
pub fn complete_catalog(context: &SessionContext) {
    let visible = [
        "pg_collation_is_visible",
        "pg_function_is_visible",
        "pg_type_is_visible",
    ];
    context.register_udf(create_pg_table_is_visible().with_aliases(visible));
    for name in OF_NOTHING {
        context.register_udf(constant(name, ScalarValue::Utf8(None)));
    }
}

/// The tables of a statement where they are all of Postgres' own; none for any other.
fn tables(statement: &Statement) -> Vec<TableReference> {
    let parsed = Parsed::Statement(Box::new(statement.clone()));
    let own = |table: &TableReference| match table.schema() {
        Some(schema) => OWN.contains(&schema),
        // Functions that make rows are tables in the grammar.
        None => {
            table.table().starts_with("pg_")
                || ["generate_series", "unnest"].contains(&table.table())
        }
    };
    match resolve_table_references(&parsed, true) {
        Ok((tables, _)) if tables.iter().all(own) => tables,
        _ => Vec::new(),
    }
}

/// Whether a statement reads tables, and Postgres' own alone.
pub fn is_of_catalog(statement: &Statement) -> bool {
    !tables(statement).is_empty()
}

/// The statement in words that the library's tables have: lists of what a map has none of are null (`ARRAY(SELECT …)`, columns
/// of options and rights), names of functions and types that are looked up are without a schema.
pub fn in_its_words(mut statement: Statement) -> Statement {
    if let Statement::Query(query) = &mut statement
        && let SetExpr::Select(select) = query.body.as_mut()
    {
        select.projection.iter_mut().for_each(counted);
    }
    let _ = visit_expressions_mut(&mut statement, |found| {
        if is_list(found) {
            *found = no_list();
        }
        match &mut *found {
            Expr::Function(call) => {
                if let Some(same) = of_key(call).or_else(|| of_none(call)) {
                    *found = same;
                }
            }
            key if is_of_key(key) => *key = null(SqlType::Int(None)),
            Expr::InList { expr, list, .. } if is_path(expr, list) => {
                list[0] = Expr::Value(Value::SingleQuotedString(PATH.to_owned()).into());
            }
            Expr::Subquery(query) if is_of_nothing(query) => *found = nothing_of(query),
            Expr::Subquery(query) => of_one_row(query),
            Expr::Like {
                pattern,
                escape_char,
                ..
            }
            | Expr::ILike {
                pattern,
                escape_char,
                ..
            } => by_backslash(pattern, escape_char),
            _ => {}
        }
        if let Expr::BinaryOp { left, right, .. } = found
            && is_name(left)
            && let Expr::Value(value) = right.as_mut()
            && let Value::SingleQuotedString(name) = &mut value.value
            && let Some(bare) = name.strip_prefix("pg_catalog.")
        {
            *name = bare.to_owned();
        }
        if let Expr::BinaryOp { left, right, .. } = found
            && last_name(left).starts_with("indis")
            && let Expr::Value(value) = right.as_mut()
            && let Value::SingleQuotedString(text) = &value.value
            && ["t", "f"].contains(&text.as_str())
        {
            value.value = Value::Boolean(text == "t");
        }
        ControlFlow::<()>::Continue(())
    });
    statement
}

/// Whether a query of one value has none, as what it reads has no rows.
fn is_of_nothing(query: &Query) -> bool {
    let is_counted = match query.body.as_ref() {
        SetExpr::Select(select) => select.projection.iter().any(|item| match item {
            SelectItem::UnnamedExpr(value) | SelectItem::ExprWithAlias { expr: value, .. } => {
                is_aggregate(value)
            }
            _ => false,
        }),
        _ => true,
    };
    let is_empty = |name: &ObjectName| {
        let name = name.0.last().and_then(|part| part.as_ident());
        match name.is_some_and(|name| EMPTY.contains(&name.value.as_str())) {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        }
    };
    !is_counted && visit_relations(query, is_empty).is_break()
}

/// Null, of what a client gives to a query: each parameter that it speaks of is to be in the plan.
fn nothing_of(query: &Query) -> Expr {
    let mut given = BTreeMap::new();
    let _ = visit_expressions(query, |found| {
        let (parameter, text) = match found {
            Expr::Value(_) => (found, format!("{found}::TEXT")),
            Expr::Cast { expr, .. } => (expr.as_ref(), found.to_string()),
            _ => return ControlFlow::<()>::Continue(()),
        };
        if let Expr::Value(value) = parameter
            && let Value::Placeholder(name) = &value.value
        {
            // A cast comes before what it is of.
            given.entry(name.clone()).or_insert(text);
        }
        ControlFlow::Continue(())
    });
    let given: Vec<String> = given.into_values().collect();
    let kept = format!("CASE WHEN false THEN concat({}) END", given.join(", "));
    let kept = (!given.is_empty()).then(|| expression(&kept)).flatten();
    kept.unwrap_or_else(|| null(SqlType::Text))
}

/// A query of one value as one that has one row whatever it is asked of: the planner takes no other beside the rows of the
/// query around it.
fn of_one_row(query: &mut Query) {
    if let SetExpr::Select(select) = query.body.as_mut()
        && query.limit_clause.is_none()
        && let [SelectItem::UnnamedExpr(value) | SelectItem::ExprWithAlias { expr: value, .. }] =
            select.projection.as_mut_slice()
        && !is_aggregate(value)
        && let Some(largest) = expression(&format!("max({value})"))
    {
        *value = largest;
    }
}

/// Whether it makes one value of many.
fn is_aggregate(value: &Expr) -> bool {
    const AGGREGATES: [&str; 9] = [
        "array_agg",
        "avg",
        "bool_and",
        "bool_or",
        "count",
        "max",
        "min",
        "string_agg",
        "sum",
    ];
    let text = value.to_string().to_lowercase();
    let mut aggregates = AGGREGATES.iter();
    aggregates.any(|name| text.contains(&format!("{name}(")))
}

/// A pattern that is escaped by another letter than the backslash, which alone is understood.
fn by_backslash(pattern: &mut Expr, escape: &mut Option<ValueWithSpan>) {
    if let Some(letter) = escape.take()
        && let Some(escaped) = expression(&format!("replace({pattern}, {letter}, '\\')"))
    {
        *pattern = escaped;
    }
}

/// `EXISTS (…)` as a column, which the planner has in conditions only, as `0 < (SELECT count(*) …)`.
fn counted(column: &mut SelectItem) {
    if let SelectItem::UnnamedExpr(found) | SelectItem::ExprWithAlias { expr: found, .. } = column
        && let Expr::Exists { subquery, negated } = found
    {
        let sign = if *negated { "=" } else { "<" };
        let count = format!("0 {sign} (SELECT count(*) FROM ({subquery}) AS found)");
        if let Some(count) = expression(&count) {
            *found = count;
        }
    }
}

/// Whether it is the name of a function or type, as where `'pg_catalog.array_in'::regproc` is looked up.
fn is_name(found: &Expr) -> bool {
    matches!(found, Expr::Identifier(name) if ["proname", "typname"].contains(&name.value.as_str()))
}

/// What a column is called, whatever it is of.
fn last_name(column: &Expr) -> &str {
    match column {
        Expr::Identifier(name) => name.value.as_str(),
        Expr::CompoundIdentifier(parts) => parts.last().map_or("", |name| name.value.as_str()),
        _ => "",
    }
}

/// The schema of a map's layers, and so the search path.
const PATH: &str = "public";

/// Whether it asks if a schema is in the search path. The library has made `IN ('')` of the query that Grafana writes for it.
fn is_path(of: &Expr, list: &[Expr]) -> bool {
    let is_schema = of.to_string().starts_with("quote_ident(");
    is_schema && matches!(list, [only] if only.to_string() == "''")
}

/// Null, for what is asked of a table by its name where a map has none of it: names that are made in a query are no numbers.
fn of_none(call: &Function) -> Option<Expr> {
    let name = call.name.0.last()?.as_ident()?;
    let is_by_name = call.to_string().to_lowercase().contains("(format(");
    (OF_NOTHING.contains(&&*name.value.to_lowercase()) && is_by_name).then(|| null(SqlType::Text))
}

fn is_list(found: &Expr) -> bool {
    match found {
        Expr::Function(call) => {
            matches!(call.args, FunctionArguments::Subquery(_))
                && call.name.to_string().eq_ignore_ascii_case("array")
        }
        column => is_column(column, &LISTS),
    }
}

/// Whether it is a column of a table, of one of these names.
fn is_column(found: &Expr, names: &[&str]) -> bool {
    let Expr::CompoundIdentifier(parts) = found else {
        return false;
    };
    parts
        .last()
        .is_some_and(|name| names.contains(&name.value.as_str()))
}

/// Whether it is one of the numbers in a key.
fn is_of_key(found: &Expr) -> bool {
    let Expr::CompoundFieldAccess { root, access_chain } = found else {
        return false;
    };
    let is_key = |access: &AccessExpr| matches!(access, AccessExpr::Dot(Expr::Identifier(name)) if KEYS.contains(&name.value.as_str()));
    is_column(root, &KEYS) || access_chain.iter().any(is_key)
}

/// `NULL::text[]`.
fn no_list() -> Expr {
    let texts = ArrayElemTypeDef::SquareBracket(Box::new(SqlType::Text), None);
    null(SqlType::Array(texts))
}

fn null(data_type: SqlType) -> Expr {
    Expr::Cast {
        kind: CastKind::DoubleColon,
        expr: Box::new(Expr::Value(Value::Null.into())),
        data_type,
        array: false,
        format: None,
    }
}

/// Whether a query asks for constraints that a map has none of, such as foreign keys, and for no primary key.
fn is_of_other_constraints(query: &Query) -> bool {
    let SetExpr::Select(select) = query.body.as_ref() else {
        return false;
    };
    let mut kinds = Vec::new();
    let _ = visit_expressions(&select.selection, |found| {
        if let Expr::BinaryOp { left, op, right } = found
            && *op == BinaryOperator::Eq
            && last_name(left) == "contype"
        {
            kinds.push(right.to_string());
        }
        ControlFlow::<()>::Continue(())
    });
    let is_other = |kind: &String| kind.starts_with('\'') && !kind.starts_with("'p'");
    !kinds.is_empty() && kinds.iter().all(is_other)
}

/// No rows, with the columns that a query names; none where it names not each, reads nothing that is empty, or asks for
/// keys.
pub fn no_rows(statement: &Statement) -> Option<LogicalPlan> {
    let filled = |table: &TableReference| FILLED.contains(&table.table());
    let tables = tables(statement);
    if tables.iter().all(filled) {
        return None;
    }
    let Statement::Query(query) = statement else {
        return None;
    };
    let mut tables = tables.iter();
    if tables.any(|table| OF_KEYS.contains(&table.table())) && !is_of_other_constraints(query) {
        return None;
    }
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
mod tests;
