//! Tables and functions that a query names and that are not there, with those that may be meant.

mod elsewhere;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use datafusion::catalog::{CatalogProvider, TableProvider};
use datafusion::common::utils::quote_identifier;
use datafusion::common::{ResolvedTableReference, TableReference};
use datafusion::prelude::SessionContext;
use evermap_language::nearest;
use evermap_schemas::Fault;

use crate::error::OrFault;
use crate::map::flat::SUFFIX;
use crate::sql::missing::elsewhere::written_here;

/// How a fault begins that says that a table is not there.
pub const NO_TABLE: &str = "there is no table ";

/// Schemas that the catalog of a context has and does not list, as the logs of a map, each with the tables that it is
/// known to have before it is opened: an extension of the context's settings.
#[derive(Debug)]
pub struct Unlisted(pub BTreeMap<String, BTreeSet<String>>);

/// A fault of planning, in our words where it is that a table or a function is not there, with the one that may be meant.
pub fn explained(context: &SessionContext, fault: Fault) -> Fault {
    match missing_table(context, &fault.message) {
        Some(table) => Fault {
            place: fault.place,
            ..no_table(context, &table)
        },
        None => without_member(context, without_function(context, fault)),
    }
}

/// A table of a context.
///
/// # Errors
/// As [`no_table`], or what opening it says.
pub async fn table_of(
    context: &SessionContext,
    name: TableReference,
) -> Result<Arc<dyn TableProvider>, Fault> {
    // The error is that there is no such schema.
    let schema = context.state().schema_for_ref(name.clone()).ok();
    let table = match schema {
        Some(schema) => schema.table(name.table()).await.or_fault()?,
        None => None,
    };
    table.ok_or_else(|| no_table(context, &name))
}

/// That a table is not there, with the one that may be meant.
pub fn no_table(context: &SessionContext, table: &TableReference) -> Fault {
    let names = Names::of(context);
    let table = table.clone().resolve(&names.catalog, &names.schema);
    let fault = Fault::user(format!("{NO_TABLE}`{}`", names.shown(&table)));
    match names.meant(&table) {
        Some(meant) => fault.next(format!("did you mean `{}`?", names.shown(&meant))),
        None => fault,
    }
}

/// The names of a context.
struct Names<'c> {
    context: &'c SessionContext,
    /// The catalog of a table that is named without one.
    catalog: String,
    /// Its schema, where none is named.
    schema: String,
}

impl<'c> Names<'c> {
    fn of(context: &'c SessionContext) -> Self {
        let config = context.copied_config();
        let options = &config.options().catalog;
        Self {
            context,
            catalog: options.default_catalog.clone(),
            schema: options.default_schema.clone(),
        }
    }

    /// The name of a table as a query writes it.
    fn shown(&self, table: &ResolvedTableReference) -> String {
        let parts = [&table.catalog, &table.schema, &table.table];
        let parts = match () {
            () if *table.catalog != *self.catalog => &parts[..],
            () if *table.schema != *self.schema => &parts[1..],
            () => &parts[2..],
        };
        let quoted = parts.iter().map(|part| quote_identifier(part));
        quoted.collect::<Vec<_>>().join(".")
    }

