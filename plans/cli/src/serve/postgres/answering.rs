//! How rows get to a client: within bounds, as they come, until it cancels.

use std::sync::Arc;

use futures::future::{BoxFuture, Shared};
use futures::stream::BoxStream;
use futures::{FutureExt, Sink, SinkExt, StreamExt, TryStreamExt};
use pgwire::api::results::{QueryResponse, Response, Tag};
use pgwire::api::{ClientInfo, ConnectionHandle};
use pgwire::error::{PgWireError, PgWireResult};
use pgwire::messages::PgWireBackendMessage;
use pgwire::messages::data::DataRow;

use crate::serve::answer::{Size, Turn};
use crate::serve::postgres::reading::fault_in_our_words;
use crate::serve::postgres::{error, said};

/// Rows that are handed on together: each by itself would cost more on its way than to make.
pub const ROWS_AT_ONCE: usize = 32;

/// Rows of a part of an answer at most: the library makes room for them before there is one.
const ROWS_OF_A_PART: u32 = 1 << 20;

/// Ends when a client cancels what it asked; never, where it asked for something else meanwhile.
pub type Cancelled = Shared<BoxFuture<'static, ()>>;

/// What ends when the client cancels. The library listens until an answer begins; from then on this does.
pub async fn cancelled<C: ClientInfo>(client: &C) -> Cancelled {
    let connection = client.session_extensions().get::<Arc<ConnectionHandle>>();
    let receiver = match connection {
        Some(connection) => Some(connection.start_query().await),
        None => None,
    };
    let wait = async move {
        if let Some(receiver) = receiver
            && receiver.await.is_ok()
        {
            return;
        }
        std::future::pending().await
    };
    wait.boxed().shared()
}

/// What never ends.
pub fn never() -> Cancelled {
    std::future::pending().boxed().shared()
}

/// A response whose rows end when time or number are used up, or the client cancels.
pub fn bounded(response: Response, turn: &Arc<Turn>, cancelled: &Cancelled) -> Response {
    match response {
        Response::Query(query) => {
            let QueryResponse {
                command_tag,
                row_schema,
                data_rows,
                ..
            } = query;
            let turn = Arc::clone(turn);
            let data_rows = data_rows.map_err(fault_in_our_words);
            let rows = turn.bounded(data_rows, ROWS_AT_ONCE, size, |fault| said(&fault));
            let state = Some((rows, cancelled.clone()));
            let next = |state: Option<(BoxStream<'static, _>, Cancelled)>| async move {
                let (mut rows, cancelled) = state?;
                tokio::select! {
                    row = rows.next() => row.map(|row| (row, Some((rows, cancelled)))),
                    () = cancelled.clone() => Some((Err(PgWireError::QueryCanceled), None)),
                }
            };
            let rows = futures::stream::unfold(state, next);
            let mut bounded = QueryResponse::new(row_schema, rows);
            bounded.set_command_tag(&command_tag);
            Response::Query(bounded)
        }
        other => other,
    }
}

fn size(row: &DataRow) -> Size {
    Size {
        rows: 1,
        bytes: row.data.len(),
    }
}

/// Hands all rows of an answer on as they come: the library would hold them all before it sends the first.
///
/// # Errors
/// What ends the rows, or the connection.
pub async fn all_rows<C>(client: &mut C, mut answer: QueryResponse) -> PgWireResult<Tag>
where
    C: Sink<PgWireBackendMessage> + Unpin + Send,
    PgWireError: From<<C as Sink<PgWireBackendMessage>>::Error>,
{
    let mut count = 0;
    while let Some(row) = answer.data_rows().next().await {
        client.feed(PgWireBackendMessage::DataRow(row?)).await?;
        count += 1;
    }
    Ok(Tag::new(answer.command_tag()).with_rows(count))
}

/// Rows that a client wants at once, 0 for all. An answer has at most `most`, so who wants more wants all.
///
/// # Errors
/// For so many that there might be no room for them.
pub fn rows_wanted(rows: i32, most: u64) -> PgWireResult<i32> {
    match u32::try_from(rows) {
        Err(_) => Ok(0),
        Ok(wanted) if u64::from(wanted) > most => Ok(0),
        Ok(wanted) if wanted > ROWS_OF_A_PART => {
            let message =
                format!("expected to fetch at most {ROWS_OF_A_PART} rows at once, found {wanted}");
            Err(error("ERROR", "54000", &message))
        }
        Ok(_) => Ok(rows),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn who_wants_more_rows_than_there_may_be_wants_all_and_nobody_makes_room_for_billions() {
        assert_eq!(rows_wanted(0, 100).unwrap(), 0);
        assert_eq!(rows_wanted(-1, 100).unwrap(), 0);
        assert_eq!(rows_wanted(100, 100).unwrap(), 100);
        assert_eq!(rows_wanted(101, 100).unwrap(), 0);
        assert_eq!(rows_wanted(i32::MAX, 10_000_000).unwrap(), 0);
        let refused = rows_wanted(i32::MAX, u64::MAX).unwrap_err().to_string();
        assert!(
            refused.contains("at most 1048576 rows at once"),
            "{refused}"
        );
    }
}
