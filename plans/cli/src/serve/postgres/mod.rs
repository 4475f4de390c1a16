//! The protocol of Postgres, as `datafusion-postgres` speaks it, with what it leaves open shut: who comes in, what may be
//! said, what an answer may take. The database that a client names is the map; where one map is served, any name is.

mod answering;
mod arrays;
mod catalog;
mod connection;
mod cursors;
mod expression;
mod format;
mod functions;
mod geometry;
mod hook;
mod hooks;
mod kept;
mod keys;
mod nested;
mod parameters;
mod postgis;
mod reading;
mod spatial;
mod startup;
mod tokens;
mod transactions;
mod types;
mod values;
mod wire;

use std::sync::{Arc, LazyLock};

use arrow::datatypes::DataType;
use async_trait::async_trait;
use datafusion::logical_expr::LogicalPlan;
use datafusion::prelude::SessionContext;
use datafusion::sql::sqlparser::ast::Statement;
use datafusion::sql::sqlparser::dialect::PostgreSqlDialect;
use datafusion_postgres::DfSessionService;
use evermap_engine::erased::Erased;
use evermap_engine::error::fault_of;
use evermap_engine::map::is_as_planned;
use evermap_engine::sql::{NO_TABLE, check_size};
use evermap_schemas::{Fault, Kind};
use futures::Sink;
use pgwire::api::cancel::DefaultCancelHandler;
use pgwire::api::portal::{Format, Portal, PortalExecutionState};
use pgwire::api::query::{ExtendedQueryHandler, SimpleQueryHandler};
use pgwire::api::results::{FieldFormat, FieldInfo, Response};
use pgwire::api::stmt::{QueryParser, StoredStatement};
use pgwire::api::store::PortalStore;
use pgwire::api::{ClientInfo, ClientPortalStore, ConnectionManager, METADATA_DATABASE, Type};
use pgwire::error::{ErrorInfo, PgWireError, PgWireResult};
use pgwire::messages::PgWireBackendMessage;
use pgwire::messages::extendedquery::Execute;
use pgwire::messages::simplequery::Query;
use tokio::net::TcpListener;
use tokio::sync::Semaphore;

use crate::serve::access::Access;
use crate::serve::answer::{Bounds, Turn};
use crate::serve::maps::{Maps, Opened};
use crate::serve::patience::{RequestSignal, accept};
use crate::serve::permits::Permits;
use crate::serve::postgres::answering::{all_rows, bounded, cancelled, never, rows_wanted};
use crate::serve::postgres::connection::Handlers;
use crate::serve::postgres::reading::fault_in_our_words;
use crate::serve::postgres::startup::{Startup, is_in};

pub use catalog::complete_catalog;
pub use hooks::hooks;
pub use postgis::complete as complete_types;

/// A statement of a client with its plan, as `datafusion-postgres` has it.
type Prepared = (String, Option<(Statement, LogicalPlan)>);

/// Serves maps for ever. So many clients that are in at once, of all that have a place; more are refused.
pub async fn serve(
    listener: TcpListener,
    permits: Permits,
    maps: Maps,
    access: Access,
    bounds: Bounds,
    connections: usize,
) {
    let manager = Arc::new(ConnectionManager::new());
    let clients = Arc::new(Semaphore::new(connections));
    let tls = access.tls(&["postgresql"]);
    let answered = move |socket, asked: RequestSignal, refused: Option<Fault>| {
        let manager = Arc::clone(&manager);
        let clients = Arc::clone(&clients);
        let startup = Startup::new(&access, Arc::clone(&manager), clients, asked, refused);
        let queries = Queries {
            parser: Arc::new(Parser {
                maps: maps.clone(),
                bounds: bounds.clone(),
            }),
            bounds: bounds.clone(),
        };
        let handlers = Handlers {
            startup: Arc::new(startup),
            queries: Arc::new(queries),
            cancel: Arc::new(DefaultCancelHandler::new(manager)),
        };
        handlers.converse(socket, tls.clone())
    };
    accept(listener, permits, answered).await;
}

/// Answers queries by the newest version of a map, and within bounds.
struct Queries {
    parser: Arc<Parser>,
    bounds: Bounds,
}

