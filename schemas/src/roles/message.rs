//! A message as a role sees it: its decoded members, read by path, as messages of one meaning differ in where they keep
//! it.

use std::cell::OnceCell;
use std::collections::BTreeMap;

use arrow::array::{Array, ArrayRef, AsArray, StructArray};
use arrow::datatypes::{
    DataType, Float32Type, Float64Type, Int8Type, Int16Type, Int32Type, Int64Type, UInt8Type,
    UInt16Type, UInt32Type, UInt64Type,
};

use crate::roles::{CameraNames, OdometryOf, SampleBits, StillFrames, ZeroStamp, frame_names};
use crate::{Fault, ImageRef, LayerRow, Pose, Stamp};

/// A row that comes from messages.
pub trait FromMessage: LayerRow {
    /// Members of a message that are decoded, where it has them.
    const MEMBERS: &'static [&'static str];

    /// The rows of one message.
    ///
    /// # Errors
    /// In words, when its values make no sense: the message is then counted as lost.
    fn from_message(message: &Message<'_>) -> Result<Vec<Self>, String>;
}

/// Rows, one array per column, and the messages, or entries of a metadata record, that gave none.
#[derive(Debug)]
pub struct ReadRows {
    /// The columns.
    pub columns: Vec<ArrayRef>,
    /// Messages, or entries, whose values make no sense: which of those given, and why.
    pub senseless: Vec<(usize, String)>,
}

/// From messages to rows.
pub type Reader = fn(&[Message<'_>]) -> Result<ReadRows, Fault>;

/// From a site, a session and a metadata record to rows.
pub type MetadataReader = fn(&str, &str, &BTreeMap<String, String>) -> Result<ReadRows, Fault>;

pub(super) fn read<T: FromMessage>(messages: &[Message<'_>]) -> Result<ReadRows, Fault> {
    let mut rows = Vec::with_capacity(messages.len());
    let mut senseless = Vec::new();
    for (index, message) in messages.iter().enumerate() {
        match T::from_message(message) {
            Ok(found) => rows.extend(found),
            Err(detail) => senseless.push((index, detail)),
        }
    }
    let columns = T::encode_columns(rows)?;
    Ok(ReadRows { columns, senseless })
}

/// One message.
#[derive(Debug, Clone, Copy)]
pub struct Message<'a> {
    /// Site of the session.
    pub site: &'a str,
    /// Session that it was recorded in.
    pub session: &'a str,
    /// Topic that it was recorded on.
    pub topic: &'a str,
    /// When it was recorded.
    pub log_time: Stamp,
    /// Its members, in a row beside those of other messages of its topic.
    pub fields: Fields<'a>,
    /// What a stamp of zero means among these; empty until one is read.
    pub zero: &'a OnceCell<ZeroStamp>,
    /// Where its image lies; for roles of images.
    pub image: Option<&'a FoundImage>,
    /// What the session's cameras are called; for roles of images.
    pub cameras: &'a CameraNames,
    /// Bits that a person says the samples of its image have, where these are fewer than hold them; for roles of pictures.
    pub bits: Option<SampleBits>,
    /// The odometry that is meant, of those among transforms; for roles that have one robot's rows.
    pub robot: &'a OdometryOf,
    /// The frames that never move, though topics of moving transforms have them; for roles of transforms.
    pub still: Option<&'a StillFrames>,
}

/// Where an image's bytes lie, and the first of them, where its format must be guessed.
#[derive(Debug, Clone, PartialEq)]
pub struct FoundImage {
    /// The place; what only the message's members say is not filled in.
    pub place: ImageRef,
    /// First bytes; zeros behind an image that is shorter.
    pub magic: [u8; 8],
}

impl Message<'_> {
    /// The header's frame, without the slash that ROS 1 puts in front; empty where there is none.
    pub fn frame(&self) -> String {
        let header = self.fields.text(&["header", "frame_id"]);
        let own = || self.fields.text(&["frame_id"]);
        let frame = header.or_else(own).unwrap_or_default();
        frame_names::plain(&frame).to_owned()
    }
}

/// No position of a log is farther from its frame's origin (m): beyond the orbits of satellites, and a micrometre is told
/// apart there still.
pub const FARTHEST_M: f64 = 1e9;

/// The decoded members of one message, or of one item in a list of messages.
#[derive(Debug, Clone, Copy)]
pub struct Fields<'a> {
    pub(super) members: &'a StructArray,
    pub(super) row: usize,
}

impl<'a> Fields<'a> {
    /// Those in one row of a batch.
    pub fn new(members: &'a StructArray, row: usize) -> Self {
        Self { members, row }
    }

