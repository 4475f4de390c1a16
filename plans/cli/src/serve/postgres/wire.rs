//! Messages of clients, looked at before the library reads them: it believes the sizes and numbers in them, panics where
//! less is there, and takes what is left over for the next message.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use bytes::BytesMut;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

/// Bytes of a message at most while its sender is not in, as Postgres has it.
const FROM_OUTSIDE: usize = 10_000;

/// Bytes of a message at most once its sender is in: lists of literals and parameters may be long.
const FROM_INSIDE: usize = 8 << 20;

/// Bytes that are read at once.
const AT_ONCE: usize = 8 << 10;

/// How long what comes from somebody who was refused is passed over.
const MOMENT: Duration = Duration::from_secs(1);

/// The number that a connection begins with which is there to cancel a query of another.
const CANCEL: [u8; 4] = 80_877_102_i32.to_be_bytes();

/// A stream that hands on what comes message by message, each when it is there whole and is what it says. What is not is
/// an error of the kind [`io::ErrorKind::InvalidData`], and the end.
pub struct Checked<S> {
    stream: S,
    sender: Sender,
    /// What came and is not handed on.
    held: BytesMut,
    /// Bytes at the beginning of `held` that are found right.
    right: usize,
}

/// Who sends, which decides what may be said.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Sender {
    /// Somebody who has said nothing.
    New,
    /// Somebody who was told how to come in.
    Asked,
    /// Somebody who has begun to answer.
    Answering,
    /// Somebody who is in.
    In,
}

impl<S> Checked<S> {
    /// A stream, of which some bytes were read already.
    pub fn new(stream: S, held: BytesMut) -> Self {
        Self {
            stream,
            sender: Sender::New,
            held,
            right: 0,
        }
    }

    /// The stream itself.
    pub fn stream(&self) -> &S {
        &self.stream
    }

    /// From the next message on, the sender is in.
    pub fn let_in(&mut self) {
        self.sender = Sender::In;
    }

    /// Passes over what else comes, for a moment: the system would take back what was said last from somebody whose bytes
    /// are not read.
    pub async fn pass_over(&mut self)
    where
        S: AsyncRead + Unpin,
    {
        let mut nowhere = tokio::io::sink();
        let rest = tokio::io::copy(&mut self.stream, &mut nowhere);
        // Who is gone, or goes on, has had the time to hear it.
        let _ = tokio::time::timeout(MOMENT, rest).await;
    }

    /// Looks at what is held.
    fn check(&mut self) -> io::Result<()> {
        if let Some(length) = self.sender.first_of(&self.held)? {
            self.right = length;
            self.sender = match (self.sender, self.held.first()) {
                (Sender::New, _) => Sender::Asked,
                (Sender::Asked, Some(b'p')) => Sender::Answering,
                (sender, _) => sender,
            };
        }
        Ok(())
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Checked<S> {
    fn poll_read(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        wanted: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let this = self.get_mut();
        loop {
            if this.right == 0 {
                this.check()?;
            }
            if this.right > 0 {
                let count = this.right.min(wanted.remaining());
                wanted.put_slice(&this.held.split_to(count));
                this.right -= count;
                if this.held.is_empty() {
                    // The room of a large message is given back.
                    this.held = BytesMut::new();
                }
                return Poll::Ready(Ok(()));
            }
            let mut bytes = [0; AT_ONCE];
            let mut read = ReadBuf::new(&mut bytes);
            ready!(Pin::new(&mut this.stream).poll_read(context, &mut read))?;
            if read.filled().is_empty() {
                // Whoever sent half a message is gone.
                return Poll::Ready(Ok(()));
            }
            this.held.extend_from_slice(read.filled());
        }
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Checked<S> {
    fn poll_write(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.get_mut().stream).poll_write(context, bytes)
    }

    fn poll_flush(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.get_mut().stream).poll_flush(context)
    }

    fn poll_shutdown(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.get_mut().stream).poll_shutdown(context)
    }
}

impl Sender {
    /// Bytes of the first message in `held`; `None` where it is not whole yet.
    ///
    /// # Errors
    /// For one that is too large, or not what its kind has.
    fn first_of(self, held: &[u8]) -> io::Result<Option<usize>> {
        // The first message of a connection has no kind.
        let (kind, rest) = match (self, held.split_first()) {
            (Self::New, _) => (None, held),
            (_, Some((kind, rest))) => (Some(*kind), rest),
            (_, None) => return Ok(None),
        };
        let Some((size, rest)) = rest.split_first_chunk() else {
            return Ok(None);
        };
        let (size, most) = (i32::from_be_bytes(*size), self.most());
        // A size counts its own four bytes.
        let length = usize::try_from(size).ok().filter(|size| *size <= most);
        let Some(length) = length.and_then(|size| size.checked_sub(4)) else {
            return Err(wrong(format!(
                "expected a message of 4 to {most} bytes, found one of {size}"
            )));
        };
        let Some(body) = rest.get(..length) else {
            return Ok(None);
        };
        match self.has_form(kind, Body(body)) {
            Some(()) => Ok(Some(held.len() - rest.len() + length)),
            None => Err(wrong(match kind {
                None => format!("expected a start of a connection, found {length} other bytes"),
                Some(kind) => format!(
                    "expected a message of the protocol of Postgres, found kind `{}` with {length} bytes that are none",
                    kind.escape_ascii()
                ),
            })),
        }
    }

