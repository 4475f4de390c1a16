//! The compiled decoder against a naive one that walks the tree of types, over random
//! schemas, values and byte orders, and under corruption.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use arrow::array::{Array, ArrayRef, AsArray};
use arrow::datatypes::*;
use evermap_messages::{Decoder, MessageType};
use proptest::prelude::*;

/// A type, as a ROS 2 definition can say it.
#[derive(Debug, Clone)]
enum Type {
    Number(&'static str, usize),
    Text,
    Sequence(Box<Type>),
    Array(Box<Type>, usize),
    Message(Vec<Type>),
}

/// A value in the test's own terms; numbers by their bits.
#[derive(Debug, Clone, PartialEq)]
enum Value {
    Bits(u64),
    Text(String),
    List(Vec<Value>),
}

const NUMBERS: [(&str, usize); 11] = [
    ("bool", 1),
    ("int8", 1),
    ("uint8", 1),
    ("int16", 2),
    ("uint16", 2),
    ("int32", 4),
    ("uint32", 4),
    ("int64", 8),
    ("uint64", 8),
    ("float32", 4),
    ("float64", 8),
];

fn scalar() -> impl Strategy<Value = Type> {
    prop_oneof![
        4 => (0..NUMBERS.len()).prop_map(|n| Type::Number(NUMBERS[n].0, NUMBERS[n].1)),
        1 => Just(Type::Text),
    ]
}

/// ROS has no lists of lists, so lists hold scalars or messages.
fn member() -> impl Strategy<Value = Type> {
    let message = prop::collection::vec(scalar(), 0..3).prop_map(Type::Message);
    let item = prop_oneof![3 => scalar(), 1 => message];
    let item = item.prop_recursive(3, 24, 4, |inner| {
        let member = wrapped(inner);
        prop::collection::vec(member, 0..4).prop_map(Type::Message)
    });
    wrapped(item)
}

fn wrapped(item: impl Strategy<Value = Type> + Clone) -> impl Strategy<Value = Type> {
    (item, 0..4_usize, 1..5_usize).prop_map(|(item, how, size)| match how {
        0 => Type::Sequence(Box::new(item)),
        1 => Type::Array(Box::new(item), size),
        _ => item,
    })
}

/// Values from a stream of random words, so that one strategy serves all types.
struct Words<'a>(&'a [u64], usize);

impl Words<'_> {
    fn next(&mut self) -> u64 {
        self.1 += 1;
        let word = self.0[self.1 % self.0.len()];
        word.rotate_left((self.1 % 64) as u32) ^ (self.1 as u64)
    }
}

fn value(of: &Type, words: &mut Words) -> Value {
    match of {
        Type::Number("bool", _) => Value::Bits(words.next() & 1),
        Type::Number(_, 8) => Value::Bits(words.next()),
        Type::Number(_, width) => Value::Bits(words.next() & ((1 << (8 * width)) - 1)),
        Type::Text => Value::Text("aé€z".chars().take(words.next() as usize % 5).collect()),
        Type::Sequence(item) => {
            let count = words.next() % 4;
            Value::List((0..count).map(|_| value(item, words)).collect())
        }
        Type::Array(item, size) => Value::List((0..*size).map(|_| value(item, words)).collect()),
        Type::Message(members) => Value::List(members.iter().map(|m| value(m, words)).collect()),
    }
}

/// The text of a message, its nested ones after it.
fn definition(members: &[Type]) -> String {
    let mut text = String::new();
    let mut pending = vec![("M".to_owned(), members.to_vec())];
    let mut named = 0;
    while let Some((name, members)) = pending.pop() {
        if name != "M" {
            text += &format!("================\nMSG: t/{name}\n");
        }
        for (index, member) in members.iter().enumerate() {
            let (item, suffix) = match member {
                Type::Sequence(item) => (item.as_ref(), "[]".to_owned()),
                Type::Array(item, size) => (item.as_ref(), format!("[{size}]")),
                other => (other, String::new()),
            };
            let item = match item {
                Type::Number(name, _) => (*name).to_owned(),
                Type::Text => "string".to_owned(),
                Type::Message(inner) => {
                    named += 1;
                    pending.push((format!("N{named}"), inner.clone()));
                    format!("N{named}")
                }
                _ => unreachable!("lists of lists are not generated"),
            };
            text += &format!("{item}{suffix} m{index}\n");
        }
    }
    text
}

