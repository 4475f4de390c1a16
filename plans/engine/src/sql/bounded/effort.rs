//! What a call takes in time, as its arguments say before it is begun.
//!
//! Named here are the functions that take more than in proportion to the bytes of a row. All others of DataFusion take a few
//! steps a byte, so that a batch, which is bounded by the memory, is done in seconds: texts are searched by tables, or by a
//! literal (`replace`, `contains`, `split_part`), sets of lists are hashed (`array_distinct`, `array_union`,
//! `array_intersect`, `array_except`, `map`), `array_sort` sorts, `regexp_like` and `regexp_match` look for one place. Ours
//! that are not named read a geometry, a pose or a graph once or sort its corners (`st_convexhull`).

use std::ops::Range;

use arrow::array::{Array, ArrayRef, AsArray};
use arrow::datatypes::DataType;
use datafusion::common::Result;
use datafusion::logical_expr::ColumnarValue;
use evermap_schemas::Fault;

use crate::error::external;
use crate::nodes::weight::bytes;

/// Steps of some nanoseconds that one row may take: tens of seconds.
const MOST_STEPS: f64 = 1e10;

/// Steps after which it is asked whether somebody still waits: a moment, and thousands of rows of what is not long.
const STEPS_AT_ONCE: f64 = 1e8;

/// Bytes of a corner in well-known binary, at least.
const CORNER_BYTES: f64 = 16.0;

/// Steps that two edges take to be compared.
const EDGES_STEPS: f64 = 4.0;

/// Bytes that are compared in a step.
const COMPARED_BYTES: f64 = 16.0;

/// Of the steps that an expression may take at worst, one in so many is counted: of what matches as usual a slice shall be
/// worth compiling it for.
const EXPRESSION_SHARE: f64 = 100.0;

/// Pairs of values so few that it does not matter how long they are.
const FEW_PAIRS: f64 = 1e4;

/// How the steps of a row grow with its arguments.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Effort {
    /// As their bytes do.
    Plain,
    /// Each byte of the first text meets each of the second: `levenshtein`, and `btrim`, whose second has the letters to
    /// remove.
    Texts,
    /// `strpos(text, part)`: from each byte of the text on it is compared with the part.
    Searched,
    /// `array_has_all(list, list)`, `array_has_any`: each value of one meets each of the other.
    Lists,
    /// `st_distance(a, b)`: each edge of one meets each of the other, unless a box tells them apart.
    Edges,
    /// `st_union(a, b)`: pairs of edges, but the function itself refuses those that are near each other too often.
    Tangled,
    /// `related(graph, …)`: each area meets each other one.
    Areas,
    /// `regexp_replace(text, …)`, where it looks for every place: at worst each look goes to the end of the text. What is
    /// usual takes far less, so that it is never refused: rows are cut, and a long text ends between two places.
    Places,
}

/// Functions that take more than in proportion to their arguments.
const LONG: [(&str, Effort); 26] = [
    ("levenshtein", Effort::Texts),
    ("btrim", Effort::Texts),
    ("ltrim", Effort::Texts),
    ("rtrim", Effort::Texts),
    ("strpos", Effort::Searched),
    ("array_has_all", Effort::Lists),
    ("array_has_any", Effort::Lists),
    ("regexp_count", Effort::Places),
    ("regexp_instr", Effort::Places),
    ("regexp_replace", Effort::Places),
    ("st_distance", Effort::Edges),
    ("st_dwithin", Effort::Edges),
    ("st_hausdorffdistance", Effort::Edges),
    ("st_intersects", Effort::Edges),
    ("st_contains", Effort::Tangled),
    ("st_within", Effort::Tangled),
    ("st_disjoint", Effort::Tangled),
    ("st_touches", Effort::Tangled),
    ("st_crosses", Effort::Tangled),
    ("st_overlaps", Effort::Tangled),
    ("st_equals", Effort::Tangled),
    ("st_buffer", Effort::Tangled),
    ("st_intersection", Effort::Tangled),
    ("st_union", Effort::Tangled),
    ("st_difference", Effort::Tangled),
    ("related", Effort::Areas),
];

impl Effort {
    /// That of a function.
    pub fn of(name: &str) -> Self {
        let mut known = LONG.iter().filter(|(known, _)| *known == name);
        known.next().map_or(Self::Plain, |(_, effort)| *effort)
    }

    /// The rows of a call in slices that take a moment each, or have one row.
    ///
    /// # Errors
    /// When an argument cannot be read, or one row alone would take too long.
    pub fn slices(
        self,
        name: &str,
        args: &[ColumnarValue],
        rows: usize,
    ) -> Result<Vec<Range<usize>>> {
        if self == Self::Plain {
            return Ok(evenly(args, rows));
        }
        let args: Vec<Argument> = args.iter().map(Argument::new).collect::<Result<_>>()?;
        if self.is_short(&args) {
            return Ok(std::iter::once(0..rows).collect());
        }
        let mut slices = Vec::new();
        let (mut from, mut taken) = (0, 0.0);
        for row in 0..rows {
            let steps = self.steps(&args, row);
            if steps > MOST_STEPS && self.is_certain() {
                return Err(external(self.refused(name, &args, row, steps)));
            }
            if taken + steps > STEPS_AT_ONCE && row > from {
                slices.push(from..row);
                (from, taken) = (row, 0.0);
            }
            taken += steps;
        }
        slices.push(from..rows);
        Ok(slices)
    }