    /// What may be meant by the name of a table that there is not: one of a schema, as of a log, that is named without it;
    /// a misspelt one, one of another version, of a misspelt schema, or one that has no schema.
    fn meant(&self, written: &ResolvedTableReference) -> Option<ResolvedTableReference> {
        let catalog = self.context.catalog(&written.catalog)?;
        let meant = |schema: &str, table: &str| ResolvedTableReference {
            catalog: Arc::clone(&written.catalog),
            schema: schema.into(),
            table: table.into(),
        };
        let home = tables(catalog.as_ref(), &self.schema);
        if let Some((name, version)) = written.table.split_once('@')
            && let Ok(version) = version.parse::<u64>()
        {
            return Some(meant(&format!("v{version}"), alike(name, &home)?));
        }
        let schemas = self.schemas(catalog.as_ref());
        let schema = match catalog.schema(&written.schema) {
            Some(_) => Some(&*written.schema),
            None => nearest(&written.schema, schemas.iter().map(String::as_str)),
        };
        let in_schema = schema.and_then(|schema| {
            let names = tables(catalog.as_ref(), schema);
            // A log names its tables once it is open.
            let is_open = !names.is_empty() || *schema == *written.schema;
            let table = match is_open {
                true => alike(&written.table, &names)?,
                false => &*written.table,
            };
            Some(meant(schema, table))
        });
        let at_home = || Some(meant(&self.schema, alike(&written.table, &home)?));
        let without_schema = *written.schema == *self.schema;
        let mut others = schemas.iter().filter(|_| without_schema);
        let elsewhere = others.find(|schema| self.has(catalog.as_ref(), schema, &written.table));
        let elsewhere = elsewhere.map(|schema| meant(schema, &written.table));
        let meant = elsewhere.or(in_schema).or_else(at_home);
        meant.filter(|meant| meant != written)
    }

    /// The schemas that have tables, ascending.
    fn schemas(&self, catalog: &dyn CatalogProvider) -> Vec<String> {
        let mut schemas = catalog.schema_names();
        schemas.retain(|schema| !tables(catalog, schema).is_empty());
        if let Some(more) = self.context.copied_config().get_extension::<Unlisted>() {
            schemas.extend(more.0.keys().cloned());
        }
        schemas.sort();
        schemas
    }

    /// Whether a schema is known to have a table of this very name.
    fn has(&self, catalog: &dyn CatalogProvider, schema: &str, table: &str) -> bool {
        let config = self.context.copied_config();
        let unlisted = config.get_extension::<Unlisted>();
        let unlisted = unlisted.as_ref().and_then(|known| known.0.get(schema));
        unlisted.is_some_and(|known| known.contains(table))
            || tables(catalog, schema).iter().any(|name| name == table)
    }
}

/// The tables of a schema, ascending.
fn tables(catalog: &dyn CatalogProvider, schema: &str) -> Vec<String> {
    let schema = catalog.schema(schema);
    let mut names = schema.map_or_else(Vec::new, |schema| schema.table_names());
    names.sort();
    names
}

/// The same name, or one that is near.
fn alike<'n>(name: &str, names: &'n [String]) -> Option<&'n str> {
    let names = names.iter().map(String::as_str);
    let same = names.clone().find(|known| *known == name);
    same.or_else(|| nearest(name, names))
}

/// The table that DataFusion did not find. It says all parts of the name, without quotes: where they have dots, those
/// end a part that make it a name that there is.
fn missing_table(context: &SessionContext, message: &str) -> Option<TableReference> {
    let name = between(message, "table '", "' not found")?;
    let catalog = |name: &str| context.catalog(name);
    let (first, rest) = cut(name, |part| catalog(part).is_some())?;
    let catalog = catalog(first);
    let schema = |name: &str| catalog.as_ref().and_then(|catalog| catalog.schema(name));
    let (schema, table) = cut(rest, |part| schema(part).is_some())?;
    Some(TableReference::full(first, schema, table))
}

/// A name before and behind the first dot that ends a known part; where none does, the first.
fn cut(name: &str, is_known: impl Fn(&str) -> bool) -> Option<(&str, &str)> {
    let dots = name.match_indices('.');
    let mut cuts = dots.map(move |(at, _)| (&name[..at], &name[at + 1..]));
    let known = cuts.clone().find(|(part, _)| is_known(part));
    known.or_else(|| cuts.next())
}

fn between<'m>(message: &'m str, begin: &str, end: &str) -> Option<&'m str> {
    let (_, behind) = message.split_once(begin)?;
    behind.split_once(end).map(|(name, _)| name)
}