    /// Those of all rows.
    pub fn all(members: &'a StructArray) -> impl Iterator<Item = Self> {
        (0..members.len()).map(move |row| Self { members, row })
    }

    /// The member at a path of names.
    pub(super) fn at(&self, path: &[&str]) -> Option<ArrayRef> {
        let (first, rest) = path.split_first()?;
        let mut array = self.members.column_by_name(first)?.clone();
        for name in rest {
            let parent = array.as_struct_opt()?;
            if parent.is_null(self.row) {
                return None;
            }
            array = parent.column_by_name(name)?.clone();
        }
        (self.row < array.len() && !array.is_null(self.row)).then_some(array)
    }

    /// A number, whatever its type.
    pub fn number(&self, path: &[&str]) -> Option<f64> {
        number(&self.at(path)?, self.row)
    }

    /// A text.
    pub fn text(&self, path: &[&str]) -> Option<String> {
        let array = self.at(path)?;
        Some(array.as_string_opt::<i32>()?.value(self.row).to_owned())
    }

    /// A list of numbers, of fixed or free length; under the first of several names.
    pub fn numbers(&self, names: &[&str]) -> Vec<f64> {
        let found = names.iter().find_map(|name| self.at(&[name]));
        let items = found.and_then(|array| items(&array, self.row));
        let Some(items) = items else {
            return Vec::new();
        };
        (0..items.len()).filter_map(|i| number(&items, i)).collect()
    }

    /// A list of messages.
    pub fn list(&self, name: &str) -> Option<StructArray> {
        let items = items(&self.at(&[name])?, self.row)?;
        Some(items.as_struct_opt()?.clone())
    }

    /// A pose from a position and a quaternion; the quaternion is normalised.
    ///
    /// # Errors
    /// In words, when a number is missing or not finite, the position beyond [`FARTHEST_M`], or the quaternion has no
    /// length.
    pub fn pose(&self, position: &[&str], rotation: &[&str]) -> Result<Pose, String> {
        let part = |path: &[&str], name: &str| {
            let path = [path, &[name]].concat();
            let found = self.number(&path);
            found
                .filter(|number| number.is_finite())
                .ok_or_else(|| match found {
                    Some(found) => format!(
                        "expected a finite number at {}, found {found}",
                        path.join(".")
                    ),
                    None => format!("expected a number at {}, found none", path.join(".")),
                })
        };
        let near = |name: &str| match part(position, name) {
            Ok(far) if far.abs() > FARTHEST_M => {
                let path = [position, &[name]].concat().join(".");
                Err(format!(
                    "expected at most {FARTHEST_M:e} m at {path}, found {far:e}"
                ))
            }
            found => found,
        };
        let [x, y, z] = ["x", "y", "z"].map(near);
        let [qx, qy, qz, qw] = ["x", "y", "z", "w"].map(|name| part(rotation, name));
        let (qx, qy, qz, qw) = (qx?, qy?, qz?, qw?);
        let norm = (qx * qx + qy * qy + qz * qz + qw * qw).sqrt();
        if !(norm > 1e-6 && norm.is_finite()) {
            return Err(format!(
                "expected a rotation, found a quaternion of length {norm}"
            ));
        }
        Ok(Pose {
            x: x?,
            y: y?,
            z: z?,
            qx: qx / norm,
            qy: qy / norm,
            qz: qz / norm,
            qw: qw / norm,
        })
    }
}

fn items(array: &ArrayRef, row: usize) -> Option<ArrayRef> {
    match array.data_type() {
        DataType::List(_) => Some(array.as_list::<i32>().value(row)),
        DataType::FixedSizeList(..) => Some(array.as_fixed_size_list().value(row)),
        _ => None,
    }
}

fn number(array: &ArrayRef, row: usize) -> Option<f64> {
    if array.is_null(row) {
        return None;
    }
    Some(match array.data_type() {
        DataType::Float64 => array.as_primitive::<Float64Type>().value(row),
        DataType::Float32 => array.as_primitive::<Float32Type>().value(row).into(),
        DataType::Int8 => array.as_primitive::<Int8Type>().value(row).into(),
        DataType::Int16 => array.as_primitive::<Int16Type>().value(row).into(),
        DataType::Int32 => array.as_primitive::<Int32Type>().value(row).into(),
        DataType::Int64 => array.as_primitive::<Int64Type>().value(row) as f64,
        DataType::UInt8 => array.as_primitive::<UInt8Type>().value(row).into(),
        DataType::UInt16 => array.as_primitive::<UInt16Type>().value(row).into(),
        DataType::UInt32 => array.as_primitive::<UInt32Type>().value(row).into(),
        DataType::UInt64 => array.as_primitive::<UInt64Type>().value(row) as f64,
        _ => return None,
    })
}
