//! Functions on poses.

use std::sync::Arc;

use arrow::array::{Array, ArrayRef, AsArray, Float64Array, StructArray};
use arrow::buffer::NullBuffer;
use arrow::compute::cast;
use arrow::datatypes::{DataType, Float64Type};
use datafusion::common::{DataFusionError, Result};
use evermap_algorithms::geometry::pose::Pose;
use evermap_schemas::Cell;
use nalgebra::Vector3;

use crate::function::{Argument, Declaration, Kind, encoded, given, numbers, rows};

const POSITION: [&str; 3] = ["x", "y", "z"];
const QUATERNION: [&str; 4] = ["qx", "qy", "qz", "qw"];

const POSE: Argument = (
    "pose",
    Kind::Pose,
    "a pose of a layer, or a struct of a message with position and orientation",
);

/// The functions.
pub(crate) const DECLARATIONS: [Declaration; 9] = [
    Declaration {
        name: "pose",
        about: "The pose at x, y, z (m): level and turned by yaw (rad), or with the orientation of a quaternion",
        calls: &[
            &[
                ("x", Kind::Number, "position along x, m"),
                ("y", Kind::Number, "position along y, m"),
                ("z", Kind::Number, "position along z, m"),
                ("yaw", Kind::Number, "turn about z, counter-clockwise, rad"),
            ],
            &[
                ("x", Kind::Number, "position along x, m"),
                ("y", Kind::Number, "position along y, m"),
                ("z", Kind::Number, "position along z, m"),
                ("qx", Kind::Number, "quaternion, of any length but zero"),
                ("qy", Kind::Number, "quaternion"),
                ("qz", Kind::Number, "quaternion"),
                ("qw", Kind::Number, "quaternion, scalar part"),
            ],
        ],
        result: evermap_schemas::Pose::data_type,
        example: ["SELECT pose(1, 2, 0, 0)['x']", "1.0"],
        evaluate: made,
    },
    Declaration {
        name: "yaw",
        about: "Heading: the direction of the pose's x axis from above, rad in (-π, π], counter-clockwise from x",
        calls: &[&[POSE]],
        result: || DataType::Float64,
        example: ["SELECT round(yaw(pose(1, 2, 0, 0.5)), 6)", "0.5"],
        evaluate: |columns| angles(columns, Pose::yaw),
    },
    Declaration {
        name: "pitch",
        about: "Pitch: how far the pose's x axis points down, rad in [-π/2, π/2]",
        calls: &[&[POSE]],
        result: || DataType::Float64,
        example: [
            "SELECT round(pitch(pose(0, 0, 0, 0, sin(0.1), 0, cos(0.1))), 6)",
            "0.2",
        ],
        evaluate: |columns| angles(columns, |pose| pose.rotation.euler_angles().1),
    },
    Declaration {
        name: "roll",
        about: "Roll: the turn about the pose's x axis, rad in (-π, π]",
        calls: &[&[POSE]],
        result: || DataType::Float64,
        example: [
            "SELECT round(roll(pose(0, 0, 0, sin(0.1), 0, 0, cos(0.1))), 6)",
            "0.2",
        ],
        evaluate: |columns| angles(columns, |pose| pose.rotation.euler_angles().0),
    },
    Declaration {
        name: "transform",
        about: "A point of the pose's child frame in its parent frame, m: a struct of x, y, z",
        calls: &[&[
            POSE,
            ("x", Kind::Number, "the point along x, m"),
            ("y", Kind::Number, "the point along y, m"),
            ("z", Kind::Number, "the point along z, m"),
        ]],
        result: Point::data_type,
        example: [
            "SELECT round(transform(pose(1, 2, 0, pi() / 2), 3, 0, 0)['y'], 6)",
            "5.0",
        ],
        evaluate: transformed,
    },
    Declaration {
        name: "compose",
        about: "The pose a_from_c, of a_from_b and b_from_c",
        calls: &[&[
            ("a_from_b", Kind::Pose, "the outer pose"),
            ("b_from_c", Kind::Pose, "the inner pose"),
        ]],
        result: evermap_schemas::Pose::data_type,
        example: [
            "SELECT round(compose(pose(1, 0, 0, pi()), pose(1, 0, 0, 0))['x'], 6)",
            "0.0",
        ],
        evaluate: |columns| {
            let composed = pairs(columns, |a, b| a.compose(b))?;
            posed(composed)
        },
    },
    Declaration {
        name: "inverse",
        about: "The pose b_from_a, of a_from_b",
        calls: &[&[("a_from_b", Kind::Pose, "a pose")]],
        result: evermap_schemas::Pose::data_type,
        example: ["SELECT inverse(pose(1, 2, 3, 0))['z']", "-3.0"],
        evaluate: |columns| {
            let poses = Poses::of(columns.first())?;
            let inverse = |row| Ok(poses.get(row)?.map(|pose| pose.inverse()));
            posed((0..poses.rows).map(inverse).collect::<Result<_>>()?)
        },
    },
    Declaration {
        name: "pose_distance",
        about: "Distance between the origins of two poses, m",
        calls: &[&[
            ("a", Kind::Pose, "a pose"),
            ("b", Kind::Pose, "another pose"),
        ]],
        result: || DataType::Float64,
        example: [
            "SELECT pose_distance(pose(0, 0, 0, 0), pose(3, 4, 0, 1))",
            "5.0",
        ],
        evaluate: |columns| {
            let between = pairs(columns, |a, b| (a.translation - b.translation).norm())?;
            Ok(Arc::new(Float64Array::from(between)))
        },
    },
    Declaration {
        name: "pose_angle",
        about: "Angle of the turn between two poses, rad in [0, π]",
        calls: &[&[
            ("a", Kind::Pose, "a pose"),
            ("b", Kind::Pose, "another pose"),
        ]],
        result: || DataType::Float64,
        example: [
            "SELECT round(pose_angle(pose(0, 0, 0, 0), pose(3, 4, 0, 1)), 6)",
            "1.0",
        ],
        evaluate: |columns| {
            let between = pairs(columns, |a, b| a.rotation.angle_to(&b.rotation))?;
            Ok(Arc::new(Float64Array::from(between)))
        },
    },
];

