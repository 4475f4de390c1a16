//! Flight SQL: the drivers of ADBC and JDBC fetch rows as Arrow, without copying them.
//!
//! Nothing is kept between calls: a ticket is the query and the version that it was planned on. A statement that is prepared
//! once is planned again each time that somebody asks where its rows are. The header `map` names the map where several are
//! served.

use std::pin::Pin;
use std::sync::{Arc, LazyLock};

use arrow::datatypes::{Schema, SchemaRef};
use arrow::ipc::writer::IpcWriteOptions;
use arrow::record_batch::RecordBatch;
use arrow_flight::encode::FlightDataEncoderBuilder;
use arrow_flight::error::FlightError;
use arrow_flight::flight_service_server::{FlightService, FlightServiceServer};
use arrow_flight::sql::metadata::{SqlInfoData, SqlInfoDataBuilder};
use arrow_flight::sql::server::FlightSqlService;
use arrow_flight::sql::{
    ActionClosePreparedStatementRequest, ActionCreatePreparedStatementRequest,
    ActionCreatePreparedStatementResult, Any, CommandGetCatalogs, CommandGetDbSchemas,
    CommandGetSqlInfo, CommandGetTableTypes, CommandGetTables, CommandPreparedStatementQuery,
    CommandStatementQuery, ProstMessageExt, SqlInfo, TicketStatementQuery,
};
use arrow_flight::{
    Action, FlightDescriptor, FlightEndpoint, FlightInfo, HandshakeRequest, HandshakeResponse,
    IpcMessage, SchemaAsIpc, Ticket,
};
use async_trait::async_trait;
use datafusion::catalog::SchemaProvider;
use datafusion::common::TableReference;
use evermap_engine::error::OrFault;
use evermap_engine::map::columns::{of_answer, of_table};
use evermap_engine::sql::{TABLES, catalog, read_only};
use evermap_schemas::{Fault, Kind};
use futures::future::BoxFuture;
use futures::{FutureExt, Stream, StreamExt, TryStreamExt};
use prost::Message;
use serde::{Deserialize, Serialize};
use tonic::{Request, Response, Status, Streaming};

use crate::output::with_columns;
use crate::serve::answer::{Bounds, answer};
use crate::serve::aside::aside;
use crate::serve::maps::{Maps, Opened, ServedMap};

/// What a table is called here.
const TABLE: &str = "TABLE";

/// The service, beneath [`PATH`].
pub fn service(maps: Maps, bounds: Bounds) -> FlightServiceServer<Flight> {
    FlightServiceServer::new(Flight { maps, bounds })
}

/// Where the service is, by its protocol.
pub const PATH: &str = "/arrow.flight.protocol.FlightService/{*call}";

/// Answers the calls of Flight SQL.
#[derive(Clone)]
pub struct Flight {
    maps: Maps,
    bounds: Bounds,
}

/// A query and the version that it was planned on.
#[derive(Serialize, Deserialize)]
struct Planned {
    query: String,
    version: u64,
}

impl Planned {
    fn bytes(&self) -> Result<Vec<u8>, Status> {
        postcard::to_stdvec(self).map_err(|error| Status::internal(error.to_string()))
    }

    fn parse(bytes: &[u8]) -> Result<Self, Status> {
        postcard::from_bytes(bytes).map_err(|_| {
            Status::invalid_argument("expected a ticket of this server, found another")
        })
    }
}

/// Who asks where rows are, and the answer.
type InfoRequest = Request<FlightDescriptor>;
type Info = Result<Response<FlightInfo>, Status>;

/// Rows themselves.
type Got<S> = Result<Response<<S as FlightService>::DoGetStream>, Status>;

impl Flight {
    fn map<T>(&self, request: &Request<T>) -> Result<&Arc<ServedMap>, Status> {
        let named = request.metadata().get("map");
        let named = named.and_then(|name| name.to_str().ok());
        match (named, self.maps.only()) {
            (None, Some(map)) => Ok(map),
            (named, _) => self.maps.get(named.unwrap_or_default()).map_err(status),
        }
    }

