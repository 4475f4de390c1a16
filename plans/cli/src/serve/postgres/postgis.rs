//! What clients of PostGIS look up: the type `geometry`, the columns that have it, and which PostGIS it is.
//!
//! The library's tables know Postgres' own types. Two of them are put right on their way out: `pg_type` has one row more, and
//! in `pg_attribute` columns of geometries are not `bytea`.

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::sync::{Arc, LazyLock};

use arrow::array::{ArrayRef, AsArray, Int32Array, RecordBatch, StringArray};
use arrow::compute::{cast, concat_batches};
use arrow::datatypes::{DataType, FieldRef, Int32Type, Schema, SchemaRef};
use async_trait::async_trait;
use datafusion::catalog::streaming::StreamingTable;
use datafusion::catalog::{MemTable, SchemaProvider, TableProvider};
use datafusion::common::exec_err;
use datafusion::error::Result;
use datafusion::execution::{FunctionRegistry, SendableRecordBatchStream, TaskContext};
use datafusion::physical_plan::stream::RecordBatchStreamAdapter;
use datafusion::physical_plan::streaming::PartitionStream;
use datafusion::prelude::SessionContext;
use datafusion::scalar::ScalarValue;
use datafusion::sql::sqlparser::ast::{ObjectNamePart, Statement, visit_relations_mut};
use datafusion_postgres::arrow_pg::datatypes::PG_CHAR_KEY;
use datafusion_postgres::datafusion_pg_catalog::pg_catalog::oid_field::{kind::REGPROC, oid_field};
use pgwire::api::Type;
use tokio::sync::OnceCell;

use crate::output::GEOMETRY;
use crate::serve::postgres::format::format;
use crate::serve::postgres::functions::{
    ARRAY_OUT, FormatType, SETTINGS, as_binary, constant, current_setting, expand_array,
    set_config, to_regtype, uuid_in, uuids_in,
};
use crate::serve::postgres::geometry::OID;
use crate::serve::postgres::keys;

const CATALOG: &str = "pg_catalog";
/// What clients take the types for. Of its functions a map has those that `evermap functions` lists.
const VERSION: &str = "3.4 USE_GEOS=0 USE_PROJ=0 USE_STATS=0";

/// The version of Postgres whose clients are understood, as the protocol says it too.
const POSTGRES: &str = concat!("PostgreSQL 16.6 by evermap ", env!("CARGO_PKG_VERSION"));

/// What reads the library's tables. A map's own context would hold itself, and never be dropped.
static READER: LazyLock<SessionContext> = LazyLock::new(SessionContext::new);

/// Adds the type, its columns and the functions that ask for them to a context whose catalog has the library's tables.
///
/// # Errors
/// What reading these says.
pub async fn complete(context: &SessionContext, name: &str) -> Result<()> {
    let Some(catalog) = context.catalog(name) else {
        return exec_err!("there is no catalog {name}");
    };
    let Some(inner) = catalog.schema(CATALOG) else {
        return exec_err!("there is no schema {CATALOG}");
    };
    let types = with_geometry(read(&inner, "pg_type").await?)?;
    let types = by_number(types, &numbers(&read(&inner, "pg_proc").await?, "proname")?)?;
    let types = with_kinds(types)?;
    let numbers = numbers(&types, "typname")?;
    let types = MemTable::try_new(types.schema(), vec![vec![types]])?;
    let relations = inner.table("pg_class").await?.map(|table| table.schema());
    let relations = relations.unwrap_or_else(|| Arc::new(Schema::empty()));
    let mut tables = Catalog {
        inner,
        types: Arc::new(types),
        views: BTreeMap::new(),
    };
    catalog.register_schema(CATALOG, Arc::new(tables.clone()))?;
    let views = [
        ("geometry_columns", geometries(name)),
        ("geography_columns", GEOGRAPHIES.to_owned()),
        ("spatial_ref_sys", SYSTEMS.to_owned()),
        ("columns", columns(name)),
        (KEPT, keys::indexes()),
        ("pg_constraint", keys::constraints()),
        ("table_constraints", keys::table_constraints(name)),
        ("key_column_usage", keys::key_columns(name)),
        ("pg_class", keys::relations(&relations)),
        ("pg_settings", settings()),
    ];
    // Each asks the tables that were just put right.
    for (view, query) in views {
        let view_of = context.sql(&query).await?.into_view();
        let view_of = match view {
            KEPT => derived(view_of, Ok, Some(Arc::default()))?,
            _ => view_of,
        };
        tables.views.insert(view, view_of);
        catalog.register_schema(CATALOG, Arc::new(tables.clone()))?;
    }
    for function in [
        to_regtype(numbers),
        ARRAY_OUT.clone(),
        current_setting(),
        set_config(),
        uuid_in(),
        uuids_in(),
        as_binary(),
        expand_array(),
        format(),
    ] {
        context.register_udf(function);
    }
    if let Ok(inner) = context.udf("format_type") {
        context.register_udf(FormatType { inner }.into());
    }
    let text = |text: &str| ScalarValue::Utf8(Some(text.to_owned()));
    for (name, value) in [
        ("version", text(POSTGRES)),
        ("postgis_version", text(VERSION)),
        ("postgis_lib_version", text("3.4.0")),
        // QGIS takes null for a PostGIS that cannot select by place.
        (
            "postgis_geos_version",
            text("none, but relations of geometries"),
        ),
        ("postgis_proj_version", ScalarValue::Utf8(None)),
        // As of a server that is there to be read.
        ("pg_is_in_recovery", ScalarValue::Boolean(Some(true))),
        ("postgis_typmod_dims", ScalarValue::Int32(Some(DIMENSIONS))),
        ("postgis_typmod_srid", ScalarValue::Int32(Some(SYSTEM))),
        ("postgis_typmod_type", text("Geometry")),
        ("st_srid", ScalarValue::Int32(Some(SYSTEM))),
    ] {
        context.register_udf(constant(name, value));
    }
    Ok(())
}

