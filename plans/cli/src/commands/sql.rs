//! `evermap sql`.

mod schemas;
mod unplayed;

use std::io::IsTerminal;
use std::path::Path;
use std::sync::Arc;

use arrow::array::RecordBatch;
use arrow::datatypes::SchemaRef;
use datafusion::common::TableReference;
use datafusion::error::DataFusionError;
use datafusion::execution::memory_pool::MemoryConsumer;
use datafusion::logical_expr::LogicalPlan;
use datafusion::prelude::{DataFrame, SessionContext};
use datafusion::sql::parser::{DFParserBuilder, Statement};
use datafusion::sql::sqlparser::ast;
use datafusion::sql::sqlparser::dialect::GenericDialect;
use datafusion::sql::sqlparser::parser::ParserError;
use evermap_datasets::{Dataset, without_mark};
use evermap_engine::error::{OrFault, fault_of};
use evermap_engine::map::Map;
use evermap_engine::map::columns::{of_answer, of_table};
use evermap_engine::run::runner::Unfinished;
use evermap_engine::sql::{
    Limits, NO_TABLE, OpenValues, TABLES, catalog, check_size, context, explained, in_utc,
    only_reads, plan_of,
};
use evermap_functions::{asks_graphs, use_indexes};
use evermap_language::listed;
use evermap_schemas::dictionary::{ColumnInfo, columns};
use evermap_schemas::{Fault, Layer, batch, layers};
use futures::{StreamExt, TryStreamExt};
use tokio::sync::OnceCell;

use crate::arguments::{SessionArgs, SqlArgs};
use crate::ending::{Ending, Failure, Lost};
use crate::operators;
use crate::output::{Format, Sink, write_whole, write_within};
use crate::progress::line;
use crate::prompt;
use crate::reader::MapReader;
use crate::sessions;
use crate::standard_input::standard_input;
use schemas::{add_hidden_topics, schema_of_session};

/// What to do where a row is too heavy to be written.
const COPIED: &str =
    "give more --memory, or write Arrow (--format arrow), which makes nothing else of a row";

/// The name that a map is given, where it is, and its address.
fn named(map: &str) -> (Option<&str>, &str) {
    match map.split_once('=') {
        // An address may have parameters, a folder's name an equals sign.
        Some((name, address)) if !name.contains(['/', '.', ':']) && !Path::new(map).exists() => {
            (Some(name), address)
        }
        _ => (None, map),
    }
}

/// What queries run on.
pub struct Tables {
    /// The tables.
    pub context: SessionContext,
    reader: Option<MapReader>,
    dataset: Option<Dataset>,
    /// Whether queries on graphs can use the indexes already.
    indexed: OnceCell<()>,
}

impl Tables {
    async fn open(args: &SqlArgs, sessions: &SessionArgs) -> Result<Self, Fault> {
        let limits = Limits {
            memory_bytes: args.memory,
            ..Limits::default()
        };
        let Some((first, others)) = args.map.split_first() else {
            return Self::of_logs(sessions, limits).await;
        };
        let (name, address) = named(first);
        let mut tables = Self::of_map(address, args.version, limits).await?;
        if let Some((name, map)) = name.zip(tables.map()) {
            map.join(name, &tables.context, &operators::registry())?;
        }
        for (name, address) in others.iter().map(|other| named(other)) {
            let map = Map::open(address, None).await?;
            let name = match name {
                Some(name) => name.to_owned(),
                None => map.store.name()?,
            };
            map.join(&name, &tables.context, &operators::registry())?;
        }
        if !sessions.sessions.is_empty() || sessions.manifest.is_some() {
            tables.add_logs(sessions).await?;
        }
        Ok(tables)
    }

