//! The keys of layers as primary keys of tables: the index and the constraint that Postgres has of each.

use arrow::datatypes::{DataType, Field, Schema};
use datafusion::sql::sqlparser::ast::{Expr, Function, FunctionArguments};
use evermap_schemas::{Layer, layers};

use crate::serve::postgres::expression::expression;
use crate::serve::postgres::functions::EXPAND_ARRAY;

/// How far the number of a key's index is from that of its table, and that of its constraint: no table has one so high.
const FROM_TABLE_TO_INDEX: i32 = 1 << 30;
const FROM_TABLE_TO_CONSTRAINT: i32 = 1 << 29;

/// A column that says how what it is of would be made, and the column with the number that Postgres' function takes for it.
struct ColumnDefinition {
    of: &'static str,
    definition: &'static str,
}

/// `pg_get_indexdef(indexrelid)`.
const INDEX: ColumnDefinition = ColumnDefinition {
    of: "indexrelid",
    definition: "indexdef",
};

/// `pg_get_constraintdef(oid)`.
const CONSTRAINT: ColumnDefinition = ColumnDefinition {
    of: "oid",
    definition: "condef",
};

/// What Postgres calls a primary key.
const NAME: &str = "c.relname || '_pkey'";

/// `pg_index`: the keys of tables that have all the columns of a layer's key.
pub fn indexes() -> String {
    let columns = |layer: Layer| {
        let number = layer.key.len();
        let columns = layer.key.iter().enumerate();
        let row = |(place, column): (usize, &&str)| {
            format!("('{}', '{column}', {place}, {number})", layer.name)
        };
        columns.map(row).collect::<Vec<_>>()
    };
    let rows: Vec<String> = layers::all().into_iter().flat_map(columns).collect();
    let always = each(
        "indisunique indisprimary indimmediate indisvalid indisready indislive",
        "true",
    );
    let never = each(
        "indnullsnotdistinct indisexclusion indisclustered indcheckxmin indisreplident",
        "false",
    );
    format!(
        "SELECT CAST(c.oid + {FROM_TABLE_TO_INDEX} AS INT) AS indexrelid, c.oid AS indrelid, \
         CAST(count(*) AS SMALLINT) AS indnatts, CAST(count(*) AS SMALLINT) AS indnkeyatts, {always}{never}\
         array_agg(a.attnum ORDER BY k.place) AS indkey, \
         array_agg(CAST(0 AS INT)) AS indcollation, array_agg(CAST(0 AS INT)) AS indclass, \
         array_agg(CAST(k.place * 0 AS SMALLINT)) AS indoption, CAST(NULL AS TEXT) AS indexprs, CAST(NULL AS TEXT) AS indpred, \
         'CREATE UNIQUE INDEX ' || {NAME} || ' ON ' || c.relname || ' USING btree (' \
             || string_agg(a.attname, ', ' ORDER BY k.place) || ')' AS {} \
         FROM pg_catalog.pg_class c JOIN pg_catalog.pg_attribute a ON a.attrelid = c.oid \
         JOIN (VALUES {}) AS k(layer, name, place, number) ON k.layer = c.relname AND k.name = a.attname \
         GROUP BY c.oid, c.relname, k.number HAVING count(*) = k.number",
        INDEX.definition,
        rows.join(", ")
    )
}

/// `pg_constraint`.
pub fn constraints() -> String {
    let always = each("convalidated conislocal connoinherit", "true");
    let never = each("condeferrable condeferred conperiod", "false");
    let none = each(
        "contypid conparentid confrelid coninhcount",
        "CAST(0 AS INT)",
    );
    format!(
        "SELECT CAST(c.oid + {FROM_TABLE_TO_CONSTRAINT} AS INT) AS oid, {NAME} AS conname, \
         c.relnamespace AS connamespace, 'p' AS contype, {always}{never}c.oid AS conrelid, i.indexrelid AS conindid, {none}\
         ' ' AS confupdtype, ' ' AS confdeltype, ' ' AS confmatchtype, i.indkey AS conkey, \
         CASE WHEN false THEN i.indkey END AS confkey, CAST(NULL AS TEXT) AS conbin, \
         'PRIMARY KEY (' || split_part(i.{}, '(', 2) AS {} \
         FROM pg_catalog.pg_index i JOIN pg_catalog.pg_class c ON c.oid = i.indrelid",
        INDEX.definition, CONSTRAINT.definition
    )
}

/// `information_schema.table_constraints`.
pub fn table_constraints(catalog: &str) -> String {
    format!(
        "SELECT {}, 'PRIMARY KEY' AS constraint_type, 'NO' AS is_deferrable, 'NO' AS initially_deferred, \
         'YES' AS enforced {OF_KEYS}",
        named(catalog)
    )
}

