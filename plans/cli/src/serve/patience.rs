//! Connections that come and ask for nothing, or never end to ask, and queries that compute without a pause: they hold nobody else
//! up.

use std::fmt::Display;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use evermap_schemas::Fault;
use tokio::net::{TcpListener, TcpStream};
use tokio::runtime::Handle;
use tokio::sync::{Notify, Semaphore, watch};
use tokio::time::timeout;

use crate::serve::permits::{Full, Permit, Permits};

/// Time until a connection must have asked for something, or come in; and for what it asks to be there whole.
pub const PATIENCE: Duration = Duration::from_secs(10);

/// Time that a connection may be idle after an answer, or take to say what it wants next.
const IDLE: Duration = Duration::from_secs(60);

/// How much longer it may take to tell a connection that it took too long, or that there is no permit for it.
pub const TOLD: Duration = Duration::from_secs(1);

/// Connections at once that are told why there is no permit for them.
const REFUSED: usize = 16;

/// Connections at once that wait, where as many files may be open.
const WAITING: usize = 2048;

/// The part of the files that this process may have open: HTTP and Postgres take one each, and clients that are in, maps and logs
/// need the rest.
const PART: usize = 3;

/// How long nothing may be heard of a client's machine until it is asked whether it is there: one that is switched off says no
/// word of it, and would keep its place for ever.
const QUIET: Duration = Duration::from_secs(60);

/// How often it is asked then.
const ASKED_EVERY: Duration = Duration::from_secs(10);

/// How many times without an answer.
const ASKED_TIMES: u32 = 6;

/// How long network and clocks may be left alone by threads that compute.
const ATTENDED_EVERY: Duration = Duration::from_millis(50);

/// Takes connections for ever, and has each answered under a permit of its own; where there is none, it is closed. What
/// answers one is told if it has none because its address has enough: it says so.
pub async fn accept<C, E>(
    listener: TcpListener,
    permits: Permits,
    converse: impl Fn(TcpStream, RequestSignal, Option<Fault>) -> C,
) where
    C: Future<Output = Result<(), E>> + Send + 'static,
    E: Display,
{
    let refused = Arc::new(Semaphore::new(REFUSED));
    loop {
        let Ok((socket, address)) = listener.accept().await else {
            // Out of file descriptors, mostly: those that are open may be closed by then.
            tokio::time::sleep(Duration::from_millis(100)).await;
            continue;
        };
        match permits.take(address.ip()) {
            Ok(permit) => {
                if let Err(error) = notice_when_gone(&socket) {
                    tracing::debug!(
                        "cannot set keep-alive, so a client that vanishes is not noticed: {error}"
                    );
                }
                let asked = RequestSignal::default();
                attend(permit, asked.clone(), converse(socket, asked, None));
            }
            Err(Full::Address(fault)) => {
                tracing::debug!("a connection is refused: {fault}");
                if let Ok(turn) = Arc::clone(&refused).try_acquire_owned() {
                    let told = converse(socket, RequestSignal::default(), Some(fault));
                    tokio::spawn(async move {
                        let _ = timeout(PATIENCE, told).await;
                        drop(turn);
                    });
                }
            }
            Err(Full::All) => {}
        }
    }
}

/// Has the system ask whether a client's machine is there, and end the connection where it is not.
fn notice_when_gone(socket: &TcpStream) -> rustix::io::Result<()> {
    use rustix::net::sockopt;
    sockopt::set_tcp_keepidle(socket, QUIET)?;
    sockopt::set_tcp_keepintvl(socket, ASKED_EVERY)?;
    sockopt::set_tcp_keepcnt(socket, ASKED_TIMES)?;
    sockopt::set_socket_keepalive(socket, true)
}

/// Connections at once of one protocol that have not come in yet, or that speak HTTP; more are closed. Fewer than files may be open,
/// so that there is one for who comes when they are gone, and for what is asked.
pub fn waiting() -> usize {
    let files = rustix::process::getrlimit(rustix::process::Resource::Nofile).current;
    waiting_of(files)
}

fn waiting_of(files: Option<u64>) -> usize {
    let files = files.and_then(|files| usize::try_from(files).ok());
    files.map_or(WAITING, |files| (files / PART).clamp(1, WAITING))
}

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
fn attend<E: Display>(
    permit: Permit,
    asked: RequestSignal,
    connection: impl Future<Output = Result<(), E>> + Send + 'static,
) {
    tokio::spawn(async move {
        if let Some(Err(error)) = asked.within(PATIENCE + TOLD, connection).await {
            tracing::debug!("a connection ended: {error}");
        }
        drop(permit);
    });
}

