//! Going through the bytes of a chunk while it is fetched and decompressed, without holding the chunk.

use std::io::{self, ErrorKind, Read};
use std::ops::Range;
use std::sync::Arc;

use bytes::{Buf, Bytes};
use datafusion::common::runtime::SpawnedTask;
use evermap_schemas::Fault;
use object_store::{ObjectMeta, ObjectStore};
use tokio::sync::mpsc::{Receiver, Sender, channel};

use crate::log::checksum::Checksum;
use crate::log::chunk::Damage;
use crate::log::unpack::{check_claim, reader};
use crate::log::window::{PIECE, Window};
use crate::losses::Reason;

/// Bytes that are looked at together.
const BUFFER: usize = 64 << 10;
/// Pieces that wait to be decompressed, while further ones are fetched.
const WAITING: usize = 2;

/// The decompressed bytes of a chunk, from front to back, as far as it claims to have them.
pub(crate) struct Walk<'a> {
    data: Counted<Box<dyn Read + Send + 'a>>,
    buffer: Vec<u8>,
    start: usize,
    end: usize,
    /// What it claims to hold.
    size: u64,
}

impl<'a> Walk<'a> {
    /// Of a chunk that claims to hold so many bytes, and whose data these are, from their first byte on.
    ///
    /// # Errors
    /// When the compression is not known, or the claim is beyond any chunk.
    pub fn new(compression: &str, size: u64, data: impl Read + Send + 'a) -> Result<Self, Damage> {
        check_claim(compression, size)?;
        Ok(Self {
            data: Counted {
                data: reader(compression, data)?,
                left: size,
                crc: crc32fast::Hasher::new(),
            },
            buffer: vec![0; BUFFER],
            start: 0,
            end: 0,
            size,
        })
    }

    /// Bytes that were gone through.
    pub fn position(&self) -> u64 {
        self.found() - (self.end - self.start) as u64
    }

    /// Bytes that came out so far.
    pub fn found(&self) -> u64 {
        self.size - self.data.left
    }

    /// Checksum of what came out so far.
    pub fn checksum(&self) -> u32 {
        self.data.crc.clone().finalize()
    }

    /// What is wrong at the end, where `ended` is what going through all of it came to.
    pub fn damage(&mut self, ended: io::Result<()>) -> Option<Damage> {
        let expected = self.size;
        let detail = match ended.and_then(|()| self.data.ended()) {
            Ok(true) if self.data.left == 0 => return None,
            Ok(_) => format!("expected {expected} B after decompression, found another size"),
            Err(error) => error.to_string(),
        };
        Some((Reason::BadCompression, detail))
    }

    /// The next bytes, up to so many, which are at most [`BUFFER`].
    pub fn peek(&mut self, wanted: usize) -> io::Result<&[u8]> {
        if self.end - self.start < wanted {
            self.buffer.copy_within(self.start..self.end, 0);
            (self.start, self.end) = (0, self.end - self.start);
            while self.end < wanted {
                match self.data.read(&mut self.buffer[self.end..]) {
                    Ok(0) => break,
                    Ok(read) => self.end += read,
                    Err(error) if error.kind() == ErrorKind::Interrupted => {}
                    Err(error) => return Err(error),
                }
            }
        }
        Ok(&self.buffer[self.start..self.end.min(self.start + wanted)])
    }

    /// Skips bytes; how many there were.
    pub fn skip(&mut self, length: u64) -> io::Result<u64> {
        self.each(length, |_| {})
    }

    /// Appends the next bytes; how many there were.
    pub fn take(&mut self, length: u64, bytes: &mut Vec<u8>) -> io::Result<u64> {
        self.each(length, |piece| bytes.extend_from_slice(piece))
    }

    fn each(&mut self, length: u64, mut see: impl FnMut(&[u8])) -> io::Result<u64> {
        let mut seen = 0;
        while seen < length {
            if self.start == self.end && self.peek(1)?.is_empty() {
                break;
            }
            let held = (self.end - self.start) as u64;
            let end = self.start + held.min(length - seen) as usize;
            see(&self.buffer[self.start..end]);
            seen += (end - self.start) as u64;
            self.start = end;
        }
        Ok(seen)
    }
}

/// Counts and hashes what is read, and reads no more than the chunk claims.
struct Counted<R> {
    data: R,
    left: u64,
    crc: crc32fast::Hasher,
}

impl<R: Read> Counted<R> {
    /// Whether there is no more than was claimed.
    fn ended(&mut self) -> io::Result<bool> {
        Ok(self.left > 0 || self.data.read(&mut [0])? == 0)
    }
}

impl<R: Read> Read for Counted<R> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let most = bytes
            .len()
            .min(usize::try_from(self.left).unwrap_or(usize::MAX));
        let read = self.data.read(&mut bytes[..most])?;
        self.left -= read as u64;
        self.crc.update(&bytes[..read]);
        Ok(read)
    }
}

/// What another task fetches piece by piece, as one stretch of bytes.
pub(crate) struct Pieces {
    pieces: Receiver<Bytes>,
    piece: Bytes,
}

impl Pieces {
    /// What is to come, and where it is sent.
    pub fn channel() -> (Sender<Bytes>, Self) {
        let (sender, pieces) = channel(WAITING);
        let piece = Bytes::new();
        (sender, Self { pieces, piece })
    }
}

/// What fetches the data that a [`Walk`] goes through. It fails only when the store does.
pub(crate) type Feed = SpawnedTask<Result<(), Fault>>;

/// Fetches these bytes of an object in a task of its own.
pub(crate) fn fed(
    store: &Arc<dyn ObjectStore>,
    meta: &ObjectMeta,
    range: Range<u64>,
) -> (Pieces, Feed) {
    let (sender, pieces) = Pieces::channel();
    let mut window = Window::new(Arc::clone(store), meta.clone(), range.end);
    let feed = SpawnedTask::spawn(async move { feed(&mut window, range, sender, None).await });
    (pieces, feed)
}

/// What came of a task.
///
/// # Errors
/// A bug fault when it panicked.
pub(crate) async fn joined<T: Send + 'static>(task: SpawnedTask<T>) -> Result<T, Fault> {
    let ended = task.join().await;
    ended.map_err(|error| Fault::bug(error.to_string()))
}

/// Fetches these bytes of an object for whoever goes through them; that may end before. What is fetched is hashed, where
/// there is a checksum to go on with.
///
/// # Errors
/// A resource fault when the store fails: then they seem to end there.
pub(crate) async fn feed(
    window: &mut Window,
    range: Range<u64>,
    sender: Sender<Bytes>,
    mut checksum: Option<&mut Checksum>,
) -> Result<(), Fault> {
    let mut position = range.start;
    while position < range.end {
        let length = PIECE.min(range.end - position);
        let piece = window.get(position, length).await?;
        let piece = piece.unwrap_or_default();
        if let Some(checksum) = &mut checksum {
            checksum.add(&piece);
        }
        if sender.send(piece).await.is_err() {
            break;
        }
        position += length;
    }
    Ok(())
}

impl Read for Pieces {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        while self.piece.is_empty() {
            match self.pieces.blocking_recv() {
                Some(piece) => self.piece = piece,
                None => return Ok(0),
            }
        }
        let length = bytes.len().min(self.piece.len());
        self.piece.copy_to_slice(&mut bytes[..length]);
        Ok(length)
    }
}
