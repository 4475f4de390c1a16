//! What the answer of a function takes, as its arguments say before it is made.

use arrow::array::{Array, ArrayRef, AsArray, Int64Array};
use arrow::compute::cast;
use arrow::compute::kernels::length::length;
use arrow::datatypes::{
    DataType, Int64Type, IntervalMonthDayNano, IntervalMonthDayNanoType, IntervalUnit, TimeUnit,
};
use datafusion::common::Result;
use datafusion::logical_expr::ColumnarValue;

use crate::nodes::weight::bytes;

/// How an answer grows with its arguments.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Growth {
    /// As they do: it is a few times larger at most.
    Plain,
    /// `repeat(text, count)`, `array_repeat(value, count)`.
    Copies,
    /// `lpad(text, letters, fill)`, `rpad`: letters of four bytes at most.
    Letters,
    /// `replace(text, from, to)`: every letter may become the third text.
    Replaced,
    /// `regexp_replace(text, pattern, to, flags)`: one place becomes the third text, with `g` every letter, and each group
    /// that it names (`\\1`) has the whole text at most, of all places together.
    Rewritten,
    /// `array_replace_all(list, from, to)`: every value may become the third.
    Exchanged,
    /// `range(from, to, step)`, `generate_series`: numbers, days or instants of eight bytes.
    Numbers,
    /// `array_resize(list, count, value)`.
    Resized,
    /// `array_to_string(list, between)`: values, numbers in some twenty letters, with a text between them.
    Joined,
    /// `concat_ws(between, texts…)`: all texts, with the first between them.
    Separated,
    /// `concat(texts…)`, `array_concat(lists…)`, `make_array(values…)`, `a || b`: all of them, in each row.
    Together,
}

/// Functions that grow beyond their arguments, or put several together.
pub const GROWING: [(&str, Growth); 26] = [
    ("repeat", Growth::Copies),
    ("array_repeat", Growth::Copies),
    ("list_repeat", Growth::Copies),
    ("lpad", Growth::Letters),
    ("rpad", Growth::Letters),
    ("replace", Growth::Replaced),
    ("regexp_replace", Growth::Rewritten),
    ("array_replace", Growth::Exchanged),
    ("array_replace_n", Growth::Exchanged),
    ("array_replace_all", Growth::Exchanged),
    ("range", Growth::Numbers),
    ("generate_series", Growth::Numbers),
    ("array_resize", Growth::Resized),
    ("list_resize", Growth::Resized),
    ("array_to_string", Growth::Joined),
    ("list_to_string", Growth::Joined),
    ("array_join", Growth::Joined),
    ("list_join", Growth::Joined),
    ("concat_ws", Growth::Separated),
    ("concat", Growth::Together),
    ("array_concat", Growth::Together),
    ("array_append", Growth::Together),
    ("array_prepend", Growth::Together),
    ("array_union", Growth::Together),
    ("make_array", Growth::Together),
    ("||", Growth::Together),
];

impl Growth {
    /// That of a function.
    pub fn of(name: &str) -> Self {
        let mut known = GROWING.iter().filter(|(known, _)| *known == name);
        known.next().map_or(Self::Plain, |(_, growth)| *growth)
    }

    /// Whether an answer may be far smaller than is said of it: what matches is known behind the call.
    pub fn is_vague(self) -> bool {
        matches!(self, Self::Replaced | Self::Rewritten)
    }

    /// Bytes of the answer of so many rows, at least about; `None` where it is no larger than the arguments say.
    ///
    /// # Errors
    /// When an argument cannot be read.
    pub fn answer(self, args: &[ColumnarValue], rows: usize) -> Result<Option<f64>> {
        // Where nothing varies, there is one answer, however many rows there are.
        let varies = args
            .iter()
            .any(|arg| matches!(arg, ColumnarValue::Array(_)));
        let rows = if varies { rows } else { 1 };
        match self {
            Self::Plain => Ok(None),
            Self::Together => {
                let all = args.iter().map(|arg| together(arg, rows));
                Ok(Some(all.sum::<Result<f64>>()?))
            }
            _ => {
                let args: Vec<Argument> = args.iter().map(Argument::new).collect::<Result<_>>()?;
                Ok(Some((0..rows).map(|row| self.row(&args, row)).sum()))
            }
        }
    }

    /// Bytes of the answer of one row.
    fn row(self, args: &[Argument], row: usize) -> f64 {
        let number = |index: usize| args.get(index)?.number(row);
        let size = |index: usize| args.get(index)?.size(row);
        let text = |index: usize| size(index).unwrap_or(0.0);
        let values = || args.first().and_then(|list| list.values(row));
        let count = number(1).unwrap_or(0.0).max(0.0);
        match self {
            Self::Plain | Self::Together => 0.0,
            Self::Copies => size(0).unwrap_or(8.0) * count,
            Self::Letters => 4.0 * count,
            Self::Replaced => text(0) * (1.0 + text(2)) / text(1).max(1.0),
            Self::Rewritten => {
                let flags = args.get(3).and_then(|flags| flags.text(row));
                let places = match flags.is_some_and(|flags| flags.contains('g')) {
                    true => text(0) + 1.0,
                    false => 1.0,
                };
                let to = args.get(2).and_then(|to| to.text(row)).unwrap_or_default();
                let groups = to.matches(['\\', '$']).count() as f64;
                text(0) * (1.0 + groups) + places * text(2)
            }
            Self::Exchanged => text(0) + values().unwrap_or(0.0) * text(2),
            Self::Numbers => {
                let (from, to) = match (number(0), number(1)) {
                    (Some(from), Some(to)) => (from, to),
                    (to, _) => (0.0, to.unwrap_or(0.0)),
                };
                8.0 * ((to - from) / number(2).unwrap_or(1.0)).max(0.0)
            }
            Self::Resized => size(2).unwrap_or(8.0) * count,
            Self::Joined => 2.5 * text(0) + values().unwrap_or(0.0) * text(1),
            Self::Separated => {
                let texts = (1..args.len()).map(|index| text(0) + text(index));
                texts.sum()
            }
        }
    }
}

