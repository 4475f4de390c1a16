//! CDR (ROS 2, DDS) and ROS 1 serialisation, by compiled programs.
//!
//! Sources: OMG DDS-XTypes 1.3, 7.4 (data representation) and 7.6.2.1.2
//! (encapsulation header); ROS 1 wiki, "msg", serialisation.

mod program;
mod run;
mod writer;

use crate::buffers::{Node, Pool};
use crate::decoder::Format;
use crate::wire::StructType;
use crate::{DecodeError, Located};
use program::{Compiler, Dialect, Step};
use run::Runner;
use std::sync::Arc;
pub(crate) use writer::CdrWriter;

/// First bytes of a zstd frame (RFC 8878, 3.1.1); no CDR header begins so.
const ZSTD_MAGIC: [u8; 4] = [0x28, 0xB5, 0x2F, 0xFD];

/// Which of the two serialisations a channel uses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Serialisation {
    Cdr,
    Ros1,
}

/// A payload without its header.
struct Body<'a> {
    data: &'a [u8],
    /// Bytes of header before it.
    start: usize,
    dialect: Dialect,
    little_endian: bool,
}

impl<'a> Body<'a> {
    fn open(payload: &'a [u8], serialisation: Serialisation) -> Result<Self, DecodeError> {
        if serialisation == Serialisation::Ros1 {
            return Ok(Body {
                data: payload,
                start: 0,
                dialect: Dialect::ROS1,
                little_endian: true,
            });
        }
        let Some((header, data)) = payload.split_first_chunk::<4>() else {
            return Err(DecodeError::truncated(payload, 0, 4));
        };
        if header == &ZSTD_MAGIC {
            return Err(DecodeError::Compressed);
        }
        let identifier = u16::from_be_bytes([header[0], header[1]]);
        // DDS-XTypes 1.3 numbers CDR2 from 6; earlier drafts, and some writers, from 16.
        let dialect = match identifier {
            0x00 | 0x01 => Dialect::CDR,
            0x06 | 0x07 | 0x10 | 0x11 => Dialect::CDR2,
            0x08 | 0x09 | 0x14 | 0x15 => Dialect::DELIMITED_CDR2,
            _ => return Err(DecodeError::Encapsulation { identifier }),
        };
        Ok(Body {
            data,
            start: 4,
            dialect,
            little_endian: identifier & 1 == 1,
        })
    }

    fn run(&self, steps: &[Step], pool: &mut Pool) -> Result<Option<Located>, DecodeError> {
        let found = if self.little_endian == cfg!(target_endian = "little") {
            let mut runner = Runner::<false>::new(self.data, self.dialect);
            runner.run(steps, pool)?;
            runner.found()
        } else {
            let mut runner = Runner::<true>::new(self.data, self.dialect);
            runner.run(steps, pool)?;
            runner.found()
        };
        Ok(found.map(|range| Located {
            range: range.start + self.start..range.end + self.start,
            base64: false,
        }))
    }
}

/// Where the binary member at `path` lies in `payload`.
pub(crate) fn locate(
    serialisation: Serialisation,
    message: &StructType,
    payload: &[u8],
    path: &[&str],
) -> Result<Option<Located>, DecodeError> {
    let body = Body::open(payload, serialisation)?;
    match Compiler::locate(body.dialect, message, path) {
        Some(steps) => body.run(&steps, &mut Pool::default()),
        None => Ok(None),
    }
}

/// Reads payloads of one message type by its programs.
pub(crate) struct Reader {
    serialisation: Serialisation,
    message: Arc<StructType>,
    /// Compiled when first met, as a log rarely mixes dialects.
    programs: Vec<(Dialect, Vec<Step>)>,
}

impl Reader {
    pub(crate) fn new(serialisation: Serialisation, message: Arc<StructType>) -> Self {
        Self {
            serialisation,
            message,
            programs: Vec::new(),
        }
    }
}

impl Format for Reader {
    fn append(
        &mut self,
        payload: &[u8],
        message: &Node,
        _row: usize,
        pool: &mut Pool,
    ) -> Result<(), DecodeError> {
        let body = Body::open(payload, self.serialisation)?;
        let known = self.programs.iter().position(|(d, _)| *d == body.dialect);
        let program = known.unwrap_or_else(|| {
            let steps = Compiler::message(body.dialect, &self.message, message);
            self.programs.push((body.dialect, steps));
            self.programs.len() - 1
        });
        body.run(&self.programs[program].1, pool).map(|_| ())
    }
}
