//! Values that several layers share.

use std::sync::Arc;

use arrow::array::{ArrayRef, AsArray, BinaryArray, TimestampNanosecondArray};
use arrow::datatypes::{DataType, TimeUnit, TimestampNanosecondType};

use crate::cell::expect;
use crate::{Cell, Fault, record};

/// Nanoseconds since the epoch, UTC.
#[derive(
    Debug,
    Clone,
    Copy,
    Default,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Hash,
    serde::Serialize,
    serde::Deserialize,
)]
pub struct Stamp(pub i64);

impl Cell for Stamp {
    fn data_type() -> DataType {
        DataType::Timestamp(TimeUnit::Nanosecond, Some("UTC".into()))
    }
    fn encode(values: Vec<Self>) -> Result<ArrayRef, Fault> {
        let stamps =
            TimestampNanosecondArray::from_iter_values(values.into_iter().map(|stamp| stamp.0));
        Ok(Arc::new(stamps.with_timezone("UTC")))
    }
    fn decode(column: &ArrayRef) -> Result<Vec<Self>, Fault> {
        expect::<Self>(column)?;
        Ok(column
            .as_primitive::<TimestampNanosecondType>()
            .values()
            .iter()
            .copied()
            .map(Stamp)
            .collect())
    }
}

/// Opaque bytes: an encoded image, a serialised state.
#[derive(Debug, Clone, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Bytes(pub Vec<u8>);

impl Cell for Bytes {
    fn data_type() -> DataType {
        DataType::Binary
    }
    fn encode(values: Vec<Self>) -> Result<ArrayRef, Fault> {
        if values.iter().map(|value| value.0.len()).sum::<usize>() > i32::MAX as usize {
            return Err(
                Fault::data("more than 2 GiB in one column of a batch").next("use smaller batches")
            );
        }
        Ok(Arc::new(BinaryArray::from_iter_values(
            values.iter().map(|value| value.0.as_slice()),
        )))
    }
    fn decode(column: &ArrayRef) -> Result<Vec<Self>, Fault> {
        expect::<Self>(column)?;
        Ok(column
            .as_binary::<i32>()
            .iter()
            .map(|bytes| Bytes(bytes.unwrap_or_default().to_vec()))
            .collect())
    }
}

record! {
    /// A rigid transform `parent_from_child`: a point in the child frame, multiplied from the left by the
    /// transform, comes out in the parent frame.
    pub struct Pose {
        /// Translation along x.
        x: f64 ["m"],
        /// Translation along y.
        y: f64 ["m"],
        /// Translation along z.
        z: f64 ["m"],
        /// Unit quaternion, x part.
        qx: f64,
        /// Unit quaternion, y part.
        qy: f64,
        /// Unit quaternion, z part.
        qz: f64,
        /// Unit quaternion, scalar part.
        qw: f64,
    }
}

impl Pose {
    /// The transform that changes nothing.
    pub const IDENTITY: Pose = Pose {
        x: 0.0,
        y: 0.0,
        z: 0.0,
        qx: 0.0,
        qy: 0.0,
        qz: 0.0,
        qw: 1.0,
    };

    /// `[x, y, z, qx, qy, qz, qw]`.
    pub fn to_array(&self) -> [f64; 7] {
        [self.x, self.y, self.z, self.qx, self.qy, self.qz, self.qw]
    }

    /// From `[x, y, z, qx, qy, qz, qw]`.
    pub fn from_array([x, y, z, qx, qy, qz, qw]: [f64; 7]) -> Self {
        Self {
            x,
            y,
            z,
            qx,
            qy,
            qz,
            qw,
        }
    }
}

record! {
    /// Where an image's bytes lie in a log. Rows carry this instead of pixels; the engine fetches the bytes just
    /// before a kernel that asks for them.
    #[derive(Default)]
    pub struct ImageRef {
        /// Session whose log holds the image.
        session: String,
        /// Which of the session's files, counted from 0 in time order.
        part: u32,
        /// File offset of the chunk record's compressed bytes; null where the message lies outside any chunk.
        chunk: Option<u64> ["B"],
        /// Length of the compressed chunk; 0 outside chunks.
        chunk_length: u64 ["B"],
        /// Length of the chunk after decompression; 0 outside chunks.
        chunk_size: u64 ["B"],
        /// Compression of the chunk: `zstd`, `lz4` or empty.
        compression: String,
        /// Where the image bytes begin, in the uncompressed chunk, or in the file where there is no chunk.
        offset: u64 ["B"],
        /// Number of image bytes.
        length: u64 ["B"],
        /// How the bytes encode the image: `jpeg`, `png`, video (`h264`, `h265`: a frame that may need those from the last
        /// key frame on), `compressedDepth 16UC1` or `32FC1` (ROS), or a raw encoding such as `mono8`, `rgb8`, `16UC1`,
        /// with ` 12-bit` behind it where a session manifest says that its samples of 16 bits have fewer, and ` big-endian`
        /// where those of several bytes begin with the highest.
        format: String,
        /// Width of a raw image; null where the encoded image says it itself.
        width: Option<u32> ["px"],
        /// Height of a raw image; null where the encoded image says it itself.
        height: Option<u32> ["px"],
        /// Row stride of a raw image; null where the encoded image says it itself.
        step: Option<u32> ["B"],
    }
}