impl Queries {
    async fn within<T>(
        &self,
        work: impl Future<Output = PgWireResult<T>>,
    ) -> PgWireResult<(T, Arc<Turn>)> {
        let turn = self.bounds.turn().await.map_err(|fault| said(&fault))?;
        let done = turn.within(work).await.map_err(|fault| said(&fault))?;
        Ok((done.map_err(fault_in_our_words)?, turn))
    }
}

#[async_trait]
impl SimpleQueryHandler for Queries {
    async fn on_query<C>(&self, client: &mut C, query: Query) -> PgWireResult<()>
    where
        C: ClientInfo + ClientPortalStore + Sink<PgWireBackendMessage> + Unpin + Send + Sync,
        C::PortalStore: PortalStore,
        C::Error: std::fmt::Debug,
        PgWireError: From<<C as Sink<PgWireBackendMessage>>::Error>,
    {
        transactions::before_query(client, &query.query);
        self._on_query(client, query).await
    }

    async fn do_query<C>(&self, client: &mut C, query: &str) -> PgWireResult<Vec<Response>>
    where
        C: ClientInfo + ClientPortalStore + Sink<PgWireBackendMessage> + Unpin + Send + Sync,
        C::PortalStore: PortalStore,
        C::Error: std::fmt::Debug,
        PgWireError: From<<C as Sink<PgWireBackendMessage>>::Error>,
    {
        let opened = self.parser.opened(client, query).await?;
        let query = arrays::as_lists(query)?;
        let service = &opened.postgres;
        let work = SimpleQueryHandler::do_query(service, client, &query);
        let (responses, turn) = self.within(work).await?;
        let cancelled = cancelled(client).await;
        let responses = responses.into_iter();
        Ok(responses
            .map(|response| bounded(response, &turn, &cancelled))
            .collect())
    }
}

#[async_trait]
impl ExtendedQueryHandler for Queries {
    type Statement = Prepared;
    type QueryParser = Parser;

    fn query_parser(&self) -> Arc<Parser> {
        Arc::clone(&self.parser)
    }

    async fn on_execute<C>(&self, client: &mut C, mut message: Execute) -> PgWireResult<()>
    where
        C: ClientInfo + ClientPortalStore + Sink<PgWireBackendMessage> + Unpin + Send + Sync,
        C::PortalStore: PortalStore<Statement = Self::Statement>,
        C::Error: std::fmt::Debug,
        PgWireError: From<<C as Sink<PgWireBackendMessage>>::Error>,
    {
        message.max_rows = rows_wanted(message.max_rows, self.bounds.rows)?;
        transactions::before_execute(client, &message);
        self._on_execute(client, message).await
    }

    async fn do_query<C>(
        &self,
        client: &mut C,
        portal: &Portal<Prepared>,
        max_rows: usize,
    ) -> PgWireResult<Response>
    where
        C: ClientInfo + ClientPortalStore + Sink<PgWireBackendMessage> + Unpin + Send + Sync,
        C::PortalStore: PortalStore<Statement = Self::Statement>,
        C::Error: std::fmt::Debug,
        PgWireError: From<<C as Sink<PgWireBackendMessage>>::Error>,
    {
        let opened = self.parser.opened(client, "").await?;
        let service = &opened.postgres;
        let portal = self.parser.of_newest(client, portal, &opened).await?;
        let portal = parameters::bound(portal)?;
        fits(&portal.result_column_format, &portal.statement.statement)?;
        let portal = in_its_formats(portal)?;
        cursors::bound(client, &portal)?;
        let work = ExtendedQueryHandler::do_query(service, client, &portal, max_rows);
        let (response, turn) = self.within(work).await?;
        if max_rows > 0 {
            let cancelled = cancelled(client).await;
            return Ok(bounded(response, &turn, &cancelled));
        }
        // The library listens until this is done.
        match bounded(response, &turn, &never()) {
            Response::Query(rows) => {
                let tag = all_rows(client, rows).await?;
                *portal.state.lock().await = PortalExecutionState::Finished;
                Ok(Response::Execution(tag))
            }
            other => Ok(other),
        }
    }
}

