//! A listener whose connections are private. Handshakes go on side by side: one that hangs holds no other up.

use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use axum::serve::Listener;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::mpsc;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::server::TlsStream;

/// Time that a handshake may take.
const HANDSHAKE: Duration = Duration::from_secs(10);

/// Connections that have shaken hands, and wait.
const WAITING: usize = 64;

/// A connection with TLS.
type Private = (TlsStream<TcpStream>, SocketAddr);

/// A listener whose connections are private.
pub struct PrivateListener {
    address: SocketAddr,
    shaken: mpsc::Receiver<Private>,
}

impl PrivateListener {
    /// Has the connections of a listener shake hands.
    ///
    /// # Errors
    /// When the listener has no address.
    pub fn new(listener: TcpListener, acceptor: TlsAcceptor) -> io::Result<Self> {
        let address = listener.local_addr()?;
        let (shake, shaken) = mpsc::channel(WAITING);
        tokio::spawn(accept(listener, acceptor, shake));
        Ok(Self { address, shaken })
    }
}

async fn accept(listener: TcpListener, acceptor: TlsAcceptor, shake: mpsc::Sender<Private>) {
    while !shake.is_closed() {
        let Ok((socket, from)) = listener.accept().await else {
            tokio::time::sleep(Duration::from_millis(100)).await;
            continue;
        };
        let (acceptor, shake) = (acceptor.clone(), shake.clone());
        tokio::spawn(async move {
            let shaken = tokio::time::timeout(HANDSHAKE, acceptor.accept(socket)).await;
            if let Ok(Ok(stream)) = shaken {
                let _ = shake.send((stream, from)).await;
            }
        });
    }
}

impl Listener for PrivateListener {
    type Io = TlsStream<TcpStream>;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> Private {
        match self.shaken.recv().await {
            Some(private) => private,
            // What accepts ends with this listener, never before.
            None => std::future::pending().await,
        }
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        Ok(self.address)
    }
}
