//! What requests say, which must be there whole and in time: half of one would keep its place for ever.

use std::error::Error;
use std::fmt::{Display, Formatter};
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use axum::BoxError;
use axum::body::Bytes;
use axum::extract::rejection::BytesRejection;
use axum::extract::{FromRequest, Request};
use axum::http::StatusCode;
use axum::middleware::Next;
use axum::response::Response;
use evermap_schemas::Fault;
use hyper::body::{Body, Frame, SizeHint};
use tokio::time::Sleep;

use crate::serve::http::Refusal;
use crate::serve::patience::{PATIENCE, RequestSignal};

/// The body of a request. Its connection has asked when it is there to its end.
pub struct RequestBody<B> {
    body: B,
    asked: RequestSignal,
    late: Pin<Box<Sleep>>,
}

impl<B: Body> RequestBody<B> {
    /// The body of a request whose head is there by now.
    pub fn new(body: B, asked: RequestSignal) -> Self {
        Self::within(PATIENCE, body, asked)
    }

    fn within(time: Duration, body: B, asked: RequestSignal) -> Self {
        if body.is_end_stream() {
            asked.now();
        }
        let late = Box::pin(tokio::time::sleep(time));
        Self { body, asked, late }
    }
}

impl<B: Body + Unpin> Body for RequestBody<B>
where
    B::Error: Into<BoxError>,
{
    type Data = B::Data;
    type Error = BoxError;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<B::Data>, BoxError>>> {
        let polled = Pin::new(&mut self.body).poll_frame(context);
        match polled {
            Poll::Ready(None) => self.asked.now(),
            Poll::Ready(Some(Ok(_))) if self.body.is_end_stream() => self.asked.now(),
            Poll::Pending if self.late.as_mut().poll(context).is_ready() => {
                return Poll::Ready(Some(Err(Late.into())));
            }
            _ => {}
        }
        polled.map_err(Into::into)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

/// What a request says is no longer than this, bytes: axum's own bound.
const LONGEST: usize = 2 << 20;

/// That a body was not there in time.
#[derive(Debug)]
struct Late;

impl Display for Late {
    fn fmt(&self, to: &mut Formatter<'_>) -> std::fmt::Result {
        let seconds = PATIENCE.as_secs();
        write!(
            to,
            "expected a whole request within {seconds} s, found half of one"
        )
    }
}

impl Error for Late {}

/// Has a request answered when it is there whole; what asks without a body is.
///
/// # Errors
/// For a body that does not come in time, is longer than it may be, or breaks off.
pub async fn whole(request: Request, next: Next) -> Result<Response, Refusal> {
    let (head, body) = request.into_parts();
    if body.is_end_stream() {
        return Ok(next.run(Request::from_parts(head, body)).await);
    }
    let body = Bytes::from_request(Request::new(body), &()).await?;
    Ok(next.run(Request::from_parts(head, body.into())).await)
}

impl From<BytesRejection> for Refusal {
    fn from(rejection: BytesRejection) -> Self {
        let mut cause: Option<&(dyn Error + 'static)> = Some(&rejection);
        while let Some(error) = cause {
            if error.is::<Late>() {
                return Self::new(StatusCode::REQUEST_TIMEOUT, Fault::user(Late.to_string()));
            }
            cause = error.source();
        }
        let fault = match rejection.status() {
            StatusCode::PAYLOAD_TOO_LARGE => Fault::user(format!(
                "expected a request of at most {} MiB, found a longer one",
                LONGEST >> 20
            )),
            _ => Fault::user(rejection.body_text()),
        };
        Self::new(rejection.status(), fault)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use axum::response::IntoResponse;

    use super::*;

    /// The first half of a body, and then nothing.
    struct Half(Option<Bytes>);

    impl Body for Half {
        type Data = Bytes;
        type Error = BoxError;

        fn poll_frame(
            mut self: Pin<&mut Self>,
            _: &mut Context<'_>,
        ) -> Poll<Option<Result<Frame<Bytes>, BoxError>>> {
            match self.0.take() {
                Some(bytes) => Poll::Ready(Some(Ok(Frame::data(bytes)))),
                None => Poll::Pending,
            }
        }
    }

    /// What is read of a body, and whether its connection has asked then.
    async fn read(body: axum::body::Body) -> (Result<Bytes, Refusal>, bool) {
        let (short, asked) = (Duration::from_millis(20), RequestSignal::default());
        let heard = RequestBody::within(short, body, asked.clone());
        let request = Request::new(axum::body::Body::new(heard));
        let read = Bytes::from_request(request, &()).await;
        let connection = asked.within(short, tokio::time::sleep(2 * short));
        (read.map_err(Refusal::from), connection.await.is_some())
    }

    #[tokio::test]
    async fn a_request_that_is_too_long_is_told_how_long_it_may_be() {
        let (read_whole, _) = read(vec![b' '; LONGEST].into()).await;
        assert!(read_whole.is_ok());
        let (refused, _) = read(vec![b' '; LONGEST + 1].into()).await;
        let answer = refused.map(drop).unwrap_err().into_response();
        assert_eq!(answer.status(), StatusCode::PAYLOAD_TOO_LARGE);
        let said = axum::body::to_bytes(answer.into_body(), 4096).await;
        let said = String::from_utf8(said.unwrap().to_vec()).unwrap();
        assert!(said.contains("a request of at most 2 MiB"), "{said}");
    }

    #[tokio::test]
    async fn half_of_a_request_is_refused_in_time_and_has_not_asked() {
        let half = Half(Some(Bytes::from_static(b"SELECT")));
        let (refused, has_asked) = read(axum::body::Body::new(half)).await;
        let answer = refused.map(drop).unwrap_err().into_response();
        assert_eq!(answer.status(), StatusCode::REQUEST_TIMEOUT);
        assert_eq!(answer.headers()["connection"], "close");
        assert!(!has_asked);

        let (whole, has_asked) = read("SELECT 1".into()).await;
        assert!(whole.is_ok_and(|whole| whole == "SELECT 1"));
        assert!(has_asked);
        let (_, has_asked) = read(axum::body::Body::empty()).await;
        assert!(has_asked);
    }
}