    /// Whether all rows together take no more than a moment, as can be told of texts at once.
    fn is_short(self, args: &[Argument]) -> bool {
        let size = |index: usize| args.get(index).map_or(0.0, Argument::size);
        let steps = match self {
            Self::Texts | Self::Searched => size(0) * size(1),
            // One text for all rows is read again for each.
            Self::Places if args.first().is_some_and(|text| !text.is_one) => {
                size(0).powi(2) / EXPRESSION_SHARE
            }
            _ => return false,
        };
        steps <= STEPS_AT_ONCE
    }

    /// Steps of a row at most.
    fn steps(self, args: &[Argument], row: usize) -> f64 {
        let length = |index: usize| args.get(index).map_or(0.0, |arg| arg.length(row));
        let corners = |index: usize| length(index) / CORNER_BYTES;
        match self {
            Self::Plain => 0.0,
            Self::Texts => length(0) * length(1),
            Self::Searched => length(0) * length(1) / COMPARED_BYTES,
            Self::Lists => match (length(0) * length(1), args.get(1)) {
                (pairs, Some(second)) if pairs > FEW_PAIRS => {
                    pairs + length(0) * second.bytes(row) / COMPARED_BYTES
                }
                (pairs, _) => pairs,
            },
            Self::Edges => EDGES_STEPS * corners(0) * corners(1),
            Self::Tangled => (corners(0) + corners(1)).powi(2),
            Self::Areas => length(0).powi(2),
            Self::Places => length(0).powi(2) / EXPRESSION_SHARE,
        }
    }

    /// Whether a row may really take so many steps.
    fn is_certain(self) -> bool {
        !matches!(self, Self::Plain | Self::Tangled | Self::Places)
    }

    /// That a row would take too long.
    fn refused(self, name: &str, args: &[Argument], row: usize, steps: f64) -> Fault {
        let number = if self == Self::Areas { 1 } else { 2 };
        let lengths = args.iter().take(number).map(|arg| arg.length(row));
        let lengths: Vec<String> = lengths.map(|length| format!("{length:.0}")).collect();
        let (unit, next) = match self {
            Self::Lists => (
                "values",
                "join the rows of unnest(…) instead, or give it shorter lists",
            ),
            Self::Edges => (
                "bytes",
                "cut the geometries apart with st_intersection and st_makeenvelope, or give it simpler ones",
            ),
            Self::Areas => ("areas", "leave out graphs of so many areas"),
            _ => ("bytes", "give it shorter texts, such as left(text, 10000)"),
        };
        let lengths = lengths.join(" and ");
        Fault::resource(format!(
            "{name} would take {steps:.0} steps for one row, of {lengths} {unit}; the limit is {MOST_STEPS:.0}"
        ))
        .next(next)
    }
}

/// Rows in slices of one length: what is one value for all of them is read again for each.
fn evenly(args: &[ColumnarValue], rows: usize) -> Vec<Range<usize>> {
    let size = |arg: &ColumnarValue| match arg {
        ColumnarValue::Array(_) => 0,
        ColumnarValue::Scalar(value) => value.size(),
    };
    let steps: usize = args.iter().map(size).sum();
    let at_once = (STEPS_AT_ONCE as usize / steps.max(1)).max(1);
    let starts = (0..rows).step_by(at_once);
    starts.map(|from| from..rows.min(from + at_once)).collect()
}

/// An argument: a value for each row, or one for all.
struct Argument {
    column: ArrayRef,
    is_one: bool,
}

impl Argument {
    fn new(arg: &ColumnarValue) -> Result<Self> {
        let (column, is_one) = match arg {
            ColumnarValue::Array(column) => (ArrayRef::clone(column), false),
            ColumnarValue::Scalar(value) => (value.to_array()?, true),
        };
        Ok(Self { column, is_one })
    }

    fn at(&self, row: usize) -> usize {
        if self.is_one { 0 } else { row }
    }

    /// How long it is: bytes of a text or a geometry, values of a list, areas of a graph; 0 of others and of null.
    fn length(&self, row: usize) -> f64 {
        let (column, row) = (&self.column, self.at(row));
        if column.is_null(row) {
            return 0.0;
        }
        match column.data_type() {
            DataType::Utf8 => f64::from(column.as_string::<i32>().value_length(row)),
            DataType::LargeUtf8 => column.as_string::<i64>().value_length(row) as f64,
            DataType::Utf8View => column.as_string_view().value(row).len() as f64,
            DataType::Binary => f64::from(column.as_binary::<i32>().value_length(row)),
            DataType::LargeBinary => column.as_binary::<i64>().value_length(row) as f64,
            DataType::BinaryView => column.as_binary_view().value(row).len() as f64,
            DataType::List(_) => f64::from(column.as_list::<i32>().value_length(row)),
            DataType::LargeList(_) => column.as_list::<i64>().value_length(row) as f64,
            DataType::FixedSizeList(_, values) => f64::from(*values),
            DataType::Struct(_) => {
                let areas = column.as_struct().column_by_name("areas");
                let areas = areas.and_then(|areas| areas.as_list_opt::<i32>());
                areas.map_or(0.0, |areas| f64::from(areas.value_length(row)))
            }
            _ => 0.0,
        }
    }

