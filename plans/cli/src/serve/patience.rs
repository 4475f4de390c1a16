//! Connections that come and ask for nothing, or never end to ask: they hold nobody else up.

use std::fmt::Display;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{Notify, OwnedSemaphorePermit};
use tokio::time::timeout;

/// Time until a connection must have asked for something, or come in.
const PATIENCE: Duration = Duration::from_secs(10);

/// Connections at once that have not come in yet, or that speak HTTP; more are closed.
pub const WAITING: usize = 2048;

/// Has a connection answered beside others, in its place among those that wait; one that asks for nothing is ended.
pub fn attend<E: Display>(
    place: OwnedSemaphorePermit,
    asked: Asked,
    connection: impl Future<Output = Result<(), E>> + Send + 'static,
) {
    tokio::spawn(async move {
        if let Some(Err(error)) = asked.within(PATIENCE, connection).await {
            tracing::debug!("a connection ended: {error}");
        }
        drop(place);
    });
}

/// That a connection has asked for something.
#[derive(Debug, Clone, Default)]
pub struct Asked(Arc<Notify>);

impl Asked {
    /// It has.
    pub fn now(&self) {
        self.0.notify_one();
    }

    /// What a connection ends with; `None` where it is ended, as it has asked for nothing in time.
    async fn within<T>(self, time: Duration, connection: impl Future<Output = T>) -> Option<T> {
        let mut connection = std::pin::pin!(connection);
        tokio::select! {
            done = &mut connection => return Some(done),
            asked = timeout(time, self.0.notified()) => asked.ok()?,
        }
        Some(connection.await)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn who_asks_in_time_may_take_longer_and_who_does_not_is_sent_away() {
        let (short, long) = (Duration::from_millis(20), Duration::from_millis(60));
        let silent = Asked::default().within(short, tokio::time::sleep(10 * long));
        assert!(silent.await.is_none());
        let asked = Asked::default();
        let asks = asked.clone();
        let connection = async move {
            asks.now();
            tokio::time::sleep(long).await;
        };
        assert!(asked.within(short, connection).await.is_some());
    }
}