/// Whether a type is that of a pose: seven numbers, or those of a message's `position` and `orientation`.
pub(crate) fn is_pose(data_type: &DataType) -> bool {
    let has = |data_type: &DataType, names: &[&str]| match data_type {
        DataType::Struct(fields) => names.iter().all(|name| {
            let found = fields.find(name);
            found.is_some_and(|(_, field)| field.data_type().is_numeric())
        }),
        _ => false,
    };
    let part = |name: &str| match data_type {
        DataType::Struct(fields) => fields.find(name).map(|(_, field)| field.data_type()),
        _ => None,
    };
    let is_row = has(data_type, &POSITION) && has(data_type, &QUATERNION);
    let is_message = part("position").is_some_and(|part| has(part, &POSITION))
        && part("orientation").is_some_and(|part| has(part, &["x", "y", "z", "w"]));
    is_row || is_message
}

/// A column of poses.
struct Poses {
    /// x, y, z, qx, qy, qz, qw.
    numbers: [Float64Array; 7],
    /// Where there is no pose, or not all of it.
    nulls: Option<NullBuffer>,
    rows: usize,
}

impl Poses {
    fn of(column: Option<&ArrayRef>) -> Result<Self> {
        let pose = column.and_then(|column| column.as_struct_opt());
        let pose = pose.ok_or_else(|| expected("a pose"))?;
        let (position, orientation, turns) = match pose.column_by_name("orientation") {
            None => (pose, pose, QUATERNION),
            Some(_) => {
                let (position, orientation) = (part(pose, "position")?, part(pose, "orientation")?);
                (
                    position.as_struct(),
                    orientation.as_struct(),
                    ["x", "y", "z", "w"],
                )
            }
        };
        let places = POSITION.map(|name| number(position, name));
        let turns = turns.map(|name| number(orientation, name));
        let numbers = places.into_iter().chain(turns);
        let numbers = numbers.collect::<Result<Vec<_>>>()?;
        let structs = [pose, position, orientation].map(Array::nulls);
        let nulls = numbers.iter().map(Array::nulls).chain(structs);
        Ok(Self {
            nulls: NullBuffer::union_many(nulls),
            numbers: numbers.try_into().map_err(|_| expected("a pose"))?,
            rows: pose.len(),
        })
    }

