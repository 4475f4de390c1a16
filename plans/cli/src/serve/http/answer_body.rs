//! What answers say, piece by piece as who asked takes it: an exchange goes on until its answer is taken.

use std::pin::Pin;
use std::task::{Context, Poll, ready};

use axum::body::Bytes;
use hyper::body::{Body, Frame, SizeHint};

use crate::serve::patience::Exchange;

/// Bytes that are handed over at once: of more, nobody would see how they are taken.
const PIECE: usize = 64 << 10;

/// The body of an answer. Its exchange is over when it is dropped, which is when all of it but what fits into buffers is taken.
pub struct AnswerBody<B> {
    body: B,
    /// What is left of what the body gave.
    left: Bytes,
    exchange: Exchange,
}

impl<B> AnswerBody<B> {
    /// The body of the answer of an exchange.
    pub fn new(body: B, exchange: Exchange) -> Self {
        Self {
            body,
            left: Bytes::new(),
            exchange,
        }
    }
}

impl<B: Body<Data = Bytes> + Unpin> Body for AnswerBody<B> {
    type Data = Bytes;
    type Error = B::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, B::Error>>> {
        if self.left.is_empty() {
            let Some(frame) = ready!(Pin::new(&mut self.body).poll_frame(context)) else {
                return Poll::Ready(None);
            };
            match frame?.into_data() {
                Ok(bytes) => self.left = bytes,
                Err(trailers) => return Poll::Ready(Some(Ok(trailers))),
            }
        }
        self.exchange.moves();
        let piece = self.left.len().min(PIECE);
        let piece = self.left.split_to(piece);
        Poll::Ready(Some(Ok(Frame::data(piece))))
    }

    fn is_end_stream(&self) -> bool {
        self.left.is_empty() && self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        let (left, of_body) = (self.left.len() as u64, self.body.size_hint());
        let mut hint = SizeHint::new();
        hint.set_lower(of_body.lower().saturating_add(left));
        if let Some(upper) = of_body.upper() {
            hint.set_upper(upper.saturating_add(left));
        }
        hint
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::time::Duration;

    use super::*;
    use crate::serve::patience::Exchanges;

    #[tokio::test]
    async fn an_answer_is_given_in_pieces_and_whole() {
        let bytes: Vec<u8> = (0..3 * PIECE + 1).map(|at| (at % 251) as u8).collect();
        let exchange = Exchanges::new(Duration::ZERO).begin();
        let mut given = AnswerBody::new(axum::body::Body::from(bytes.clone()), exchange);
        let mut taken = Vec::new();
        while !given.is_end_stream() {
            let left = (bytes.len() - taken.len()) as u64;
            assert_eq!(given.size_hint().exact(), Some(left));
            let next = std::future::poll_fn(|context| Pin::new(&mut given).poll_frame(context));
            let piece = next.await.unwrap().unwrap().into_data().unwrap();
            assert!(piece.len() <= PIECE);
            taken.extend(piece);
        }
        assert_eq!(taken, bytes);
    }
}
