//! One connection: what its client sends is looked at, answered, and refused with a reason where it is no message.

use std::io;
use std::sync::Arc;

use futures::{SinkExt, StreamExt};
use pgwire::api::cancel::DefaultCancelHandler;
use pgwire::api::{ClientInfo, ClientPortalStore, NoopHandler, PgWireConnectionState};
use pgwire::error::{ErrorInfo, PgWireError, PgWireResult};
use pgwire::messages::{PgWireBackendMessage, PgWireFrontendMessage};
use pgwire::tokio::server::{
    MaybeTls, PgWireMessageServerCodec, negotiate_tls, process_error, process_message,
};
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

    /// Answers a message; whether it was the last.
    async fn answer(
        &self,
        client: &mut Client,
        message: PgWireFrontendMessage,
    ) -> io::Result<bool> {
        let is_extended = message.is_extended_query();
        if let Err(error) = self.process(client, message).await {
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
