//! Connections that come and ask for nothing, or never end to ask, and queries that compute without a pause: they hold nobody else
//! up.

use std::fmt::Display;
use std::sync::Arc;
use std::time::Duration;

use tokio::runtime::Handle;
use tokio::sync::{Notify, OwnedSemaphorePermit};
use tokio::time::timeout;

/// Time until a connection must have asked for something, or come in.
const PATIENCE: Duration = Duration::from_secs(10);

/// Connections at once that have not come in yet, or that speak HTTP; more are closed.
pub const WAITING: usize = 2048;

/// How long network and clocks may be left alone by threads that compute.
const ATTENDED_EVERY: Duration = Duration::from_millis(50);

/// Sees to it that a thread of the runtime waits for the network and for the time, as long as the runtime is there. The last one
/// that did may have got work without a pause, and wakes none of the others to take its place: then nothing that comes is heard,
/// and no deadline comes. A task from outside wakes one, which does before it sleeps.
///
/// # Errors
/// When there is no thread to be had.
pub fn keep_attending(runtime: Handle) -> std::io::Result<()> {
    let attended = Arc::new(());
    let ended = Arc::downgrade(&attended);
    // Dropped with the runtime.
    runtime.spawn(async move {
        let _attended = attended;
        std::future::pending::<()>().await;
    });
    let wake = move || {
        while ended.strong_count() > 0 {
            std::thread::sleep(ATTENDED_EVERY);
            runtime.spawn(async {});
        }
    };
    let thread = std::thread::Builder::new().name("attending".to_owned());
    thread.spawn(wake).map(drop)
}

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

    /// A thread that waits for the network gets a message, and computes from then on; a deadline comes all the same.
    #[test]
    #[allow(clippy::unwrap_used)]
    fn deadlines_come_while_others_compute() {
        use std::sync::atomic::{AtomicBool, Ordering};
        let mut threads = tokio::runtime::Builder::new_multi_thread();
        let runtime = threads.worker_threads(2).enable_all().build().unwrap();
        keep_attending(runtime.handle().clone()).unwrap();
        let computed = Arc::new(AtomicBool::new(false));
        let deadline = runtime.spawn({
            let computed = Arc::clone(&computed);
            async move {
                tokio::time::sleep(4 * ATTENDED_EVERY).await;
                !computed.load(Ordering::SeqCst)
            }
        });
        let socket = runtime.block_on(tokio::net::UdpSocket::bind("127.0.0.1:0"));
        let socket = socket.unwrap();
        let address = socket.local_addr().unwrap();
        runtime.spawn(async move {
            let _ = socket.recv(&mut [0]).await;
            std::thread::sleep(40 * ATTENDED_EVERY);
            computed.store(true, Ordering::SeqCst);
        });
        std::thread::sleep(ATTENDED_EVERY);
        let sender = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
        sender.send_to(&[1], address).unwrap();
        let came_in_time = std::thread::spawn(move || runtime.block_on(deadline).unwrap());
        assert!(came_in_time.join().unwrap());
    }

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