/// Bytes of all arguments, as they are there.
///
/// # Errors
/// When an argument cannot be read.
pub fn given(args: &[ColumnarValue]) -> Result<f64> {
    let all = args.iter().map(|arg| together(arg, 1));
    all.sum()
}

/// Bytes of an argument in so many rows.
fn together(arg: &ColumnarValue, rows: usize) -> Result<f64> {
    Ok(match arg {
        ColumnarValue::Array(column) => bytes(column) as f64,
        ColumnarValue::Scalar(value) => rows as f64 * bytes(&value.to_array()?) as f64,
    })
}

/// An argument: a value for each row, or one for all.
pub struct Argument {
    is_one: bool,
    column: ArrayRef,
    numbers: Option<Int64Array>,
    sizes: Option<Int64Array>,
    values: Option<Int64Array>,
}

impl Argument {
    /// An argument of a call.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn new(arg: &ColumnarValue) -> Result<Self> {
        let (column, is_one) = match arg {
            ColumnarValue::Array(column) => (ArrayRef::clone(column), false),
            ColumnarValue::Scalar(value) => (value.to_array()?, true),
        };
        let is_list = column.data_type().is_list();
        let values = || integers(&length(&column).ok()?);
        Ok(Self {
            is_one,
            numbers: integers(&column),
            sizes: sizes(&column),
            values: is_list.then(values).flatten(),
            column,
        })
    }

    fn at(&self, column: &Option<Int64Array>, row: usize) -> Option<f64> {
        let row = if self.is_one { 0 } else { row };
        let column = column.as_ref().filter(|column| column.is_valid(row))?;
        Some(column.value(row) as f64)
    }

    /// It as a text; `None` for null, and for what is none.
    pub fn text(&self, row: usize) -> Option<&str> {
        let row = if self.is_one { 0 } else { row };
        if !self.column.is_valid(row) {
            return None;
        }
        match self.column.data_type() {
            DataType::Utf8 => Some(self.column.as_string::<i32>().value(row)),
            DataType::LargeUtf8 => Some(self.column.as_string::<i64>().value(row)),
            DataType::Utf8View => Some(self.column.as_string_view().value(row)),
            _ => None,
        }
    }

    /// It as a number; `None` for null, and for what is none.
    pub fn number(&self, row: usize) -> Option<f64> {
        self.at(&self.numbers, row)
    }

    /// Bytes of a text, or of a list's values.
    fn size(&self, row: usize) -> Option<f64> {
        self.at(&self.sizes, row)
    }

    /// How many values a list has.
    fn values(&self, row: usize) -> Option<f64> {
        self.at(&self.values, row)
    }
}

/// A column of integers; of instants, days and intervals in nanoseconds; `None` for another.
fn integers(column: &ArrayRef) -> Option<Int64Array> {
    let kind = match column.data_type() {
        kind if kind.is_integer() => DataType::Int64,
        DataType::Timestamp(..) | DataType::Date32 | DataType::Date64 => {
            DataType::Timestamp(TimeUnit::Nanosecond, None)
        }
        DataType::Interval(_) => return intervals(column),
        _ => return None,
    };
    // Days too far for nanoseconds are null, and bounded by nothing: they are a few million.
    let column = cast(&cast(column, &kind).ok()?, &DataType::Int64).ok()?;
    Some(column.as_primitive::<Int64Type>().clone())
}

fn intervals(column: &ArrayRef) -> Option<Int64Array> {
    const DAY_NS: i64 = 86_400_000_000_000;
    let whole = DataType::Interval(IntervalUnit::MonthDayNano);
    let column = cast(column, &whole).ok()?;
    let spans = column.as_primitive::<IntervalMonthDayNanoType>().iter();
    let span = |span: Option<IntervalMonthDayNano>| {
        let span = span?;
        let days = i64::from(span.months) * 28 + i64::from(span.days);
        Some(days.saturating_mul(DAY_NS).saturating_add(span.nanoseconds))
    };
    Some(spans.map(span).collect())
}

/// How long the texts of a column are, bytes; of lists how many bytes their values take; `None` for a column of others.
fn sizes(column: &ArrayRef) -> Option<Int64Array> {
    let viewed = |lengths: &mut dyn Iterator<Item = u32>| {
        Int64Array::from_iter_values(lengths.map(i64::from))
    };
    match column.data_type() {
        DataType::Utf8View => Some(viewed(&mut column.as_string_view().lengths())),
        DataType::BinaryView => Some(viewed(&mut column.as_binary_view().lengths())),
        kind if kind.is_list() => {
            let rows = (0..column.len()).map(|row| bytes(&column.slice(row, 1)) as i64);
            Some(rows.collect())
        }
        _ => integers(&length(column).ok()?),
    }
}