    /// Plans a query on the newest version: what a ticket says, and the columns as they are sent.
    fn plan<'a>(
        &'a self,
        map: &'a ServedMap,
        query: String,
    ) -> BoxFuture<'a, Result<(Planned, SchemaRef), Status>> {
        let planned = async move {
            let opened = map.newest().await.map_err(status)?;
            let turn = self.bounds.turn().await.map_err(status)?;
            // Drivers compare these columns with those that come: planned to the end, they are the same.
            let (context, text) = (opened.context.clone(), query.clone());
            let planned = turn.within(aside(async move {
                let frame = read_only(&context, &text).await?;
                let plan = frame.logical_plan().clone();
                let coming = frame.create_physical_plan().await.or_fault()?.schema();
                Ok(of_answer(&context, &plan, &coming).await)
            }));
            let planned = planned.await.flatten().flatten();
            let schema = sent(planned.map_err(status)?);
            let version = opened.version();
            Ok((Planned { query, version }, schema))
        };
        planned.boxed()
    }

    fn rows<'a>(&'a self, map: &'a ServedMap, planned: &'a Planned) -> BoxFuture<'a, Got<Self>> {
        let rows = async move {
            let opened = map.version(Some(planned.version)).await.map_err(status)?;
            let answer = answer(&opened, &planned.query, &self.bounds).await;
            let answer = answer.map_err(status)?;
            let schema = sent(answer.schema);
            let columns = Arc::clone(&schema);
            // The encoder takes large lists for plain ones, and does not make them so.
            let rows = answer
                .rows
                .map(move |batch| Ok::<_, Fault>(with_columns(&columns, &batch?)?));
            let rows = rows.map_err(|fault| FlightError::Tonic(Box::new(status(fault))));
            let encoded = FlightDataEncoderBuilder::new()
                .with_schema(schema)
                .build(rows)
                .map_err(Status::from);
            Ok(Response::new(StreamExt::boxed(encoded)))
        };
        rows.boxed()
    }
}

/// A fault as gRPC says it.
fn status(fault: Fault) -> Status {
    match fault.kind {
        Kind::User => Status::invalid_argument(fault.to_string()),
        Kind::Data => Status::data_loss(fault.to_string()),
        Kind::Resource => Status::resource_exhausted(fault.to_string()),
        Kind::Bug => Status::internal(fault.to_string()),
    }
}

/// The columns as they are sent: the encoder makes plain lists of large ones, and values of dictionaries.
fn sent(schema: SchemaRef) -> SchemaRef {
    let encoder = FlightDataEncoderBuilder::new().with_schema(Arc::clone(&schema));
    let encoder = encoder.build(futures::stream::empty());
    encoder.known_schema().unwrap_or(schema)
}

/// Where rows of a planned query are: here, by its ticket.
fn statement(planned: &Planned, schema: &Schema, request: InfoRequest) -> Info {
    let ticket = TicketStatementQuery {
        statement_handle: planned.bytes()?.into(),
    };
    info(schema, ticket.as_any(), request)
}

/// Where rows of these columns are: here, by this ticket.
fn info(schema: &Schema, ticket: Any, request: InfoRequest) -> Info {
    let endpoint = FlightEndpoint::new().with_ticket(Ticket::new(ticket.encode_to_vec()));
    let info = FlightInfo::new().try_with_schema(schema);
    let info = info.map_err(|error| Status::internal(error.to_string()))?;
    let info = info.with_endpoint(endpoint);
    Ok(Response::new(info.with_descriptor(request.into_inner())))
}

/// One batch as the rows of an answer.
fn one(batch: Result<RecordBatch, FlightError>) -> Got<Flight> {
    let batch = batch.map_err(Status::from)?;
    let rows = FlightDataEncoderBuilder::new()
        .with_schema(batch.schema())
        .build(futures::stream::iter([Ok(batch)]))
        .map_err(Status::from);
    Ok(Response::new(rows.boxed()))
}

fn layers(opened: &Opened) -> Result<Arc<dyn SchemaProvider>, Status> {
    let catalog = catalog(&opened.context).ok();
    let layers = catalog.and_then(|catalog| catalog.schema(TABLES));
    layers.ok_or_else(|| Status::internal("the map has no tables"))
}

/// What drivers ask of a server before all else.
static ABOUT: LazyLock<Option<SqlInfoData>> = LazyLock::new(|| {
    let mut about = SqlInfoDataBuilder::new();
    about.append(SqlInfo::FlightSqlServerName, "evermap");
    about.append(SqlInfo::FlightSqlServerVersion, env!("CARGO_PKG_VERSION"));
    about.append(SqlInfo::FlightSqlServerArrowVersion, "1.3");
    about.append(SqlInfo::FlightSqlServerReadOnly, true);
    about.build().ok()
});

fn about() -> Result<&'static SqlInfoData, Status> {
    let about = ABOUT.as_ref();
    about.ok_or_else(|| Status::internal("the server does not know itself"))
}

type Handshakes = Pin<Box<dyn Stream<Item = Result<HandshakeResponse, Status>> + Send>>;

#[async_trait]
impl FlightSqlService for Flight {
    type FlightService = Self;

    /// Every call is let in by its own header, so a handshake gives back the one that it has.
    async fn do_handshake(
        &self,
        request: Request<Streaming<HandshakeRequest>>,
    ) -> Result<Response<Handshakes>, Status> {
        let header = request.metadata().get("authorization").cloned();
        let said = HandshakeResponse::default();
        let said: Handshakes = futures::stream::iter([Ok(said)]).boxed();
        let mut response = Response::new(said);
        if let Some(header) = header {
            response.metadata_mut().insert("authorization", header);
        }
        Ok(response)
    }