/// What PostGIS adds to the tables: in which of them there are geometries, and which reference systems they have. Postgres
/// looks for them without being told where.
const OF_POSTGIS: [&str; 3] = ["geometry_columns", "geography_columns", "spatial_ref_sys"];

/// The keys of layers, which other views ask, and which ask for all columns of all tables: what is found is kept.
const KEPT: &str = "pg_index";

/// Views that are in `information_schema`; the types of its `columns` DataFusion calls by Arrow's names.
const OF_STANDARD: [&str; 3] = ["columns", "table_constraints", "key_column_usage"];

/// The statement with these views by their whole names.
pub fn with_views(mut statement: Statement) -> Statement {
    let _ = visit_relations_mut(&mut statement, |name| {
        let parts: Vec<_> = name.0.iter().map(ObjectNamePart::to_string).collect();
        let catalog = ObjectNamePart::Identifier(CATALOG.into());
        match parts.iter().map(String::as_str).collect::<Vec<_>>()[..] {
            [view] if OF_POSTGIS.contains(&view) => name.0.insert(0, catalog),
            [.., "information_schema", view] if OF_STANDARD.contains(&view) => {
                let schema = name.0.len() - 2;
                name.0[schema] = catalog;
            }
            _ => {}
        }
        ControlFlow::<()>::Continue(())
    });
    statement
}

/// Points have heights, if they need not.
const DIMENSIONS: i32 = 3;

/// The number of the reference system: geometries are in the metres of a site, which none is.
const SYSTEM: i32 = 0;

/// No reference systems.
const SYSTEMS: &str = "SELECT CAST(0 AS INT) AS srid, '' AS auth_name, CAST(0 AS INT) AS auth_srid, '' AS srtext, \
     '' AS proj4text WHERE false";

/// No places by longitude and latitude.
const GEOGRAPHIES: &str = "SELECT '' AS f_table_catalog, '' AS f_table_schema, '' AS f_table_name, '' AS f_geography_column, \
     CAST(0 AS INT) AS coord_dimension, CAST(0 AS INT) AS srid, '' AS type WHERE false";

/// What the server says of itself.
fn settings() -> String {
    let rows = SETTINGS.map(|(name, value)| format!("('{name}', '{value}')"));
    format!(
        "SELECT name, setting, CAST(NULL AS TEXT) AS unit, '' AS category, '' AS short_desc, 'internal' AS context, \
         'string' AS vartype, 'default' AS source, setting AS boot_val, setting AS reset_val \
         FROM (VALUES {}) AS s(name, setting)",
        rows.join(", ")
    )
}

/// The columns of all tables, as far as SQL's standard and Postgres agree on what is known of them here.
fn columns(catalog: &str) -> String {
    let catalog = catalog.replace('\'', "''");
    let unknown = [
        keys::each("column_default", "CAST(NULL AS TEXT)"),
        keys::each(
            "character_maximum_length numeric_precision numeric_scale datetime_precision \
             character_octet_length numeric_precision_radix",
            "CAST(NULL AS INT)",
        ),
        keys::each(
            "domain_name collation_name identity_generation generation_expression",
            "CAST(NULL AS TEXT)",
        ),
    ]
    .concat();
    let never = "'NO' AS is_identity, 'NEVER' AS is_generated, 'NO' AS is_updatable, ";
    format!(
        "SELECT '{catalog}' AS table_catalog, n.nspname AS table_schema, c.relname AS table_name, \
         a.attname AS column_name, CAST(a.attnum AS INT) AS ordinal_position, \
         CASE WHEN a.attnotnull THEN 'NO' ELSE 'YES' END AS is_nullable, \
         CASE WHEN a.atttypid = {OID} THEN 'USER-DEFINED' WHEN t.typcategory = 'A' THEN 'ARRAY' \
         ELSE format_type(a.atttypid, a.atttypmod) END AS data_type, {unknown}{never}'{catalog}' AS udt_catalog, \
         CASE WHEN a.atttypid = {OID} THEN 'public' ELSE 'pg_catalog' END AS udt_schema, t.typname AS udt_name \
         FROM pg_catalog.pg_attribute a JOIN pg_catalog.pg_class c ON a.attrelid = c.oid \
         JOIN pg_catalog.pg_namespace n ON c.relnamespace = n.oid JOIN pg_catalog.pg_type t ON t.oid = a.atttypid"
    )
}

