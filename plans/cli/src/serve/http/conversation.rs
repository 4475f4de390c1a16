//! One connection: requests are heard, answers given, until its client goes, or nothing moves any longer.

use axum::http::Request;
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

use crate::serve::access::Access;
use crate::serve::http::answer_body::AnswerBody;
use crate::serve::http::request_body::RequestBody;
use crate::serve::http::who;
use crate::serve::patience::{Exchanges, RequestSignal};

/// Bytes of the head of a request beyond which no more are awaited, by HTTP/1: a query in an address fits. By HTTP/2 it is 16 KiB.
const HEAD: usize = 128 << 10;

/// What all connections lead to.
#[derive(Clone)]
pub struct Door {
    /// What makes them private.
    pub tls: Option<TlsAcceptor>,
    /// Who may come in.
    pub access: Access,
    /// What answers.
    pub router: Router,
}

/// Shakes hands, where connections are private, and answers until the client goes, or is sent away.
///
/// # Errors
/// What ends a connection before its time.
pub async fn converse(
    socket: TcpStream,
    door: Door,
    asked: RequestSignal,
    exchanges: Exchanges,
) -> Result<(), BoxError> {
    let Door {
        tls,
        access,
        router,
    } = door;
    let may_come_in = move |request: &Request<Incoming>| who(&access, request).is_some();
    match tls {
        None => answered(socket, router, may_come_in, asked, exchanges).await,
        Some(tls) => {
            let private = tls.accept(socket).await?;
            answered(private, router, may_come_in, asked, exchanges).await
        }
    }
}

async fn answered<I: AsyncRead + AsyncWrite + Unpin + Send + 'static>(
    io: I,
    router: Router,
    may_come_in: impl Fn(&Request<Incoming>) -> bool + Send + Sync + 'static,
    asked: RequestSignal,
    exchanges: Exchanges,
) -> Result<(), BoxError> {
    let mut builder = Builder::new(TokioExecutor::new());
    builder.http1().max_buf_size(HEAD);
    let answers = TowerToHyperService::new(router);
    let begun = exchanges.clone();
    let service = service_fn(move |request: Request<Incoming>| {
        // Who may not come in has asked for nothing, and does not stay longer than who says nothing.
        let asked = match may_come_in(&request) {
            true => asked.clone(),
            false => RequestSignal::default(),
        };
        let exchange = begun.begin();
        let answer = answers.call(request.map(|body| RequestBody::new(body, asked)));
        answer.map_ok(|answer| answer.map(|body| AnswerBody::new(body, exchange)))
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
        let all = |_: &Request<Incoming>| true;
        tokio::spawn(answered(
            server,
            router,
            all,
            RequestSignal::default(),
            exchanges,
        ));
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

    #[tokio::test]
    async fn a_head_without_an_end_is_not_kept() {
        let head = |letters: usize| {
            let address = "a".repeat(60_000);
            let more = "b".repeat(letters);
            format!("GET /?{address} HTTP/1.1\r\nHost: a\r\nMore: {more}\r\n\r\n")
        };
        let (given, _) = asks_once(head(1000).as_bytes()).await;
        assert!(has(&given, b"soon"), "{given:?}");
        let (given, _) = asks_once(head(3 * HEAD).as_bytes()).await;
        assert!(has(&given, b" 431 "), "{given:?}");
    }

    /// However often it asks.
    #[tokio::test]
    async fn who_may_not_come_in_does_not_stay() {
        for (comes_in, stays) in [(true, true), (false, false)] {
            let router = Router::new().route("/", get(|| async { "answered" }));
            let (mut client, server) = tokio::io::duplex(1 << 20);
            let asked = RequestSignal::default();
            let exchanges = Exchanges::resting(20 * IDLE, 20 * IDLE);
            let may = move |_: &Request<Incoming>| comes_in;
            let connection = answered(server, router, may, asked.clone(), exchanges);
            let connection = tokio::spawn(asked.within(4 * IDLE, connection));
            let mut given = [0; 12];
            for _ in 0..2 {
                let asks = b"GET / HTTP/1.1\r\nHost: a\r\n\r\n";
                client.write_all(asks).await.unwrap();
                client.read_exact(&mut given).await.unwrap();
                assert_eq!(&given, b"HTTP/1.1 200");
                tokio::time::sleep(IDLE / 4).await;
                // The rest of the answer, however much has come.
                let mut rest = [0; 1 << 12];
                let _ = client.read(&mut rest).await.unwrap();
            }
            tokio::time::sleep(5 * IDLE).await;
            assert_eq!(!connection.is_finished(), stays);
        }
    }

    /// Without a word that there is room for more, 64 KiB of an answer are sent by HTTP/2.
    #[tokio::test]
    async fn an_answer_that_nobody_takes_does_not_stay_for_ever() {
        let (given, stayed) = asks_once(&by_http2("/m")).await;
        assert!(given.len() < 1 << 17, "{}", given.len());
        assert!(stayed >= 7 * IDLE, "{stayed:?}");
    }
}
