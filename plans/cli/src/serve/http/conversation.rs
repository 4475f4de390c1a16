//! One connection: requests are heard, answers given, until its client goes, or nothing moves any longer.

use axum::{BoxError, Router};
use futures::TryFutureExt;
use hyper::body::Incoming;
use hyper::service::{Service, service_fn};
use hyper_util::rt::{TokioExecutor, TokioIo};
use hyper_util::server::conn::auto::Builder;
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio_rustls::TlsAcceptor;

use crate::serve::http::given::Given;
use crate::serve::http::heard::Heard;
use crate::serve::patience::{Asked, Exchanges};

/// Shakes hands, where connections are private, and answers until the client goes, or is sent away.
///
/// # Errors
/// What ends a connection before its time.
pub async fn converse(
    socket: TcpStream,
    tls: Option<TlsAcceptor>,
    router: Router,
    asked: Asked,
    exchanges: Exchanges,
) -> Result<(), BoxError> {
    match tls {
        None => answered(socket, router, asked, exchanges).await,
        Some(tls) => answered(tls.accept(socket).await?, router, asked, exchanges).await,
    }
}

async fn answered<I: AsyncRead + AsyncWrite + Unpin + Send + 'static>(
    io: I,
    router: Router,
    asked: Asked,
    exchanges: Exchanges,
) -> Result<(), BoxError> {
    let builder = Builder::new(TokioExecutor::new());
    let answers = TowerToHyperService::new(router);
    let begun = exchanges.clone();
    let service = service_fn(move |request: axum::http::Request<Incoming>| {
        let (asked, exchange) = (asked.clone(), begun.begin());
        let answer = answers.call(request.map(|body| Heard::new(body, asked)));
        answer.map_ok(|answer| answer.map(|body| Given::new(body, exchange)))
    });
    let connection = builder.serve_connection_with_upgrades(TokioIo::new(io), service);
    let connection = std::pin::pin!(connection);
    let ended = exchanges.until_rest(connection, |connection| connection.graceful_shutdown());
    // What had to be dropped has nothing to say.
    ended.await.unwrap_or(Ok(()))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::time::{Duration, Instant};

    use axum::routing::get;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};

    use super::*;

    /// How HTTP/2 begins: the preface, and settings that are as usual.
    const HELLO: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0";

    const IDLE: Duration = Duration::from_millis(300);

    /// All that is sent to a client who says this, takes what comes, and says nothing more; and how long it stays.
    async fn asks_once(message: &[u8]) -> (Vec<u8>, Duration) {
        let late = || async {
            tokio::time::sleep(4 * IDLE).await;
            "late"
        };
        let router = Router::new()
            .route("/", get(|| async { "soon" }))
            .route("/l", get(late))
            .route("/m", get(|| async { vec![0_u8; 1 << 20] }));
        let (mut client, server) = tokio::io::duplex(1 << 20);
        let exchanges = Exchanges::resting(IDLE, 6 * IDLE);
        tokio::spawn(answered(server, router, Asked::default(), exchanges));
        let begun = Instant::now();
        client.write_all(message).await.unwrap();
        let mut given = Vec::new();
        let end = tokio::time::timeout(Duration::from_secs(30), client.read_to_end(&mut given));
        // A server that goes while something is left to be read says so.
        let _ = end.await.unwrap();
        (given, begun.elapsed())
    }

    /// A request by HTTP/2, whole: `GET` of `http://a` with a path, by the numbers that HPACK has for these.
    fn by_http2(path: &str) -> Vec<u8> {
        let mut fields = vec![0x82, 0x86, 0x41, 1, b'a', 0x44];
        fields.push(u8::try_from(path.len()).unwrap());
        fields.extend(path.as_bytes());
        let size = u8::try_from(fields.len()).unwrap();
        let head = [0, 0, size, 1, 5, 0, 0, 0, 1];
        [HELLO, &head, &fields].concat()
    }

    fn has(given: &[u8], text: &[u8]) -> bool {
        given.windows(text.len()).any(|window| window == text)
    }

    #[tokio::test]
    async fn who_asked_once_does_not_stay_for_ever() {
        let (given, stayed) = asks_once(&by_http2("/")).await;
        assert!(has(&given, b"soon"), "{given:?}");
        assert!(stayed >= IDLE);
        let by_http1 = b"GET / HTTP/1.1\r\nHost: a\r\n\r\n";
        let (given, stayed) = asks_once(by_http1).await;
        assert!(has(&given, b"soon"), "{given:?}");
        assert!(stayed >= IDLE);
        let half = b"GET / HTTP/1.1\r\nHost: a\r\n\r\nGET / HTTP/1.1\r\nHo";
        assert!(has(&asks_once(half).await.0, b"soon"));
    }

    #[tokio::test]
    async fn who_waits_for_an_answer_is_not_sent_away() {
        assert!(has(&asks_once(&by_http2("/l")).await.0, b"late"));
        let by_http1 = b"GET /l HTTP/1.1\r\nHost: a\r\n\r\n";
        assert!(has(&asks_once(by_http1).await.0, b"late"));
    }

    /// Without a word that there is room for more, 64 KiB of an answer are sent by HTTP/2.
    #[tokio::test]
    async fn an_answer_that_nobody_takes_does_not_stay_for_ever() {
        let (given, stayed) = asks_once(&by_http2("/m")).await;
        assert!(given.len() < 1 << 17, "{}", given.len());
        assert!(stayed >= 7 * IDLE, "{stayed:?}");
    }
}