fn geometries(catalog: &str) -> String {
    let catalog = catalog.replace('\'', "''");
    format!(
        "SELECT '{catalog}' AS f_table_catalog, n.nspname AS f_table_schema, c.relname AS f_table_name, \
         a.attname AS f_geometry_column, CAST({DIMENSIONS} AS INT) AS coord_dimension, CAST({SYSTEM} AS INT) AS srid, 'GEOMETRY' AS type \
         FROM pg_catalog.pg_attribute a JOIN pg_catalog.pg_class c ON a.attrelid = c.oid \
         JOIN pg_catalog.pg_namespace n ON c.relnamespace = n.oid WHERE a.atttypid = {OID}"
    )
}

async fn read(schema: &Arc<dyn SchemaProvider>, name: &str) -> Result<RecordBatch> {
    let Some(table) = schema.table(name).await? else {
        return exec_err!("there is no table {name}");
    };
    all(table).await
}

async fn all(table: Arc<dyn TableProvider>) -> Result<RecordBatch> {
    let schema = table.schema();
    let batches = READER.read_table(table)?.collect().await?;
    Ok(concat_batches(&schema, &batches)?)
}

/// The types of Postgres, and one like `bytea` under another name and number.
fn with_geometry(types: RecordBatch) -> Result<RecordBatch> {
    let bytea = i32::try_from(Type::BYTEA.oid()).unwrap_or_default();
    let numbers = int32(&types, "oid")?;
    let Some(row) = numbers.iter().position(|number| number == Some(bytea)) else {
        return exec_err!("pg_type has no bytea");
    };
    let like = types.slice(row, 1);
    let fields = types.schema().fields().clone();
    let column = |(field, value): (&FieldRef, &ArrayRef)| {
        let other: ArrayRef = match field.name().as_str() {
            "oid" => Arc::new(Int32Array::from(vec![OID.cast_signed()])),
            "typarray" => Arc::new(Int32Array::from(vec![0])),
            "typname" => Arc::new(StringArray::from(vec![GEOMETRY])),
            "typcategory" => Arc::new(StringArray::from(vec!["U"])),
            _ => return Ok(Arc::clone(value)),
        };
        cast(&other, field.data_type())
    };
    let columns = fields.iter().zip(like.columns()).map(column);
    let row = RecordBatch::try_new(types.schema(), columns.collect::<Result<_, _>>()?)?;
    Ok(concat_batches(&types.schema(), [&types, &row])?)
}

/// Columns of `pg_type` that name functions.
const FUNCTIONS: [&str; 7] = [
    "typinput",
    "typoutput",
    "typreceive",
    "typsend",
    "typmodin",
    "typmodout",
    "typanalyze",
];

/// The types with functions by their numbers, which the library has by name: clients compare them with numbers.
fn by_number(types: RecordBatch, functions: &BTreeMap<String, i32>) -> Result<RecordBatch> {
    let schema = types.schema();
    let column = |(field, values): (&FieldRef, &ArrayRef)| {
        if !FUNCTIONS.contains(&field.name().as_str()) || *values.data_type() != DataType::Utf8 {
            return (Arc::clone(field), Arc::clone(values));
        }
        let number = |name: Option<&str>| Some(functions.get(name?).copied().unwrap_or(0));
        let numbers: Int32Array = values.as_string::<i32>().iter().map(number).collect();
        let field = oid_field(field.name(), REGPROC, field.is_nullable());
        (Arc::new(field), Arc::new(numbers))
    };
    let (fields, columns): (Vec<FieldRef>, Vec<ArrayRef>) = schema
        .fields()
        .iter()
        .zip(types.columns())
        .map(column)
        .unzip();
    Ok(RecordBatch::try_new(
        Arc::new(Schema::new(fields)),
        columns,
    )?)
}

