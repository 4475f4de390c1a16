//! Decoded columns, read by path: messages of one meaning differ in where they keep it.

use arrow::array::{Array, ArrayRef, AsArray, StructArray};
use arrow::datatypes::{
    DataType, Float32Type, Float64Type, Int8Type, Int16Type, Int32Type, Int64Type, UInt8Type,
    UInt16Type, UInt32Type, UInt64Type,
};
use evermap_schemas::{Pose, Stamp};

/// The members of a message, or of a list of messages.
#[derive(Debug, Clone)]
pub(crate) struct Columns(pub StructArray);

impl Columns {
    /// Number of messages.
    pub fn len(&self) -> usize {
        Array::len(&self.0)
    }

    /// The member at a path of names.
    fn at(&self, path: &[&str], row: usize) -> Option<ArrayRef> {
        let (first, rest) = path.split_first()?;
        let mut array = self.0.column_by_name(first)?.clone();
        for name in rest {
            let parent = array.as_struct_opt()?;
            if parent.is_null(row) {
                return None;
            }
            array = parent.column_by_name(name)?.clone();
        }
        (row < array.len() && !array.is_null(row)).then_some(array)
    }

    /// A number, whatever its type.
    pub fn number(&self, path: &[&str], row: usize) -> Option<f64> {
        number(&self.at(path, row)?, row)
    }

    /// A text.
    pub fn text(&self, path: &[&str], row: usize) -> Option<String> {
        let array = self.at(path, row)?;
        Some(array.as_string_opt::<i32>()?.value(row).to_owned())
    }

    /// A list of numbers, of fixed or free length; under the first of several names.
    pub fn numbers(&self, names: &[&str], row: usize) -> Vec<f64> {
        let found = names.iter().find_map(|name| self.at(&[name], row));
        let items = found.and_then(|array| items(&array, row));
        let Some(items) = items else {
            return Vec::new();
        };
        (0..items.len()).filter_map(|i| number(&items, i)).collect()
    }

    /// A list of messages.
    pub fn list(&self, name: &str, row: usize) -> Option<Columns> {
        let items = items(&self.at(&[name], row)?, row)?;
        Some(Columns(items.as_struct_opt()?.clone()))
    }

    /// A stamp of seconds and nanoseconds, as ROS 1, ROS 2, protobuf and JSON spell them. `None` where it is missing
    /// or zero, as senders leave it that do not know the time.
    pub fn stamp(&self, path: &[&str], row: usize) -> Option<Stamp> {
        let part = |names: [&str; 3]| {
            names.iter().find_map(|name| {
                let path: Vec<&str> = path.iter().copied().chain([*name]).collect();
                self.number(&path, row)
            })
        };
        let seconds = part(["sec", "secs", "seconds"])?;
        let fraction = part(["nanosec", "nsec", "nanos"])?;
        let stamp = (seconds as i64)
            .checked_mul(1_000_000_000)?
            .checked_add(fraction as i64)?;
        (stamp != 0).then_some(Stamp(stamp))
    }

    /// A pose from a position and a quaternion; the quaternion is normalised.
    pub fn pose(&self, position: &[&str], rotation: &[&str], row: usize) -> Result<Pose, String> {
        let part = |path: &[&str], name: &str| {
            let path: Vec<&str> = path.iter().copied().chain([name]).collect();
            self.number(&path, row)
                .filter(|number| number.is_finite())
                .ok_or_else(|| format!("expected a finite number at {}", path.join(".")))
        };
        let [x, y, z] = ["x", "y", "z"].map(|name| part(position, name));
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