/// That a connection has asked for something.
#[derive(Debug, Clone, Default)]
pub struct RequestSignal(Arc<Notify>);

impl RequestSignal {
    /// It has.
    pub fn now(&self) {
        self.0.notify_one();
    }

    /// What a connection ends with; `None` where it is ended, as it has asked for nothing in time.
    pub async fn within<T>(self, time: Duration, connection: impl Future<Output = T>) -> Option<T> {
        let mut connection = std::pin::pin!(connection);
        tokio::select! {
            done = &mut connection => return Some(done),
            asked = timeout(time, self.0.notified()) => asked.ok()?,
        }
        Some(connection.await)
    }
}

/// What a connection asks and is answered. Where nothing of that moves, it is at rest, in the place of others.
#[derive(Debug, Clone)]
pub struct Exchanges {
    /// So many are open; noted when one begins, moves or ends.
    open: Arc<watch::Sender<usize>>,
    idle: Duration,
    longest: Duration,
}

impl Exchanges {
    /// None yet. Until an answer is there, and again until all of it is taken, may take so long.
    pub fn new(longest: Duration) -> Self {
        Self::resting(IDLE, longest)
    }

    /// The same with another time to be idle.
    pub fn resting(idle: Duration, longest: Duration) -> Self {
        let open = Arc::new(watch::Sender::new(0));
        Self {
            open,
            idle,
            longest,
        }
    }

    /// One more.
    pub fn begin(&self) -> Exchange {
        self.open.send_modify(|open| *open += 1);
        Exchange(Arc::clone(&self.open))
    }

    /// What a connection ends with. One at rest is told that its `end` has come, so that what is asked meanwhile is answered still;
    /// `None` where it rests on.
    pub async fn until_rest<C: Future>(
        &self,
        mut connection: Pin<&mut C>,
        end: impl FnOnce(Pin<&mut C>),
    ) -> Option<C::Output> {
        tokio::select! {
            ended = connection.as_mut() => return Some(ended),
            () = self.rest(self.idle) => {}
        }
        end(connection.as_mut());
        tokio::select! {
            ended = connection => Some(ended),
            () = self.rest(TOLD) => None,
        }
    }

    /// Ends when nothing moved for a time, and for so much longer as an answer may take where one is open: by then nobody takes it.
    async fn rest(&self, idle: Duration) {
        let mut moved = self.open.subscribe();
        loop {
            let open = *moved.borrow_and_update();
            let longest = if open == 0 { idle } else { idle + self.longest };
            if timeout(longest, moved.changed()).await.is_err() {
                return;
            }
        }
    }
}

/// What was asked and is not answered to its end.
#[derive(Debug)]
pub struct Exchange(Arc<watch::Sender<usize>>);

impl Exchange {
    /// Some of the answer is taken.
    pub fn moves(&self) {
        self.0.send_modify(|_| {});
    }
}

impl Drop for Exchange {
    fn drop(&mut self) {
        self.0.send_modify(|open| *open -= 1);
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
    #[allow(clippy::unwrap_used)]
    async fn clients_that_go_without_a_word_are_noticed() {
        use rustix::net::sockopt;
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let client = TcpStream::connect(listener.local_addr().unwrap());
        let _client = client.await.unwrap();
        let (socket, _) = listener.accept().await.unwrap();
        assert!(!sockopt::socket_keepalive(&socket).unwrap());
        notice_when_gone(&socket).unwrap();
        assert!(sockopt::socket_keepalive(&socket).unwrap());
        assert_eq!(sockopt::tcp_keepidle(&socket).unwrap(), QUIET);
        assert_eq!(sockopt::tcp_keepintvl(&socket).unwrap(), ASKED_EVERY);
    }

    #[test]
    fn fewer_connections_wait_than_files_may_be_open() {
        assert_eq!(waiting_of(None), WAITING);
        assert_eq!(waiting_of(Some(u64::MAX)), WAITING);
        assert_eq!(waiting_of(Some(1024)), 341);
        assert_eq!(waiting_of(Some(2)), 1);
    }

    #[tokio::test]
    async fn who_asks_in_time_may_take_longer_and_who_does_not_is_sent_away() {
        let (short, long) = (Duration::from_millis(20), Duration::from_millis(60));
        let silent = RequestSignal::default().within(short, tokio::time::sleep(10 * long));
        assert!(silent.await.is_none());
        let asked = RequestSignal::default();
        let asks = asked.clone();
        let connection = async move {
            asks.now();
            tokio::time::sleep(long).await;
        };
        assert!(asked.within(short, connection).await.is_some());
    }
}