/// Plans queries on the newest version of a map.
struct Parser {
    maps: Maps,
    bounds: Bounds,
}

/// What says the types of plans, which are the same on every map.
static TYPES: LazyLock<Arc<datafusion_postgres::Parser>> =
    LazyLock::new(|| DfSessionService::new(Arc::new(SessionContext::new())).query_parser());

impl Parser {
    /// The map that a client asks, if it may.
    async fn opened<C: ClientInfo>(&self, client: &C, query: &str) -> PgWireResult<Erased<Opened>> {
        if !is_in(client) {
            return Err(error("FATAL", "28000", "expected a password first"));
        }
        check_size(query, &PostgreSqlDialect {}).map_err(|fault| said(&fault))?;
        let named = client.metadata().get(METADATA_DATABASE);
        let map = match (self.maps.only(), named) {
            (Some(map), _) => map,
            (None, named) => {
                let named = named.map_or("", String::as_str);
                let map = self.maps.get(named);
                map.map_err(|fault| error("FATAL", "3D000", &fault.to_string()))?
            }
        };
        map.newest().await.map_err(|fault| said(&fault))
    }
}

/// A query with a note of what it was planned on: a version, as it was opened.
fn noted(query: &str, opened: &Opened) -> String {
    format!("-- opening {}\n{query}", opened.opening)
}

impl Parser {
    /// A portal as it is, or, where a version was published since it was planned, or it reads a log, planned again: a statement
    /// that is prepared once reads what there is each time.
    async fn of_newest<C>(
        &self,
        client: &C,
        portal: &Portal<Prepared>,
        newest: &Opened,
    ) -> PgWireResult<Portal<Prepared>>
    where
        C: ClientInfo + Unpin + Send + Sync,
    {
        let old = &portal.statement;
        let mut statement = Arc::clone(old);
        let query = old
            .statement
            .0
            .split_once('\n')
            .map_or("", |(_, query)| query);
        let is_as_planned = match &old.statement.1 {
            _ if old.statement.0 != noted(query, newest) => false,
            Some((statement, _)) => is_as_planned(&newest.context, statement)
                .await
                .map_err(|fault| said(&fault))?,
            None => true,
        };
        if !is_as_planned {
            let planned = self.parse_sql(client, query, &old.parameter_types).await?;
            let planned = planned.unwrap_or_else(|| old.statement.clone());
            if columns(&planned) != columns(&old.statement) {
                let message = "cached plan must not change result type";
                return Err(error("ERROR", "0A000", message));
            }
            let types = old.parameter_types.clone();
            statement = Arc::new(StoredStatement::new(old.id.clone(), planned, types));
        }
        let again = Portal::new_cursor(portal.name.clone(), statement);
        Ok(with_all_of(again, portal))
    }
}

/// A portal with what a client bound to another.
fn with_all_of(mut again: Portal<Prepared>, portal: &Portal<Prepared>) -> Portal<Prepared> {
    again.parameter_format = portal.parameter_format.clone();
    again.parameters = portal.parameters.clone();
    again.result_column_format = portal.result_column_format.clone();
    again.state = portal.state();
    again
}

/// That there are as many formats as columns, where a client binds one for each: the library looks them up unseen.
fn fits(format: &Format, prepared: &Prepared) -> PgWireResult<()> {
    let count = columns(prepared).len();
    match format {
        Format::Individual(each) if each.len() != count && count > 0 => {
            let found = each.len();
            let message = format!("expected formats of {count} columns, found {found}");
            Err(error("ERROR", "08P01", &message))
        }
        _ => Ok(()),
    }
}