/// A fault of planning, in our words where it is that a function is not there.
fn without_function(context: &SessionContext, fault: Fault) -> Fault {
    let state = context.state();
    let function = between(&fault.message, "Invalid function '", "'");
    let of_table = between(&fault.message, "table function '", "' not found");
    let (name, mut known): (_, Vec<&String>) = match (function, of_table) {
        (Some(name), _) => {
            let known = state.scalar_functions().keys();
            let known = known.chain(state.aggregate_functions().keys());
            let known = known.chain(state.window_functions().keys());
            (name, known.collect())
        }
        (None, Some(name)) => (name, state.table_functions().keys().collect()),
        (None, None) => return fault,
    };
    known.sort();
    let near = || nearest(name, known.into_iter().map(String::as_str));
    let next = match written_here(name) {
        Some(here) => format!("write {here}"),
        None => match near() {
            Some(near) => format!("did you mean `{near}`?"),
            None => "`evermap functions` lists those of maps".to_owned(),
        },
    };
    Fault {
        message: format!("there is no function `{name}`"),
        next,
        ..fault
    }
}

/// A fault of planning, in our words where a column is not there that a flat table has for a member of a struct.
fn without_member(context: &SessionContext, fault: Fault) -> Fault {
    let Some((relation, column, member)) = member(&fault.message) else {
        return fault;
    };
    let names = Names::of(context);
    let flat = format!("{relation}{SUFFIX}");
    let home = context.catalog(&names.catalog);
    let home = home.map_or_else(Vec::new, |catalog| tables(catalog.as_ref(), &names.schema));
    let next = match home.contains(&flat) {
        true => format!("write {column}['{member}'], or FROM {flat}: it has {column}_{member}"),
        false => format!("write {column}['{member}']"),
    };
    fault.next(next)
}