    fn most(self) -> usize {
        match self {
            Self::In => FROM_INSIDE,
            _ => FROM_OUTSIDE,
        }
    }

    /// Whether a body has what its kind has, and no more.
    fn has_form(self, kind: Option<u8>, mut body: Body<'_>) -> Option<()> {
        match kind {
            None => body.start()?,
            Some(b'Q' | b'f') => {
                body.text()?;
            }
            Some(b'P') => {
                body.text()?;
                body.text()?;
                let types = body.count()?;
                body.skip(4 * types)?;
            }
            Some(b'B') => body.bind()?,
            Some(b'C' | b'D') => {
                body.skip(1)?;
                body.text()?;
            }
            Some(b'E') => {
                body.text()?;
                body.skip(4)?;
            }
            Some(b'p') if self == Self::Asked => {
                body.text()?;
                body.sized()?;
            }
            Some(b'p' | b'd') => body = Body(&[]),
            Some(b'H' | b'S' | b'X' | b'c') => {}
            Some(_) => return None,
        }
        body.0.is_empty().then_some(())
    }
}

/// What of a message, or of a part of one, was not looked at yet.
pub struct Body<'b>(pub &'b [u8]);

impl<'b> Body<'b> {
    /// So many bytes; `None` where there are fewer.
    pub fn skip(&mut self, bytes: usize) -> Option<&'b [u8]> {
        let (skipped, rest) = self.0.split_at_checked(bytes)?;
        self.0 = rest;
        Some(skipped)
    }

    /// The bytes of a number; `None` where there are fewer.
    pub fn number<const BYTES: usize>(&mut self) -> Option<[u8; BYTES]> {
        let (number, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(*number)
    }

    fn count(&mut self) -> Option<usize> {
        self.number().map(u16::from_be_bytes).map(usize::from)
    }

    /// A text and the zero that ends it.
    fn text(&mut self) -> Option<&'b [u8]> {
        let end = self.0.iter().position(|byte| *byte == 0)?;
        let text = self.skip(end)?;
        self.skip(1)?;
        Some(text)
    }

    /// Bytes behind their number, which is -1 where there are none.
    fn sized(&mut self) -> Option<()> {
        match self.number().map(i32::from_be_bytes)? {
            -1 => Some(()),
            size => {
                self.skip(usize::try_from(size).ok()?)?;
                Some(())
            }
        }
    }

    /// The version of the protocol, then names with their values, and an empty name.
    fn start(&mut self) -> Option<()> {
        if self.number::<4>()? == CANCEL {
            self.0 = &[];
            return Some(());
        }
        while !self.text()?.is_empty() {
            self.text()?;
        }
        Some(())
    }

    /// Formats of all parameters, of each, or none; the parameters; formats of columns.
    fn bind(&mut self) -> Option<()> {
        self.text()?;
        self.text()?;
        let formats = self.count()?;
        self.skip(2 * formats)?;
        let parameters = self.count()?;
        for _ in 0..parameters {
            self.sized()?;
        }
        let columns = self.count()?;
        self.skip(2 * columns)?;
        (formats <= 1 || formats == parameters).then_some(())
    }
}

fn wrong(message: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, message)
}

#[cfg(test)]
mod tests;