/// A portal whose geometries are written as its client asks for them.
fn in_its_formats(portal: Portal<Prepared>) -> PgWireResult<Portal<Prepared>> {
    let old = &portal.statement;
    let (query, planned) = &old.statement;
    let (Some(rows), Some((statement, _))) = (rows(&old.statement), planned) else {
        return Ok(portal);
    };
    if !geometry::has_any(rows) {
        return Ok(portal);
    }
    let format = &portal.result_column_format;
    let is_text = |column| format.format_for(column) == FieldFormat::Text;
    let plan = geometry::as_text(rows.clone(), is_text).map_err(|error| said(&fault_of(&error)))?;
    let prepared = (query.clone(), Some((statement.clone(), plan)));
    let types = old.parameter_types.clone();
    let statement = Arc::new(StoredStatement::new(old.id.clone(), prepared, types));
    let again = Portal::new_cursor(portal.name.clone(), statement);
    Ok(with_all_of(again, &portal))
}

/// The plan of the rows that a statement gives; `None` where it gives none: who declares a cursor gets rows of what fetches
/// from it.
fn rows((_, planned): &Prepared) -> Option<&LogicalPlan> {
    match planned {
        Some((Statement::Declare { .. }, _)) | None => None,
        Some((_, plan)) => Some(plan),
    }
}

/// Names and types of the columns that a statement gives.
fn columns(prepared: &Prepared) -> Vec<(String, DataType)> {
    let plan = rows(prepared).into_iter();
    let fields = plan.flat_map(|plan| plan.schema().fields());
    fields
        .map(|field| (field.name().clone(), field.data_type().clone()))
        .collect()
}

#[async_trait]
impl QueryParser for Parser {
    type Statement = Prepared;

    async fn parse_sql<C>(
        &self,
        client: &C,
        query: &str,
        types: &[Option<Type>],
    ) -> PgWireResult<Option<Prepared>>
    where
        C: ClientInfo + Unpin + Send + Sync,
    {
        let opened = self.opened(client, query).await?;
        let parser = opened.postgres.query_parser();
        let lists = arrays::as_lists(query)?;
        let typed = parameters::as_declared(&lists, types);
        let planned = self
            .bounds
            .planning(parser.parse_sql(client, &typed, types));
        let planned = planned.await.map_err(|fault| said(&fault))?;
        let planned = planned.map_err(fault_in_our_words)?;
        Ok(planned.map(|(_, plan)| (noted(query, &opened), plan)))
    }

    fn get_parameter_types(&self, prepared: &Prepared) -> PgWireResult<Vec<Type>> {
        match prepared {
            (_, Some((statement, _))) if types::asks_for_types(statement) => {
                Ok(vec![Type::OID_ARRAY])
            }
            _ => parameters::told(prepared),
        }
    }

    fn get_result_schema(
        &self,
        prepared: &Prepared,
        format: Option<&Format>,
    ) -> PgWireResult<Vec<FieldInfo>> {
        format.map_or(Ok(()), |format| fits(format, prepared))?;
        Ok(match rows(prepared) {
            Some(plan) => geometry::told(plan, TYPES.get_result_schema(prepared, format)?),
            None => Vec::new(),
        })
    }
}

/// A fault as clients of Postgres read it.
fn said(fault: &Fault) -> PgWireError {
    let code = match fault.kind {
        Kind::User => code_of(&fault.message),
        Kind::Data => "22000",
        Kind::Resource => "53000",
        Kind::Bug => "XX000",
    };
    let mut info = ErrorInfo::new("ERROR".to_owned(), code.to_owned(), fault.message.clone());
    info.detail = (!fault.place.is_empty()).then(|| fault.place.clone());
    info.hint = (!fault.next.is_empty()).then(|| fault.next.clone());
    PgWireError::UserError(Box::new(info))
}

/// The number that Postgres has for what is wrong with a query: programs go by it.
fn code_of(message: &str) -> &'static str {
    let says = |text: &str| message.contains(text);
    match () {
        () if message.starts_with(NO_TABLE) => "42P01",
        () if says("No field named") => "42703",
        () if says("there is no function ") => "42883",
        () if message.starts_with("SQL: ") || says("parser error") => "42601",
        () if says("Divide by zero") => "22012",
        () if says("expected a value of the type ") => "22P02",
        () => "42000",
    }
}

fn error(severity: &str, code: &str, message: &str) -> PgWireError {
    let info = ErrorInfo::new(severity.to_owned(), code.to_owned(), message.to_owned());
    PgWireError::UserError(Box::new(info))
}