/// The table, the struct and its member that a column is named after which is not there: `poses`, `map_from_vehicle` and
/// `x` of `map_from_vehicle_x`.
fn member(message: &str) -> Option<(&str, &str, &str)> {
    let (name, behind) = message
        .strip_prefix("No field named ")?
        .split_once(". Did you mean '")?;
    let (relation, column) = behind.split_once('\'')?.0.rsplit_once('.')?;
    let name = name.rsplit('.').next()?;
    let member = name.strip_prefix(column)?.strip_prefix('_')?;
    let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '_';
    (!member.is_empty() && member.chars().all(is_plain)).then_some((relation, column, member))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use arrow::array::{ArrayRef, Float64Array, RecordBatch, StructArray};
    use arrow::datatypes::{DataType, Field, Schema};
    use datafusion::catalog::MemorySchemaProvider;
    use datafusion::datasource::MemTable;

    use super::*;
    use crate::sql::{Limits, catalog, context, read_only};

    /// `lanes` and `poses`, and the logs `initial`, which is open, and `tuesday`, which is not.
    fn some() -> SessionContext {
        let context = context(Limits::one_partition()).unwrap();
        let column = Field::new("x", DataType::Float64, false);
        let rows = RecordBatch::new_empty(Arc::new(Schema::new(vec![column])));
        let log = Arc::new(MemorySchemaProvider::new());
        let catalog = catalog(&context).unwrap();
        catalog.register_schema("initial", log).unwrap();
        for name in [
            TableReference::bare("lanes"),
            TableReference::bare("poses"),
            TableReference::partial("initial", "/odom"),
        ] {
            let table = MemTable::try_new(rows.schema(), vec![vec![rows.clone()]]).unwrap();
            context.register_table(name, Arc::new(table)).unwrap();
        }
        let known = ["/imu", "odometry"].map(str::to_owned);
        let logs = [("tuesday".to_owned(), BTreeSet::from(known))];
        let logs = Unlisted(BTreeMap::from(logs));
        let state = context.state_ref();
        state.write().config_mut().set_extension(Arc::new(logs));
        context
    }

    async fn told(context: &SessionContext, query: &str) -> Fault {
        read_only(context, query).await.err().unwrap()
    }

    #[tokio::test]
    async fn a_table_that_is_not_there_is_named_with_the_one_that_may_be_meant() {
        let context = some();
        for (written, meant) in [
            ("lanse", "lanes"),
            ("\"Lanes\"", "lanes"),
            ("\"lanes@1\"", "v1.lanes"),
            ("\"pose@2\"", "v2.poses"),
            ("previous.poses", "poses"),
            ("previous.posess", "poses"),
            ("initial.\"/odm\"", "initial.\"/odom\""),
            ("inital.\"/odom\"", "initial.\"/odom\""),
            ("inital.\"/odm\"", "initial.\"/odom\""),
            ("initial.lanes", "lanes"),
            ("tuesdai.\"/imu\"", "tuesday.\"/imu\""),
            ("\"/odom\"", "initial.\"/odom\""),
            ("odometry", "tuesday.odometry"),
            ("trees", ""),
            ("elsewhere.trees", ""),
            ("nobodys.own.trees", ""),
        ] {
            let fault = told(&context, &format!("SELECT * FROM {written}")).await;
            assert_eq!(fault.message, format!("there is no table `{written}`"));
            assert_eq!(fault.place, "line 1, column 15 of the query", "{written}");
            let next = match meant {
                "" => String::new(),
                meant => format!("did you mean `{meant}`?"),
            };
            assert_eq!(fault.next, next, "{written}");
        }
    }

    #[tokio::test]
    async fn a_function_that_is_not_there_is_named_with_the_one_that_may_be_meant() {
        let context = some();
        for (query, name, meant) in [
            ("SELECT st_lenght(x) FROM lanes", "st_lenght", "st_length"),
            (
                "SELECT row_numbr() OVER () FROM lanes",
                "row_numbr",
                "row_number",
            ),
            (
                "SELECT * FROM generate_serie(1, 2)",
                "generate_serie",
                "generate_series",
            ),
        ] {
            let fault = told(&context, query).await;
            assert_eq!(fault.message, format!("there is no function `{name}`"));
            assert_eq!(fault.next, format!("did you mean `{meant}`?"));
        }
    }

    #[tokio::test]
    async fn a_column_of_a_flat_table_is_told_as_the_member_that_it_is() {
        let context = some();
        let x: ArrayRef = Arc::new(Float64Array::from(vec![1.0]));
        let members = vec![(Arc::new(Field::new("x", DataType::Float64, false)), x)];
        let pose: ArrayRef = Arc::new(StructArray::from(members));
        let rows = RecordBatch::try_from_iter([("map_from_vehicle", pose)]).unwrap();
        for table in ["drives", "drives_flat", "tours"] {
            context.register_batch(table, rows.clone()).unwrap();
        }
        for (query, said) in [
            (
                "SELECT map_from_vehicle_x FROM drives",
                "write map_from_vehicle['x'], or FROM drives_flat: it has map_from_vehicle_x",
            ),
            (
                "SELECT map_from_vehicle_x FROM drives AS d",
                "write map_from_vehicle['x']",
            ),
            (
                "SELECT map_from_vehicle_x FROM tours",
                "write map_from_vehicle['x']",
            ),
            ("SELECT map_from_vehicles FROM tours", ""),
        ] {
            let fault = told(&context, query).await;
            assert_eq!(fault.next, said, "{query}");
        }
    }

    #[tokio::test]
    async fn a_table_is_found_by_its_name() {
        let context = some();
        let found = table_of(&context, TableReference::partial("initial", "/odom")).await;
        assert_eq!(found.unwrap().schema().fields().len(), 1);
        let fault = table_of(&context, TableReference::bare("lane")).await.err();
        let said = "user: there is no table `lane`; did you mean `lanes`?";
        assert_eq!(fault.unwrap().to_string(), said);
    }
}