    async fn get_flight_info_statement(
        &self,
        command: CommandStatementQuery,
        request: InfoRequest,
    ) -> Info {
        let (planned, schema) = self.plan(self.map(&request)?, command.query).await?;
        statement(&planned, &schema, request)
    }

    async fn do_get_statement(
        &self,
        ticket: TicketStatementQuery,
        request: Request<Ticket>,
    ) -> Got<Self> {
        let planned = Planned::parse(&ticket.statement_handle)?;
        self.rows(self.map(&request)?, &planned).await
    }

    async fn do_action_create_prepared_statement(
        &self,
        command: ActionCreatePreparedStatementRequest,
        request: Request<Action>,
    ) -> Result<ActionCreatePreparedStatementResult, Status> {
        let (planned, schema) = self.plan(self.map(&request)?, command.query).await?;
        let options = IpcWriteOptions::default();
        let message = IpcMessage::try_from(SchemaAsIpc::new(&schema, &options));
        let message = message.map_err(|error| Status::internal(error.to_string()))?;
        Ok(ActionCreatePreparedStatementResult {
            prepared_statement_handle: planned.bytes()?.into(),
            dataset_schema: message.0,
            parameter_schema: Vec::new().into(),
        })
    }

    async fn do_action_close_prepared_statement(
        &self,
        _: ActionClosePreparedStatementRequest,
        _: Request<Action>,
    ) -> Result<(), Status> {
        Ok(())
    }

    async fn get_flight_info_prepared_statement(
        &self,
        command: CommandPreparedStatementQuery,
        request: InfoRequest,
    ) -> Info {
        let prepared = Planned::parse(&command.prepared_statement_handle)?;
        let (planned, schema) = self.plan(self.map(&request)?, prepared.query).await?;
        statement(&planned, &schema, request)
    }

    async fn get_flight_info_catalogs(
        &self,
        command: CommandGetCatalogs,
        request: InfoRequest,
    ) -> Info {
        let ticket = command.as_any();
        let schema = command.into_builder().schema();
        info(&schema, ticket, request)
    }

    async fn do_get_catalogs(&self, command: CommandGetCatalogs, _: Request<Ticket>) -> Got<Self> {
        let mut catalogs = command.into_builder();
        for map in self.maps.all() {
            catalogs.append(&map.name);
        }
        one(catalogs.build())
    }

    async fn get_flight_info_schemas(
        &self,
        command: CommandGetDbSchemas,
        request: InfoRequest,
    ) -> Info {
        let ticket = command.as_any();
        let schema = command.into_builder().schema();
        info(&schema, ticket, request)
    }

    async fn do_get_schemas(&self, command: CommandGetDbSchemas, _: Request<Ticket>) -> Got<Self> {
        let mut schemas = command.into_builder();
        for map in self.maps.all() {
            schemas.append(&map.name, TABLES);
        }
        one(schemas.build())
    }

    async fn get_flight_info_tables(
        &self,
        command: CommandGetTables,
        request: InfoRequest,
    ) -> Info {
        let ticket = command.as_any();
        let schema = command.into_builder().schema();
        info(&schema, ticket, request)
    }

    async fn do_get_tables(
        &self,
        command: CommandGetTables,
        request: Request<Ticket>,
    ) -> Got<Self> {
        let map = self.map(&request)?;
        let opened = map.newest().await.map_err(status)?;
        let layers = layers(&opened)?;
        let with_columns = command.include_schema;
        let mut tables = command.into_builder();
        let mut names = layers.table_names();
        names.sort();
        for name in names {
            let table = TableReference::bare(name.as_str());
            let columns = match with_columns {
                true => of_table(&opened.context, table).await.map_err(status)?,
                false => Arc::new(Schema::empty()),
            };
            let added = tables.append(&map.name, TABLES, &name, TABLE, &columns);
            added.map_err(Status::from)?;
        }
        one(tables.build())
    }

    async fn get_flight_info_table_types(
        &self,
        command: CommandGetTableTypes,
        request: InfoRequest,
    ) -> Info {
        let ticket = command.as_any();
        let schema = command.into_builder().schema();
        info(&schema, ticket, request)
    }

    async fn do_get_table_types(
        &self,
        command: CommandGetTableTypes,
        _: Request<Ticket>,
    ) -> Got<Self> {
        let mut types = command.into_builder();
        types.append(TABLE);
        one(types.build())
    }

    async fn get_flight_info_sql_info(
        &self,
        command: CommandGetSqlInfo,
        request: InfoRequest,
    ) -> Info {
        let ticket = command.as_any();
        let schema = command.into_builder(about()?).schema();
        info(&schema, ticket, request)
    }

    async fn do_get_sql_info(&self, command: CommandGetSqlInfo, _: Request<Ticket>) -> Got<Self> {
        one(command.into_builder(about()?).build())
    }

    async fn register_sql_info(&self, _: i32, _: &SqlInfo) {}
}

#[cfg(test)]
mod tests;