    fn get(&self, row: usize) -> Result<Option<Pose>> {
        if self.nulls.as_ref().is_some_and(|nulls| nulls.is_null(row)) {
            return Ok(None);
        }
        let numbers = std::array::from_fn(|index| self.numbers[index].value(row));
        pose(numbers).map(Some)
    }
}

fn pose(numbers: [f64; 7]) -> Result<Pose> {
    Pose::from_array(numbers).map_err(|error| DataFusionError::Execution(error.to_string()))
}

fn expected(what: &str) -> DataFusionError {
    DataFusionError::Execution(format!("expected {what}"))
}

fn part<'a>(parent: &'a StructArray, name: &str) -> Result<&'a ArrayRef> {
    let found = parent.column_by_name(name);
    found.ok_or_else(|| expected(&format!("a pose with {name}")))
}

fn number(parent: &StructArray, name: &str) -> Result<Float64Array> {
    let number = cast(part(parent, name)?, &DataType::Float64)?;
    Ok(number.as_primitive::<Float64Type>().clone())
}

/// A column of poses.
fn posed(poses: Vec<Option<Pose>>) -> Result<ArrayRef> {
    let stored = |pose: Pose| evermap_schemas::Pose::from_array(pose.to_array());
    let rows = poses.into_iter().map(|pose| pose.map(stored));
    encoded(rows.collect())
}

/// Something of each pair of poses.
fn pairs<T>(columns: &[ArrayRef], of: impl Fn(&Pose, &Pose) -> T) -> Result<Vec<Option<T>>> {
    let (left, right) = (Poses::of(columns.first())?, Poses::of(columns.get(1))?);
    let pair = |row| Ok(left.get(row)?.zip(right.get(row)?).map(|(a, b)| of(&a, &b)));
    (0..left.rows).map(pair).collect()
}

fn angles(columns: &[ArrayRef], angle: fn(&Pose) -> f64) -> Result<ArrayRef> {
    let poses = Poses::of(columns.first())?;
    numbers(poses.rows, |row| Ok(poses.get(row)?.as_ref().map(angle)))
}

fn made(columns: &[ArrayRef]) -> Result<ArrayRef> {
    let row = |row: usize| -> Result<Option<Pose>> {
        let numbers = match columns.len() {
            4 => given(columns, row).map(|[x, y, z, yaw]| {
                let mut level = Pose::from_yaw(x, y, yaw);
                level.translation.z = z;
                level.to_array()
            }),
            _ => given(columns, row),
        };
        numbers.map(pose).transpose()
    };
    posed((0..rows(columns)).map(row).collect::<Result<_>>()?)
}

evermap_schemas::record! {
    /// A point.
    pub struct Point {
        /// Along x.
        x: f64 ["m"],
        /// Along y.
        y: f64 ["m"],
        /// Along z.
        z: f64 ["m"],
    }
}

fn transformed(columns: &[ArrayRef]) -> Result<ArrayRef> {
    let [poses, coordinates @ ..] = columns else {
        return Err(expected("a pose and a point"));
    };
    let poses = Poses::of(Some(poses))?;
    let row = |row: usize| -> Result<Option<Point>> {
        let both = poses.get(row)?.zip(given::<3>(coordinates, row));
        Ok(both.map(|(pose, point)| {
            let moved = pose.transform(&Vector3::from(point));
            Point {
                x: moved.x,
                y: moved.y,
                z: moved.z,
            }
        }))
    };
    encoded((0..poses.rows).map(row).collect::<Result<_>>()?)
}