    /// Bytes of all its values.
    fn size(&self) -> f64 {
        bytes(&self.column) as f64
    }

    /// Bytes of its value in a row.
    fn bytes(&self, row: usize) -> f64 {
        bytes(&self.column.slice(self.at(row), 1)) as f64
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::sync::Arc;

    use arrow::array::{BinaryArray, ListArray, StringArray, StringViewArray};
    use arrow::datatypes::Int64Type;
    use datafusion::scalar::ScalarValue;

    use super::*;

    fn column(column: impl Array + 'static) -> ColumnarValue {
        ColumnarValue::Array(Arc::new(column))
    }

    /// Where slices end.
    fn ends(name: &str, args: &[ColumnarValue], rows: usize) -> Result<Vec<usize>> {
        let slices = Effort::of(name).slices(name, args, rows)?;
        Ok(slices.into_iter().map(|slice| slice.end).collect())
    }

    #[test]
    fn rows_are_cut_where_they_take_a_moment_together() {
        let letters = |lengths: &[usize]| {
            let texts = lengths.iter().map(|length| Some("a".repeat(*length)));
            texts.collect::<StringArray>()
        };
        let one = ColumnarValue::Scalar(ScalarValue::from("b".repeat(10_000)));
        let lengths = [10, 4_000, 5_000, 2_000, 20_000, 0, 9_000];
        let args = [column(letters(&lengths)), one.clone()];
        assert_eq!(ends("levenshtein", &args, 7).unwrap(), [3, 4, 5, 7]);
        // What is short is one piece, as is what takes no longer than it is.
        let short = [column(letters(&[10; 8192])), column(letters(&[10; 8192]))];
        assert_eq!(ends("levenshtein", &short, 8192).unwrap(), [8192]);
        assert_eq!(ends("upper", &args, 7).unwrap(), [7]);
        assert_eq!(ends("levenshtein", &args[1..], 1).unwrap(), [1]);
        let none = [column(letters(&[])), one];
        assert_eq!(ends("levenshtein", &none, 0).unwrap(), [0]);
        let text = ColumnarValue::Scalar(ScalarValue::from("b".repeat(100_000)));
        let args = [text, column(letters(&[1; 3]))];
        assert_eq!(ends("regexp_count", &args, 3).unwrap(), [1, 2, 3]);
        // One value that each row reads again.
        let long = ColumnarValue::Scalar(ScalarValue::from("b".repeat(40_000_000)));
        let args = [column(letters(&[1; 5])), long];
        assert_eq!(ends("contains", &args, 5).unwrap(), [2, 4, 5]);
    }

    #[test]
    fn a_row_that_alone_takes_too_long_is_refused_with_how_long_it_is() {
        let texts = |length: usize| {
            let texts: StringViewArray = [None, Some("a".repeat(length))].into_iter().collect();
            column(texts)
        };
        let lists = |values: i64| {
            let values = [Some((0..values).map(Some).collect::<Vec<_>>())];
            column(ListArray::from_iter_primitive::<Int64Type, _, _>(values))
        };
        let geometries = |bytes: usize| column(BinaryArray::from_iter_values([vec![0_u8; bytes]]));
        for (name, args, rows, says) in [
            (
                "levenshtein",
                [texts(200_000), texts(100_000)],
                2,
                "levenshtein would take 20000000000 steps for one row, of 200000 and 100000 bytes; the limit is 10000000000",
            ),
            (
                "btrim",
                [texts(200_000), texts(100_000)],
                2,
                "give it shorter texts",
            ),
            (
                "array_has_any",
                [lists(200_000), lists(100_000)],
                1,
                "of 200000 and 100000 values",
            ),
            (
                "st_distance",
                [geometries(1_600_000), geometries(1_600_000)],
                1,
                "would take 40000000000 steps",
            ),
        ] {
            let told = ends(name, &args, rows).unwrap_err().to_string();
            assert!(told.contains(says), "{name}: {told}");
        }
        // What refuses itself, or is quick as a rule, is cut and not refused.
        let great = geometries(8_000_000);
        assert!(ends("st_union", &[great.clone(), great], 1).is_ok());
        assert!(ends("regexp_replace", &[texts(8_000_000), texts(1)], 2).is_ok());
        let shorter = [texts(100_000), texts(99_000)];
        assert_eq!(ends("levenshtein", &shorter, 2).unwrap(), [1, 2]);
    }
}