    /// Puts the logs of sessions beside a map, each as a schema of its session's name.
    async fn add_logs(&mut self, sessions: &SessionArgs) -> Result<(), Fault> {
        let dataset = sessions::open(&self.context.runtime_env(), sessions, None).await?;
        dataset.register_stores(&self.context.runtime_env());
        let catalog = catalog(&self.context)?;
        for session in &dataset.sessions {
            let tables = schema_of_session(&dataset.of_session(session))?;
            let taken = catalog.register_schema(&session.name, tables);
            if taken.or_fault()?.is_some() {
                let name = &session.name;
                return Err(
                    Fault::user(format!("`{name}` is the name of a map and of a session"))
                        .next("give the map another one: --map NAME=DIR"),
                );
            }
        }
        self.dataset = Some(dataset);
        Ok(())
    }

    /// Those of a map, at the version asked for.
    ///
    /// # Errors
    /// As [`MapReader::open`].
    pub async fn of_map(
        address: &str,
        version: Option<u64>,
        limits: Limits,
    ) -> Result<Self, Fault> {
        let reader = MapReader::open(address, version).await?;
        Ok(Self {
            context: reader.context(context(limits)?)?,
            reader: Some(reader),
            dataset: None,
            indexed: OnceCell::new(),
        })
    }

    /// Those of logs.
    ///
    /// # Errors
    /// A log that cannot be opened, a manifest with a fault, or two sessions of one name.
    pub async fn of_logs(sessions: &SessionArgs, limits: Limits) -> Result<Self, Fault> {
        let context = context(limits)?;
        in_utc(&context);
        let dataset = sessions::open(&context.runtime_env(), sessions, None).await?;
        dataset.register(&context)?;
        add_hidden_topics(&context, &dataset)?;
        Ok(Self {
            context,
            reader: None,
            dataset: Some(dataset),
            indexed: OnceCell::new(),
        })
    }

    /// The map, where they are of one.
    pub fn map(&self) -> Option<&Map> {
        self.reader.as_ref().map(|reader| &reader.map)
    }

    /// All rows of the answer to a query that only reads.
    ///
    /// # Errors
    /// What is wrong with the query, or what reading says.
    pub async fn ask(&self, query: &str) -> Result<(SchemaRef, Vec<RecordBatch>), Fault> {
        let mut statements = statements(query)?;
        let (Some(statement), None) = (statements.pop(), statements.pop()) else {
            return Err(Fault::user("expected one query, found none or several"));
        };
        let frame = self.frame(statement).await?;
        let rows = frame.execute_stream().await.or_fault()?;
        let schema = rows.schema();
        Ok((schema, rows.try_collect::<Vec<_>>().await.or_fault()?))
    }

    /// The declaration of a table's columns, where there is one: of the operator that made it, else by name.
    pub fn declaration(&self, table: &str) -> Option<Layer> {
        match &self.reader {
            Some(reader) => reader.declaration(table),
            None => layers::named(table),
        }
    }

    /// The columns of a table, named alone or with its schema: as it is called, or as a query writes it, in quotes.
    ///
    /// # Errors
    /// A user fault where there is no such table, or what opening it says.
    pub async fn columns(&self, name: &str) -> Result<Vec<ColumnInfo>, Fault> {
        let (called, written) = (TableReference::bare(name), TableReference::from(name));
        let (reference, described) = match of_table(&self.context, called.clone()).await {
            Ok(described) => (called, described),
            Err(_) => {
                let described = of_table(&self.context, written.clone()).await;
                let described = described.map_err(|fault| self.explained(fault))?;
                (written, described)
            }
        };
        let declared = self.declaration(reference.table());
        let name = reference.to_vec().join(".");
        Ok(columns(&name, &described, declared.as_ref()))
    }

    /// What reading logs has lost so far.
    pub async fn lost(&self) -> Lost {
        let of_map = match &self.reader {
            Some(reader) => reader.map.logs().await,
            None => Vec::new(),
        };
        sessions::lost(self.dataset.iter().chain(&of_map))
    }