/// `information_schema.key_column_usage`.
pub fn key_columns(catalog: &str) -> String {
    format!(
        "SELECT {}, a.attname AS column_name, CAST(array_position(i.indkey, a.attnum) AS INT) AS ordinal_position, \
         CAST(NULL AS INT) AS position_in_unique_constraint {OF_KEYS} \
         JOIN pg_catalog.pg_attribute a ON a.attrelid = c.oid WHERE array_has(i.indkey, a.attnum)",
        named(catalog)
    )
}

const OF_KEYS: &str = "FROM pg_catalog.pg_index i JOIN pg_catalog.pg_class c ON c.oid = i.indrelid \
     JOIN pg_catalog.pg_namespace n ON n.oid = c.relnamespace";

fn named(catalog: &str) -> String {
    let catalog = catalog.replace('\'', "''");
    format!(
        "'{catalog}' AS constraint_catalog, n.nspname AS constraint_schema, {NAME} AS constraint_name, \
         '{catalog}' AS table_catalog, n.nspname AS table_schema, c.relname AS table_name"
    )
}

/// `pg_class` with a row for each index beside those of tables.
pub fn relations(of_tables: &Schema) -> String {
    let columns = |one: &dyn Fn(&Field) -> String| {
        let columns = of_tables.fields().iter().map(|column| one(column));
        columns.collect::<Vec<_>>().join(", ")
    };
    format!(
        "SELECT {} FROM pg_catalog.pg_class c LEFT JOIN pg_catalog.pg_index i ON c.oid = i.indrelid \
         UNION ALL SELECT {} FROM pg_catalog.pg_index i JOIN pg_catalog.pg_class c ON c.oid = i.indrelid",
        columns(&of_table),
        columns(&of_index)
    )
}

/// What `pg_class` says of a table in this column.
fn of_table(column: &Field) -> String {
    match column.name().as_str() {
        HAS_INDEX => format!("i.indrelid IS NOT NULL AS {HAS_INDEX}"),
        name => format!("c.{name}"),
    }
}

const HAS_INDEX: &str = "relhasindex";

/// What `pg_class` says of an index in this column: what it says of its table, but for a few.
fn of_index(column: &Field) -> String {
    let name = column.name();
    let value = match name.as_str() {
        "oid" => "i.indexrelid",
        "relname" => NAME,
        "reltype" => "0",
        // A B-tree, as all keys of Postgres are.
        "relam" => "403",
        "relkind" => "'i'",
        "relnatts" => "i.indnatts",
        HAS_INDEX => "false",
        _ => return format!("c.{name}"),
    };
    let kind = match column.data_type() {
        DataType::Int16 => "SMALLINT",
        DataType::Int32 => "INT",
        DataType::Boolean => "BOOLEAN",
        _ => "TEXT",
    };
    format!("CAST({value} AS {kind}) AS {name}")
}

/// Columns that are vectors in Postgres: it counts their elements from 0.
const VECTORS: [&str; 4] = ["indclass", "indcollation", "indkey", "indoption"];

/// `generate_subscripts(list, dimension)`: rows of the places of a list's elements.
fn places(call: &Function) -> Option<Expr> {
    let FunctionArguments::List(list) = &call.args else {
        return None;
    };
    let [of, dimension] = list.args.as_slice() else {
        return None;
    };
    let of = of.to_string();
    let length = format!("array_length({of}, {dimension})");
    let column = of.rsplit('.').next().unwrap_or_default();
    expression(&match VECTORS.contains(&column) {
        true => format!("unnest(range(0, {length}))"),
        false => format!("unnest(generate_series(1, {length}))"),
    })
}

/// What is asked of a key: rows of the numbers of its columns, or of their places, or how it would be made, which a column
/// beside it says.
pub fn of_key(call: &Function) -> Option<Expr> {
    let name = call.name.0.last()?.as_ident()?;
    let column = match &*name.value.to_lowercase() {
        EXPAND_ARRAY => return expression(&format!("unnest({call})")),
        "generate_subscripts" => return places(call),
        "pg_get_indexdef" => INDEX,
        "pg_get_constraintdef" => CONSTRAINT,
        _ => return None,
    };
    let FunctionArguments::List(list) = &call.args else {
        return None;
    };
    let values: Vec<String> = list.args.iter().map(ToString::to_string).collect();
    let (number, others) = values.split_first()?;
    let is_whole = others
        .iter()
        .all(|other| ["0", "true", "false"].contains(&other.as_str()));
    let table = number.strip_suffix(&format!(".{}", column.of))?;
    is_whole.then(|| expression(&format!("{table}.{}", column.definition)))?
}

/// Columns that all have one value.
pub fn each(names: &str, value: &str) -> String {
    let columns = names.split(' ').map(|name| format!("{value} AS {name}, "));
    columns.collect()
}