struct Writer {
    bytes: Vec<u8>,
    big: bool,
}

impl Writer {
    fn number(&mut self, bits: u64, width: usize) {
        while !(self.bytes.len() - 4).is_multiple_of(width) {
            self.bytes.push(0);
        }
        if self.big {
            self.bytes.extend(&bits.to_be_bytes()[8 - width..]);
        } else {
            self.bytes.extend(&bits.to_le_bytes()[..width]);
        }
    }

    fn write(&mut self, of: &Type, value: &Value) {
        match (of, value) {
            (Type::Number(_, width), Value::Bits(bits)) => self.number(*bits, *width),
            (Type::Text, Value::Text(text)) => {
                self.number(text.len() as u64 + 1, 4);
                self.bytes.extend(text.as_bytes());
                self.bytes.push(0);
            }
            (Type::Sequence(item), Value::List(values)) => {
                self.number(values.len() as u64, 4);
                values.iter().for_each(|v| self.write(item, v));
            }
            (Type::Array(item, _), Value::List(values)) => {
                values.iter().for_each(|v| self.write(item, v));
            }
            (Type::Message(members), Value::List(values)) => {
                if members.is_empty() {
                    self.bytes.push(0);
                }
                let pairs = members.iter().zip(values);
                pairs.for_each(|(m, v)| self.write(m, v));
            }
            _ => unreachable!("values follow their types"),
        }
    }
}

fn encode(members: &[Type], values: &[Value], big: bool) -> Vec<u8> {
    let bytes = vec![0, u8::from(!big), 0, 0];
    let mut writer = Writer { bytes, big };
    let message = Type::Message(members.to_vec());
    writer.write(&message, &Value::List(values.to_vec()));
    writer.bytes
}

/// The naive reference: one value at a time, from the tree of types.
struct Naive<'a> {
    bytes: &'a [u8],
    at: usize,
    big: bool,
}

impl Naive<'_> {
    fn number(&mut self, width: usize) -> Option<u64> {
        self.at = self.at.next_multiple_of(width);
        let raw = self.bytes.get(self.at..self.at + width)?;
        self.at += width;
        let fold = |sum, byte: &u8| (sum << 8) | u64::from(*byte);
        Some(if self.big {
            raw.iter().fold(0, fold)
        } else {
            raw.iter().rev().fold(0, fold)
        })
    }

    fn read(&mut self, of: &Type) -> Option<Value> {
        Some(match of {
            Type::Number("bool", _) => Value::Bits(u64::from(self.number(1)? != 0)),
            Type::Number(_, width) => Value::Bits(self.number(*width)?),
            Type::Text => {
                let length = self.number(4)? as usize;
                let raw = self.bytes.get(self.at..self.at.checked_add(length)?)?;
                self.at += length;
                let raw = raw.strip_suffix(&[0]).unwrap_or(raw);
                Value::Text(String::from_utf8_lossy(raw).into_owned())
            }
            Type::Sequence(item) => {
                let count = self.number(4)?;
                (count as usize <= self.bytes.len()).then_some(())?;
                Value::List((0..count).map(|_| self.read(item)).collect::<Option<_>>()?)
            }
            Type::Array(item, size) => {
                Value::List((0..*size).map(|_| self.read(item)).collect::<Option<_>>()?)
            }
            Type::Message(members) => {
                if members.is_empty() {
                    self.number(1)?;
                }
                let values = members.iter().map(|m| self.read(m));
                Value::List(values.collect::<Option<_>>()?)
            }
        })
    }
}

fn naive(members: &[Type], payload: &[u8]) -> Option<Vec<Value>> {
    let header = payload.get(..4)?;
    (header[0] == 0 && header[1] < 2).then_some(())?;
    let mut reader = Naive {
        bytes: &payload[4..],
        at: 0,
        big: header[1] == 0,
    };
    if members.is_empty() {
        reader.number(1)?;
    }
    members.iter().map(|m| reader.read(m)).collect()
}

