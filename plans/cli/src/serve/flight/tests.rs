#![allow(clippy::unwrap_used)]
use std::time::Duration;

use arrow::datatypes::DataType;
use arrow_flight::decode::FlightRecordBatchStream;
use datafusion::execution::memory_pool::UnboundedMemoryPool;
use tokio::sync::Semaphore;

use super::*;
use crate::serve::maps::tests::{publish, served};

async fn flight(map: &std::path::Path) -> Flight {
    let bounds = Bounds {
        timeout: Duration::from_secs(60),
        rows: 100,
        queries: Arc::new(Semaphore::new(1)),
        memory: Arc::new(UnboundedMemoryPool::default()),
    };
    let maps = served(map).await;
    Flight { maps, bounds }
}

#[tokio::test]
async fn a_statement_that_is_prepared_once_reads_the_newest_version_each_time() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map");
    publish(&map, 1, "").await;
    let flight = flight(&map).await;
    let command = ActionCreatePreparedStatementRequest {
        query: "SELECT max(version) AS newest FROM versions".to_owned(),
        transaction_id: None,
    };
    let asked = Request::new(Action::default());
    let prepared = flight.do_action_create_prepared_statement(command, asked);
    let handle = prepared.await.unwrap().prepared_statement_handle;
    for version in [1, 2] {
        if version > 1 {
            publish(&map, version, "").await;
        }
        let command = CommandPreparedStatementQuery {
            prepared_statement_handle: handle.clone(),
        };
        let asked = Request::new(FlightDescriptor::default());
        let info = flight.get_flight_info_prepared_statement(command, asked);
        let info = info.await.unwrap().into_inner();
        let ticket = info.endpoint[0].ticket.clone().unwrap();
        let ticket = Any::decode(&*ticket.ticket).unwrap();
        let ticket: TicketStatementQuery = ticket.unpack().unwrap().unwrap();
        let planned = Planned::parse(&ticket.statement_handle).unwrap();
        assert_eq!(planned.version, version);
    }
}

#[tokio::test]
async fn rows_have_the_columns_that_were_told_large_lists_too() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map");
    publish(&map, 1, "").await;
    let flight = flight(&map).await;
    let served = flight.maps.only().unwrap();
    let query = "SELECT arrow_cast([1, 2], 'LargeList(Int64)') AS large, named_struct('of', arrow_cast([3], 'LargeList(Int64)')) AS member, arrow_cast('a', 'Dictionary(Int32, Utf8)') AS word";
    let (planned, told) = flight.plan(served, query.to_owned()).await.unwrap();
    let kinds = told.fields().iter().map(|field| field.data_type());
    let kinds: Vec<&DataType> = kinds.collect();
    assert!(matches!(kinds[0], DataType::List(_)), "{kinds:?}");
    assert_eq!(kinds[2], &DataType::Utf8);
    let rows = flight.rows(served, &planned).await.unwrap().into_inner();
    let rows = rows.map_err(|error| FlightError::Tonic(Box::new(error)));
    let rows = FlightRecordBatchStream::new_from_flight_data(rows);
    let batches: Vec<RecordBatch> = rows.try_collect().await.unwrap();
    assert_eq!(batches.len(), 1);
    assert_eq!(batches[0].schema(), told);
    let large = arrow::util::display::array_value_to_string(batches[0].column(0), 0);
    assert_eq!(large.unwrap(), "[1, 2]");
}