    /// A fault of planning, in our words where a table or a function is not there. A table may be misspelt, or a topic
    /// that damage took.
    fn explained(&self, fault: Fault) -> Fault {
        let fault = explained(&self.context, fault);
        if !fault.message.starts_with(NO_TABLE) {
            return fault;
        }
        let losses = self.dataset.as_ref().map(|dataset| &dataset.losses);
        let next = match (losses, fault.next.as_str()) {
            (Some(lost), meant) if !lost.is_empty() => {
                let lost = format!(
                    "the logs are torn or damaged, and it may be in what was lost ({}): see evermap inspect",
                    lost.lines().join(", ")
                );
                match meant {
                    "" => lost,
                    meant => format!("{meant} ({lost})"),
                }
            }
            (_, "") => {
                let names = self.names();
                format!("there are {}", listed(names.iter().map(String::as_str)))
            }
            (_, meant) => meant.to_owned(),
        };
        fault.next(next)
    }

    /// Names of the tables, ascending.
    pub fn names(&self) -> Vec<String> {
        let catalog = catalog(&self.context).ok();
        let schema = catalog.and_then(|catalog| catalog.schema(TABLES));
        let mut names = schema.map_or_else(Vec::new, |schema| schema.table_names());
        names.sort();
        names
    }

    async fn use_indexes(&self) {
        if let Err(fault) = use_indexes(&self.context).await.or_fault() {
            line(&format!(
                "warning: queries read graphs, not their indexes: {fault}"
            ));
        }
    }

    /// Plans one statement, which only reads.
    async fn frame(&self, statement: Statement) -> Result<DataFrame, Fault> {
        let state = self.context.state();
        let read = state.resolve_table_references(&statement);
        let plan = plan_of(&state, statement).await.or_fault();
        let plan = plan.map_err(|fault| self.explained(fault))?;
        if let (Some(dataset), Ok(read)) = (&self.dataset, read) {
            let notes = unplayed::notes(dataset, &read);
            notes.iter().for_each(|note| line(&format!("note: {note}")));
        }
        read_only(&plan)?;
        OpenValues::refuse(&plan)?;
        if asks_graphs(&plan).or_fault()? {
            self.indexed.get_or_init(|| self.use_indexes()).await;
        }
        self.context.execute_logical_plan(plan).await.or_fault()
    }

    /// Runs one statement and writes its rows; how many there were.
    ///
    /// # Errors
    /// A user fault for a statement that makes no sense; what reading says; that the output is closed.
    pub async fn run(
        &self,
        statement: Statement,
        format: Format,
        sink: &mut Sink,
    ) -> Result<u64, Failure> {
        if let Some(table) = described_table(&statement) {
            let columns = batch(self.columns(&table).await?)?;
            let rows = futures::stream::iter([Ok(columns.clone())]);
            return write_whole(format, columns.schema(), rows, sink).await;
        }
        let frame = self.frame(statement).await?;
        let plan = frame.logical_plan().clone();
        let is_plan = matches!(plan, LogicalPlan::Explain(_) | LogicalPlan::Analyze(_));
        let rows = frame.execute_stream().await.or_fault()?;
        // Texts say no units.
        let schema = match format.is_binary() {
            true => of_answer(&self.context, &plan, &rows.schema()).await,
            false => rows.schema(),
        };
        let rows = rows.map_err(|error| fault_of(&error));
        match is_plan {
            true => write_whole(format, schema, rows.boxed(), sink).await,
            false => {
                let copied = MemoryConsumer::new("a row on its way out");
                let copied = copied.register(&self.context.runtime_env().memory_pool);
                let copy = |bytes| match copied.try_resize(bytes).or_fault() {
                    Err(fault) => Err(fault.next(COPIED)),
                    done => done,
                };
                write_within(format, schema, rows.boxed(), sink, copy).await
            }
        }
    }
}

/// The table that a statement wants described, as it is written.
fn described_table(statement: &Statement) -> Option<String> {
    let Statement::Statement(statement) = statement else {
        return None;
    };
    let ast::Statement::ExplainTable { table_name, .. } = statement.as_ref() else {
        return None;
    };
    Some(table_name.to_string())
}

/// Queries read: they make no tables, write no files, and change no settings. Output goes where `--out` says.
fn read_only(plan: &LogicalPlan) -> Result<(), Fault> {
    only_reads(plan).map_err(|error| {
        let found = error.strip_backtrace();
        let found = found.rsplit(": ").next().unwrap_or_default();
        Fault::user(format!("expected a query that only reads, found {found}"))
            .next("name sessions or a map on the command line, write results with --out, limit memory with --memory")
    })
}