fn shown(column: &ArrayRef, row: usize) -> Value {
    let list =
        |values: ArrayRef| Value::List((0..values.len()).map(|i| shown(&values, i)).collect());
    let octets =
        |bytes: &[u8]| Value::List(bytes.iter().map(|b| Value::Bits(u64::from(*b))).collect());
    match column.data_type() {
        DataType::Boolean => Value::Bits(u64::from(column.as_boolean().value(row))),
        DataType::Int8 => Value::Bits(column.as_primitive::<Int8Type>().value(row) as u8 as u64),
        DataType::UInt8 => Value::Bits(column.as_primitive::<UInt8Type>().value(row) as u64),
        DataType::Int16 => Value::Bits(column.as_primitive::<Int16Type>().value(row) as u16 as u64),
        DataType::UInt16 => Value::Bits(column.as_primitive::<UInt16Type>().value(row) as u64),
        DataType::Int32 => Value::Bits(column.as_primitive::<Int32Type>().value(row) as u32 as u64),
        DataType::UInt32 => Value::Bits(column.as_primitive::<UInt32Type>().value(row) as u64),
        DataType::Int64 => Value::Bits(column.as_primitive::<Int64Type>().value(row) as u64),
        DataType::UInt64 => Value::Bits(column.as_primitive::<UInt64Type>().value(row)),
        DataType::Float32 => Value::Bits(u64::from(
            column.as_primitive::<Float32Type>().value(row).to_bits(),
        )),
        DataType::Float64 => Value::Bits(column.as_primitive::<Float64Type>().value(row).to_bits()),
        DataType::Utf8 => Value::Text(column.as_string::<i32>().value(row).to_owned()),
        DataType::BinaryView => octets(column.as_binary_view().value(row)),
        DataType::FixedSizeBinary(_) => octets(column.as_fixed_size_binary().value(row)),
        DataType::List(_) => list(column.as_list::<i32>().value(row)),
        DataType::FixedSizeList(_, _) => list(column.as_fixed_size_list().value(row)),
        DataType::Struct(_) => {
            let columns = column.as_struct().columns();
            Value::List(columns.iter().map(|c| shown(c, row)).collect())
        }
        other => panic!("no {other} in ROS"),
    }
}

fn check(decoder: &mut Decoder, expected: &[Vec<Value>], projection: &[usize]) {
    assert_eq!(decoder.len(), expected.len());
    let columns = decoder.finish().unwrap();
    assert_eq!(columns.len(), projection.len());
    for (column, member) in columns.iter().zip(projection) {
        column.to_data().validate_full().unwrap();
        assert_eq!(column.len(), expected.len());
        for (row, values) in expected.iter().enumerate() {
            assert_eq!(shown(column, row), values[*member]);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    #[test]
    fn compiled_and_naive_agree(
        members in prop::collection::vec(member(), 0..6),
        words in prop::collection::vec(any::<u64>(), 8),
        big in any::<bool>(),
        mask in any::<u8>(),
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..40),
    ) {
        let text = definition(&members);
        let message = MessageType::parse("cdr", "ros2msg", "t/msg/M", text.as_bytes()).unwrap();
        let all: Vec<usize> = (0..members.len()).collect();
        let some: Vec<usize> = all.iter().rev().copied().filter(|i| mask >> i & 1 == 1).collect();
        let mut whole = message.decoder(None);
        let mut part = message.decoder(Some(&some));
        let mut words = Words(&words, 0);
        let mut expected = Vec::new();
        let mut feed = |payload: &[u8], expected: &mut Vec<Vec<Value>>| {
            let reference = naive(&members, payload);
            let accepted = whole.push(payload).is_ok();
            assert_eq!(accepted, reference.is_some(), "{payload:?}");
            assert_eq!(part.push(payload).is_ok(), accepted);
            expected.extend(reference);
            assert_eq!((whole.len(), part.len()), (expected.len(), expected.len()));
        };
        for _ in 0..3 {
            let values: Vec<Value> = members.iter().map(|m| value(m, &mut words)).collect();
            let payload = encode(&members, &values, big);
            prop_assert_eq!(naive(&members, &payload), Some(values.clone()));
            feed(&payload, &mut expected);
            for cut in 0..payload.len() {
                feed(&payload[..cut], &mut expected);
            }
            for (place, byte) in &damage {
                let mut bad = payload.clone();
                if bad.len() > 4 {
                *place.get_mut(&mut bad[4..]) = *byte;
            }
                feed(&bad, &mut expected);
            }
        }
        check(&mut whole, &expected, &all);
        check(&mut part, &expected, &some);
    }
}
