//! How a client of Postgres comes in.

use std::fmt::Debug;
use std::sync::Arc;

use async_trait::async_trait;
use evermap_schemas::Fault;
use futures::Sink;
use pgwire::api::auth::noop::NoopStartupHandler;
use pgwire::api::auth::sasl::SASLAuthStartupHandler;
use pgwire::api::auth::sasl::scram::ScramAuth;
use pgwire::api::auth::{DefaultServerParameterProvider, StartupHandler};
use pgwire::api::{ClientInfo, ConnectionManager, PgWireConnectionState};
use pgwire::error::{ErrorInfo, PgWireError, PgWireResult};
use pgwire::messages::{PgWireBackendMessage, PgWireFrontendMessage};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use crate::serve::access::Access;
use crate::serve::patience::RequestSignal;
use crate::serve::postgres::error;

/// Lets one client in: with a password by SCRAM where there are users, as it is where everybody may come in.
pub struct Startup {
    by: By,
    access: Access,
    /// Of clients that are in.
    places: Arc<Semaphore>,
    asked: RequestSignal,
    /// Why there is no place for the client.
    refused: Option<Fault>,
}

enum By {
    Anybody(Anybody),
    Password(SASLAuthStartupHandler<DefaultServerParameterProvider>),
}

struct Anybody(Arc<ConnectionManager>);

impl NoopStartupHandler for Anybody {
    fn connection_manager(&self) -> Option<Arc<ConnectionManager>> {
        Some(Arc::clone(&self.0))
    }
}

/// That a client was let in, and its place. The library tells by the state of a connection, which an error changes as
/// well.
struct In {
    _place: OwnedSemaphorePermit,
}

/// Whether the client was let in.
pub fn is_in<C: ClientInfo>(client: &C) -> bool {
    client.session_extensions().get::<In>().is_some()
}

impl Startup {
    /// For one connection, which takes one of the places when its client is in, or is refused for this reason.
    pub fn new(
        access: &Access,
        manager: Arc<ConnectionManager>,
        places: Arc<Semaphore>,
        asked: RequestSignal,
        refused: Option<Fault>,
    ) -> Self {
        let by = match access.users() {
            None => By::Anybody(Anybody(manager)),
            Some(users) => {
                let parameters = Arc::new(DefaultServerParameterProvider::default());
                let handler = SASLAuthStartupHandler::new(parameters);
                let handler = handler.with_scram(ScramAuth::new(users));
                By::Password(handler.with_connection_manager(manager))
            }
        };
        Self {
            by,
            access: access.clone(),
            places,
            asked,
            refused,
        }
    }
}

#[async_trait]
impl StartupHandler for Startup {
    async fn on_startup<C>(
        &self,
        client: &mut C,
        message: PgWireFrontendMessage,
    ) -> PgWireResult<()>
    where
        C: ClientInfo + Sink<PgWireBackendMessage> + Unpin + Send + Sync,
        C::Error: Debug,
        PgWireError: From<<C as Sink<PgWireBackendMessage>>::Error>,
    {
        if self.access.needs_tls() && !client.is_secure() {
            return Err(error(
                "FATAL",
                "28000",
                "expected TLS: connect with sslmode=require",
            ));
        }
        if let Some(fault) = &self.refused {
            return Err(full(fault));
        }
        let done = match &self.by {
            By::Anybody(handler) => handler.on_startup(client, message).await,
            By::Password(handler) => {
                let done = handler.on_startup(client, message).await;
                if done.is_err() {
                    self.access.hold_up().await;
                }
                done
            }
        };
        done.map_err(fatal)?;
        if matches!(client.state(), PgWireConnectionState::ReadyForQuery) {
            let place = Arc::clone(&self.places).try_acquire_owned();
            let all = |_| error("FATAL", "53300", "too many connections; try again later");
            let _place = place.map_err(all)?;
            client.session_extensions().insert(In { _place });
            self.asked.now();
        }
        Ok(())
    }
}

/// That there is no place for a client.
fn full(fault: &Fault) -> PgWireError {
    let (severity, code) = ("FATAL".to_owned(), "53300".to_owned());
    let mut info = ErrorInfo::new(severity, code, fault.message.clone());
    info.hint = Some(fault.next.clone());
    PgWireError::UserError(Box::new(info))
}

/// Whatever goes wrong before a client is in ends the connection.
fn fatal(error: PgWireError) -> PgWireError {
    let mut info = ErrorInfo::from(error);
    info.severity = "FATAL".to_owned();
    PgWireError::UserError(Box::new(info))
}