/// The types with their kinds as of Postgres' type `"char"`: asyncpg compares them with bytes.
fn with_kinds(types: RecordBatch) -> Result<RecordBatch> {
    let schema = types.schema();
    let fields = schema.fields().iter().map(|field| {
        if field.name() != "typtype" {
            return Arc::clone(field);
        }
        let mut known = field.metadata().clone();
        known.insert(PG_CHAR_KEY.to_owned(), String::new());
        Arc::new(field.as_ref().clone().with_metadata(known))
    });
    let fields: Vec<FieldRef> = fields.collect();
    Ok(RecordBatch::try_new(
        Arc::new(Schema::new(fields)),
        types.columns().to_vec(),
    )?)
}

/// The numbers of what a table names.
fn numbers(table: &RecordBatch, names: &str) -> Result<BTreeMap<String, i32>> {
    let Some(names) = table.column_by_name(names) else {
        return exec_err!("there is no column {names}");
    };
    let names = cast(names, &DataType::Utf8)?;
    let names = names.as_string::<i32>().iter().flatten().map(str::to_owned);
    let numbers = int32(table, "oid")?;
    Ok(names.zip(numbers.iter().flatten()).collect())
}

fn int32(batch: &RecordBatch, name: &str) -> Result<Int32Array> {
    let Some(column) = batch.column_by_name(name) else {
        return exec_err!("there is no column {name}");
    };
    let column = cast(column, &DataType::Int32)?;
    Ok(column.as_primitive::<Int32Type>().clone())
}

/// The library's tables, two of them put right, and what PostGIS adds to them.
#[derive(Debug, Clone)]
struct Catalog {
    inner: Arc<dyn SchemaProvider>,
    types: Arc<dyn TableProvider>,
    views: BTreeMap<&'static str, Arc<dyn TableProvider>>,
}

#[async_trait]
impl SchemaProvider for Catalog {
    fn table_names(&self) -> Vec<String> {
        let views = self.views.keys().map(|name| (*name).to_owned());
        self.inner.table_names().into_iter().chain(views).collect()
    }

    async fn table(&self, name: &str) -> Result<Option<Arc<dyn TableProvider>>> {
        match name {
            "pg_type" => Ok(Some(Arc::clone(&self.types))),
            "pg_attribute" => {
                let inner = self.inner.table(name).await?;
                inner.map(|inner| derived(inner, typed, None)).transpose()
            }
            _ => match self.views.get(name) {
                Some(view) => Ok(Some(Arc::clone(view))),
                None => self.inner.table(name).await,
            },
        }
    }

    fn table_exist(&self, name: &str) -> bool {
        self.views.contains_key(name) || self.inner.table_exist(name)
    }
}

/// The rows that are made of a table's; found once where they are kept: those of a version stay what they are.
fn derived(
    table: Arc<dyn TableProvider>,
    made: fn(RecordBatch) -> Result<RecordBatch>,
    kept: Option<Arc<OnceCell<RecordBatch>>>,
) -> Result<Arc<dyn TableProvider>> {
    let schema = table.schema();
    let rows = Arc::new(Derived {
        table,
        schema: Arc::clone(&schema),
        made,
        kept,
    });
    Ok(Arc::new(StreamingTable::try_new(schema, vec![rows])?))
}

#[derive(Debug)]
struct Derived {
    table: Arc<dyn TableProvider>,
    schema: SchemaRef,
    made: fn(RecordBatch) -> Result<RecordBatch>,
    kept: Option<Arc<OnceCell<RecordBatch>>>,
}

impl PartitionStream for Derived {
    fn schema(&self) -> &SchemaRef {
        &self.schema
    }

    fn execute(&self, _: Arc<TaskContext>) -> SendableRecordBatchStream {
        let (table, made, kept) = (Arc::clone(&self.table), self.made, self.kept.clone());
        let found = async move { made(all(table).await?) };
        let found = futures::stream::once(async move {
            match kept {
                Some(kept) => kept.get_or_try_init(|| found).await.cloned(),
                None => found.await,
            }
        });
        Box::pin(RecordBatchStreamAdapter::new(
            Arc::clone(&self.schema),
            found,
        ))
    }
}

/// The columns of tables, those of geometries with their type.
fn typed(attributes: RecordBatch) -> Result<RecordBatch> {
    let bytea = Type::BYTEA.oid().cast_signed();
    let (Ok(index), Some(names)) = (
        attributes.schema_ref().index_of("atttypid"),
        attributes.column_by_name("attname"),
    ) else {
        return exec_err!("pg_attribute has no names or types");
    };
    let names = cast(names, &DataType::Utf8)?;
    let names = names.as_string::<i32>().iter();
    let types = int32(&attributes, "atttypid")?;
    let types = names.zip(types.iter()).map(|(name, number)| match number {
        Some(number) if name == Some(GEOMETRY) && number == bytea => Some(OID.cast_signed()),
        number => number,
    });
    let mut columns = attributes.columns().to_vec();
    columns[index] = Arc::new(types.collect::<Int32Array>());
    Ok(RecordBatch::try_new(attributes.schema(), columns)?)
}