/// The statements of a text; semicolons inside quotes and comments are none.
///
/// # Errors
/// A user fault with what the parser says, or for a statement that is too large.
pub fn statements(text: &str) -> Result<Vec<Statement>, Fault> {
    check_size(text, &GenericDialect {})?;
    let parsed = DFParserBuilder::new(text)
        .with_dialect(&GenericDialect {})
        .build()
        .and_then(|mut parser| parser.parse_statements());
    let parsed = parsed.map_err(|error| match (fault_of(&error), error.find_root()) {
        (told, DataFusionError::SQL(error, _))
            if !matches!(**error, ParserError::RecursionLimitExceeded) =>
        {
            let text = error.to_string();
            let fault = Fault::user(text.trim_start_matches("sql parser error: "));
            match () {
                () if text.contains("found: view") => {
                    fault.next("VIEW is a word of SQL: after a comma, write the column as \"view\"")
                }
                () if text.contains("found: /") => {
                    fault.next("write a topic in double quotes: FROM \"/odom\"")
                }
                () => fault.next(told.next),
            }
        }
        (told, _) => told,
    });
    Ok(parsed?.into_iter().collect())
}

/// Whether queries are asked for at a prompt, which has its own way with interrupts.
pub fn is_prompt(args: &SqlArgs) -> bool {
    let (_, query) = args.split();
    query.is_none() && std::io::stdin().is_terminal() && args.out.is_none()
}

/// Runs a query, those of standard input, or a prompt, whose queries hold `unfinished`.
///
/// # Errors
/// The first statement's fault; at a prompt faults are shown and the prompt goes on.
pub async fn sql(args: &SqlArgs, unfinished: &Unfinished) -> Ending {
    let (sessions, query) = args.split();
    let format = args.written()?;
    let tables = Arc::new(Tables::open(args, &sessions).await?);
    match query {
        Some(query) => all(&tables, statements(&query)?, args).await?,
        None if is_prompt(args) => prompt::run(&tables, format, unfinished).await?,
        None => {
            let text = String::from_utf8(standard_input("queries")?);
            let text = text.map_err(|error| {
                Fault::user(format!("cannot read queries: {error}")).next("send them as UTF-8")
            })?;
            script(&tables, without_mark(&text), args).await?;
        }
    }
    Ok(tables.lost().await)
}

/// Runs queries, and what a prompt knows beside them, in their order.
async fn script(tables: &Tables, text: &str, args: &SqlArgs) -> Result<(), Failure> {
    let (mut queries, mut commands) = (String::new(), false);
    for line in text.split_inclusive('\n') {
        let is_command = line.trim_start().starts_with('\\') && !prompt::is_quoted_open(&queries);
        if !is_command {
            queries.push_str(line);
            continue;
        }
        commands = true;
        let asked = statements(&std::mem::take(&mut queries))?;
        if !asked.is_empty() {
            all(tables, asked, args).await?;
        }
        if !prompt::command(tables, line).await? {
            return Ok(());
        }
    }
    let asked = statements(&queries)?;
    match commands && asked.is_empty() {
        true => Ok(()),
        false => all(tables, asked, args).await,
    }
}

async fn all(tables: &Tables, statements: Vec<Statement>, args: &SqlArgs) -> Result<(), Failure> {
    let format = args.written()?;
    let to_one_file = args.out.is_some() || format.is_binary();
    if statements.is_empty() || (statements.len() > 1 && to_one_file) {
        let expected = if to_one_file { "one query" } else { "a query" };
        let found = match statements.len() {
            0 => "none".to_owned(),
            several => several.to_string(),
        };
        return Err(Fault::user(format!("expected {expected}, found {found}")).into());
    }
    for statement in statements {
        let mut sink = Sink::to(args.out.as_deref().map(Path::new))?;
        tables.run(statement, format, &mut sink).await?;
        sink.finish()?;
    }
    Ok(())
}

#[cfg(test)]
mod tests;
