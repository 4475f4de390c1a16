//! CDR (ROS 2, DDS) and ROS 1 serialisation, by compiled programs.
//!
//! Sources: OMG DDS-XTypes 1.3, 7.4 (data representation) and 7.6.2.1.2
//! (encapsulation header); ROS 1 wiki, "msg", serialisation.

mod program;
mod run;

use crate::buffers::{Node, Pool};
use crate::wire::StructType;
use crate::{DecodeError, Decoder, Located};
use arrow::array::ArrayRef;
use arrow::datatypes::{FieldRef, Fields};
use arrow::error::ArrowError;
use program::{Compiler, Dialect, Step};
use run::Runner;
use std::sync::Arc;

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
            return Err(DecodeError::Truncated {
                offset: 0,
                needed: 4,
                available: payload.len(),
            });
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

/// Columns of one message type, filled by its program.
pub(crate) struct CdrDecoder {
    serialisation: Serialisation,
    message: Arc<StructType>,
    /// Column of each member, where it is projected.
    column_of: Vec<Option<usize>>,
    columns: Vec<Node>,
    pool: Pool,
    rows: usize,
    programs: Vec<(Dialect, Vec<Step>)>,
}

impl CdrDecoder {
    pub(crate) fn new(
        serialisation: Serialisation,
        message: Arc<StructType>,
        fields: &Fields,
        projection: &[usize],
    ) -> Self {
        let mut pool = Pool::default();
        let mut column_of = vec![None; message.members.len()];
        let mut columns = Vec::new();
        for index in projection {
            let (Some(field), Some(slot)) = (fields.get(*index), column_of.get_mut(*index)) else {
                continue;
            };
            let field: &FieldRef = field;
            *slot = Some(columns.len());
            columns.push(Node::new(field, &mut pool));
        }
        CdrDecoder {
            serialisation,
            message,
            column_of,
            columns,
            pool,
            rows: 0,
            programs: Vec::new(),
        }
    }

    /// The program for `dialect`; compiled when first met, as a log rarely mixes them.
    fn program(&mut self, dialect: Dialect) -> usize {
        if let Some(known) = self.programs.iter().position(|(d, _)| *d == dialect) {
            return known;
        }
        let columns: Vec<Option<&Node>> = self
            .column_of
            .iter()
            .map(|column| column.and_then(|index| self.columns.get(index)))
            .collect();
        let steps = Compiler::message(dialect, &self.message, &columns);
        self.programs.push((dialect, steps));
        self.programs.len() - 1
    }
}

impl Decoder for CdrDecoder {
    fn push(&mut self, payload: &[u8]) -> Result<(), DecodeError> {
        let body = Body::open(payload, self.serialisation)?;
        let program = self.program(body.dialect);
        if let Err(error) = body.run(&self.programs[program].1, &mut self.pool) {
            for column in &self.columns {
                column.truncate(&mut self.pool, self.rows);
            }
            return Err(error);
        }
        self.rows += 1;
        Ok(())
    }

    fn len(&self) -> usize {
        self.rows
    }

    fn bytes(&self) -> usize {
        self.pool.bytes()
    }

    fn finish(&mut self) -> Result<Vec<ArrayRef>, ArrowError> {
        let rows = std::mem::take(&mut self.rows);
        let pool = &mut self.pool;
        self.columns.iter().map(|c| c.finish(pool, rows)).collect()
    }
}
