//! One connection: what its client sends is looked at, answered, and refused with a reason where it is no message.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;

use futures::{SinkExt, StreamExt};
use pgwire::api::cancel::DefaultCancelHandler;
use pgwire::api::{ClientInfo, ClientPortalStore, NoopHandler, PgWireConnectionState};
use pgwire::error::{ErrorInfo, PgWireError, PgWireResult};
use pgwire::messages::{PgWireBackendMessage, PgWireFrontendMessage};
use pgwire::tokio::server::{
    MaybeTls, PgWireMessageServerCodec, negotiate_tls, process_error, process_message,
};
use tokio::io::Interest;
use tokio::net::TcpStream;
use tokio_rustls::TlsAcceptor;
use tokio_util::codec::Framed;

use crate::serve::postgres::kept::make_room;
use crate::serve::postgres::startup::{Startup, is_in};
use crate::serve::postgres::wire::Checked;
use crate::serve::postgres::{Prepared, Queries};

/// What answers one connection.
pub struct Handlers {
    /// Lets its client in.
    pub startup: Arc<Startup>,
    /// Answers what its client asks.
    pub queries: Arc<Queries>,
    /// Ends queries of other connections.
    pub cancel: Arc<DefaultCancelHandler>,
}

/// A client, its messages looked at.
type Client = Framed<Checked<MaybeTls>, PgWireMessageServerCodec<Prepared>>;

impl Handlers {
    /// Answers a client until it goes, or says what ends the connection.
    ///
    /// # Errors
    /// When it is gone before it has its answer.
    pub async fn converse(self, socket: TcpStream, tls: Option<TlsAcceptor>) -> io::Result<()> {
        let Some(negotiated) = negotiate_tls::<Prepared>(socket, tls).await? else {
            return Ok(());
        };
        let is_secure = negotiated.is_secure();
        let parts = negotiated.into_parts();
        if is_secure && !parts.read_buf.is_empty() {
            // It came before the connection was private, from whoever is on the way.
            return Err(io::Error::new(
                io::ErrorKind::InvalidData,
                "expected a TLS handshake, found something before it",
            ));
        }
        let mut client = Framed::new(Checked::new(parts.io, parts.read_buf), parts.codec);
        while let Some(message) = client.next().await {
            match message {
                Ok(PgWireFrontendMessage::Terminate(_)) => break,
                Ok(message) => {
                    if self.answer(&mut client, message).await? {
                        break;
                    }
                }
                Err(error) => return refuse(&mut client, error).await,
            }
        }
        Ok(())
    }

    /// Answers a message; whether it was the last. What is answered ends with its client, as nobody reads its messages
    /// meanwhile.
    async fn answer(
        &self,
        client: &mut Client,
        message: PgWireFrontendMessage,
    ) -> io::Result<bool> {
        let is_extended = message.is_extended_query();
        let watched = may_take_long(&message).then(|| beside(client)).flatten();
        let done = tokio::select! {
            biased;
            done = self.process(client, message) => done,
            () = gone(watched) => {
                tracing::debug!("a client is gone before it has its answer");
                return Ok(true);
            }
        };
        if let Err(error) = done {
            let info = ErrorInfo::from(error);
            let is_last = info.is_fatal();
            let error = PgWireError::UserError(Box::new(info));
            process_error(client, error, is_extended).await?;
            return Ok(is_last);
        }
        if is_in(client) {
            client.get_mut().let_in();
        }
        // Who only cancels says nothing else.
        Ok(matches!(
            client.state(),
            PgWireConnectionState::AwaitingStartup
        ))
    }

    async fn process(
        &self,
        client: &mut Client,
        message: PgWireFrontendMessage,
    ) -> PgWireResult<()> {
        // After an error the library passes over what comes before the next `Sync`.
        if !matches!(client.state(), PgWireConnectionState::AwaitingSync) {
            make_room(client.session_extensions(), client.portal_store(), &message)?;
        }
        process_message(
            message,
            client,
            Arc::clone(&self.startup),
            Arc::clone(&self.queries),
            Arc::clone(&self.queries),
            Arc::new(NoopHandler),
            Arc::clone(&self.cancel),
        )
        .await
    }
}

/// Whether it is planned or run what a client asks.
fn may_take_long(message: &PgWireFrontendMessage) -> bool {
    matches!(
        message,
        PgWireFrontendMessage::Query(_)
            | PgWireFrontendMessage::Parse(_)
            | PgWireFrontendMessage::Execute(_)
    )
}

/// The socket of a client once more, to be watched while it is written to; `None` where the system has no room for it.
fn beside(client: &Client) -> Option<TcpStream> {
    match client.get_ref().stream() {
        MaybeTls::Plain(socket) => again(socket.as_fd()),
        MaybeTls::Tls(private) => again(private.get_ref().0.as_fd()),
        _ => None,
    }
}

fn again(socket: BorrowedFd<'_>) -> Option<TcpStream> {
    let socket = socket.try_clone_to_owned().ok()?;
    TcpStream::from_std(socket.into()).ok()
}

/// Ends when the client at the other end of a socket is gone, or has closed its side, whatever it sent before. Never, where
/// that cannot be watched: what it asked ends with its time then.
async fn gone(socket: Option<TcpStream>) {
    if let Some(socket) = socket {
        while let Ok(ready) = socket.ready(Interest::READABLE).await {
            if ready.is_read_closed() {
                return;
            }
            // What came is left to who reads: from here on the system tells of what comes next.
            let unread = || Err::<(), _>(io::ErrorKind::WouldBlock.into());
            let _ = socket.try_io(Interest::READABLE, unread);
        }
    }
    std::future::pending().await
}

/// Says what is wrong with a message, and closes: nobody knows where the next one begins.
async fn refuse(client: &mut Client, error: PgWireError) -> io::Result<()> {
    let message = match error {
        PgWireError::IoError(error) if error.kind() == io::ErrorKind::InvalidData => {
            error.to_string()
        }
        PgWireError::IoError(error) => return Err(error),
        other => other.to_string(),
    };
    let info = ErrorInfo::new("FATAL".to_owned(), "08P01".to_owned(), message);
    client
        .send(PgWireBackendMessage::ErrorResponse(info.into()))
        .await?;
    SinkExt::<PgWireBackendMessage>::close(client).await?;
    client.get_mut().pass_over().await;
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::time::Duration;

    use tokio::io::AsyncWriteExt;
    use tokio::net::TcpListener;
    use tokio::time::timeout;

    use super::*;

    #[tokio::test]
    async fn a_client_that_goes_is_noticed_whatever_it_sent_before() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let client = TcpStream::connect(listener.local_addr().unwrap());
        let mut client = client.await.unwrap();
        let (socket, _) = listener.accept().await.unwrap();
        let mut leaves = std::pin::pin!(gone(again(socket.as_fd())));
        let moment = Duration::from_millis(50);
        for sent in [&b""[..], b"what nobody reads", b" and more of it"] {
            client.write_all(sent).await.unwrap();
            assert!(timeout(moment, leaves.as_mut()).await.is_err(), "{sent:?}");
        }
        drop(client);
        let leaves = timeout(Duration::from_secs(60), leaves);
        assert!(leaves.await.is_ok());
        assert!(timeout(moment, gone(None)).await.is_err());
    }
}
