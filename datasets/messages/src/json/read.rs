//! Values into columns, as they are met.

use super::compact::Compact;
use super::plan::{Object, Shape};
use super::{Name, malformed};
use crate::DecodeError;
use crate::budget::MessageBudget;
use crate::buffers::{Node, Pool, offset};
use base64::Engine;
use base64::alphabet::STANDARD;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use serde::de::{DeserializeSeed, Deserializer, Error, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde_json::error::Category;
use std::fmt;

const BASE64: GeneralPurpose = GeneralPurpose::new(
    &STANDARD,
    GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent),
);

/// The bytes that standard base64 stands for, with padding behind it or without.
///
/// # Errors
/// In words, when it is none.
pub fn bytes_of_base64(text: &[u8]) -> Result<Vec<u8>, String> {
    let bytes = BASE64.decode(text);
    bytes.map_err(|error| format!("expected base64, found {error}"))
}

/// Beyond 2^53 a float no longer says which whole number was meant.
const EXACT: f64 = 9_007_199_254_740_992.0;

/// Appends a payload as row `row` of a message's columns.
pub(super) fn message(
    shape: &Shape,
    payload: &[u8],
    node: &Node,
    row: usize,
    pool: &mut Pool,
) -> Result<(), DecodeError> {
    let mut sink = Sink {
        pool,
        budget: MessageBudget::of(payload),
        met: Vec::new(),
        text: Vec::new(),
        fault: None,
    };
    let mut reader = serde_json::Deserializer::from_slice(payload);
    let read = Slot {
        name: "(the payload)",
        shape,
        nullable: false,
        node,
        row,
        sink: &mut sink,
    }
    .deserialize(&mut reader);
    read.and_then(|()| reader.end())
        .map_err(|error| match (sink.fault.take(), error.classify()) {
            (Some(fault), Category::Data) => fault,
            _ => malformed(&error),
        })
}

/// Where values go.
struct Sink<'a> {
    pool: &'a mut Pool,
    budget: MessageBudget,
    /// Which properties were met: a stack, one stretch for each object that is open.
    met: Vec<bool>,
    /// Text on its way to a column.
    text: Vec<u8>,
    /// Why reading was stopped, where that is not for serde to say.
    fault: Option<DecodeError>,
}

impl Sink<'_> {
    /// Ends reading.
    fn stop<E: Error>(&mut self, fault: DecodeError) -> E {
        self.fault = Some(fault);
        E::custom("stopped")
    }

    fn checked<T, E: Error>(&mut self, outcome: Result<T, DecodeError>) -> Result<T, E> {
        outcome.map_err(|fault| self.stop(fault))
    }

    /// Appends the properties of an object as row `row`; what is not met is absent.
    fn object<'de, A: MapAccess<'de>>(
        &mut self,
        object: &Object,
        node: &Node,
        row: usize,
        mut members: A,
    ) -> Result<(), A::Error> {
        let paid = self.budget.spend(object.own_bytes);
        self.checked(paid)?;
        let base = self.met.len();
        self.met.resize(base + object.properties.len(), false);
        while let Some(place) = members.next_key_seed(Name(|name: &str| object.place(name)))? {
            let Some(place) = place else {
                members.next_value::<IgnoredAny>()?;
                continue;
            };
            let (name, shape) = &object.properties[place];
            let node = node.member(place);
            if std::mem::replace(&mut self.met[base + place], true) {
                // The last of a name counts.
                let paid = self.budget.spend(shape.fixed_bytes());
                self.checked(paid)?;
                node.truncate(self.pool, row);
            }
            members.next_value_seed(Slot {
                name,
                shape,
                nullable: true,
                node,
                row,
                sink: self,
            })?;
        }
        for (place, (_, shape)) in object.properties.iter().enumerate() {
            if !self.met[base + place] {
                let absent = self.absent(shape, node.member(place));
                self.checked(absent)?;
            }
        }
        self.met.truncate(base);
        Ok(())
    }

    fn absent(&mut self, shape: &Shape, node: &Node) -> Result<(), DecodeError> {
        if let Shape::Object(object) = shape {
            self.budget.spend(object.absent_bytes)?;
        }
        node.append_absent(self.pool);
        Ok(())
    }
}

/// One value, and the column that it goes to.
struct Slot<'a, 's> {
    name: &'a str,
    shape: &'a Shape,
    /// Whether it may be null, as a payload may not.
    nullable: bool,
    node: &'a Node,
    row: usize,
    sink: &'a mut Sink<'s>,
}

impl<'de> DeserializeSeed<'de> for Slot<'_, '_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        let Shape::Json = self.shape else {
            return deserializer.deserialize_any(self);
        };
        let mut text = std::mem::take(&mut self.sink.text);
        text.clear();
        Compact(&mut text).deserialize(deserializer)?;
        if text == b"null" {
            self.node.append_absent(self.sink.pool);
        } else {
            self.node.append_present(self.sink.pool);
            let appended = self.node.append_bytes(self.sink.pool, &text);
            self.sink.checked(appended)?;
        }
        self.sink.text = text;
        Ok(())
    }
}

impl Slot<'_, '_> {
    fn mismatch<E: Error>(self, found: String) -> E {
        let expected = match self.shape {
            Shape::Boolean => "true or false",
            Shape::Integer => "a whole number of 64 bits",
            Shape::Number => "a number",
            Shape::Base64 | Shape::Text => "a string",
            Shape::List(_) => "an array",
            Shape::Object(_) => "an object",
            Shape::Json => "any value",
        };
        self.sink.stop(mismatch(self.name, expected, found))
    }

    fn bytes<E: Error>(self, bytes: &[u8]) -> Result<(), E> {
        self.node.append_present(self.sink.pool);
        let appended = self.node.append_bytes(self.sink.pool, bytes);
        self.sink.checked(appended)
    }

    /// A number or flag, as a float and, where it is one, as a whole number.
    fn number<E: Error>(self, float: f64, whole: Option<i64>, found: String) -> Result<(), E> {
        match (self.shape, whole) {
            (Shape::Integer, Some(whole)) => {
                self.node.append_present(self.sink.pool);
                self.node.append_value(self.sink.pool, whole);
            }
            (Shape::Number, _) => {
                self.node.append_present(self.sink.pool);
                self.node.append_value(self.sink.pool, float);
            }
            _ => return Err(self.mismatch(found)),
        }
        Ok(())
    }
}

impl<'de> Visitor<'de> for Slot<'_, '_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("a value of the schema's type")
    }

    fn visit_unit<E: Error>(self) -> Result<(), E> {
        if !self.nullable {
            return Err(self.mismatch("null".to_owned()));
        }
        let absent = self.sink.absent(self.shape, self.node);
        self.sink.checked(absent)
    }

    /// A flag where a number is expected is 1 or 0: bridges of field buses give all values one type, `number`, and send coils
    /// and alarms as flags.
    fn visit_bool<E: Error>(self, value: bool) -> Result<(), E> {
        let Shape::Boolean = self.shape else {
            let number = u8::from(value);
            return self.number(
                f64::from(number),
                Some(i64::from(number)),
                value.to_string(),
            );
        };
        self.node.append_present(self.sink.pool);
        self.node.append_value(self.sink.pool, u8::from(value));
        Ok(())
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<(), E> {
        self.number(value as f64, Some(value), value.to_string())
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<(), E> {
        self.number(value as f64, i64::try_from(value).ok(), value.to_string())
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<(), E> {
        let exact = value.fract() == 0.0 && value.abs() <= EXACT;
        self.number(value, exact.then_some(value as i64), shown(&value))
    }

    fn visit_str<E: Error>(self, value: &str) -> Result<(), E> {
        match (self.shape, value) {
            (Shape::Text, _) => self.bytes(value.as_bytes()),
            (Shape::Base64, _) => match bytes_of_base64(value.as_bytes()) {
                Ok(bytes) => self.bytes(&bytes),
                Err(_) => Err(self.sink.stop(mismatch(self.name, "base64", shown(&value)))),
            },
            (Shape::Number, "NaN") => self.number(f64::NAN, None, String::new()),
            (Shape::Number, "Infinity") => self.number(f64::INFINITY, None, String::new()),
            (Shape::Number, "-Infinity") => self.number(f64::NEG_INFINITY, None, String::new()),
            _ => Err(self.mismatch(shown(&value))),
        }
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut values: A) -> Result<(), A::Error> {
        let Shape::List(item) = self.shape else {
            return Err(self.mismatch("an array".to_owned()));
        };
        self.node.append_present(self.sink.pool);
        let list = self.node;
        let first = list.elements(self.sink.pool);
        let mut count = 0;
        loop {
            let element = Slot {
                name: self.name,
                shape: item,
                nullable: true,
                node: list.element(),
                row: first + count,
                sink: self.sink,
            };
            if values.next_element_seed(element)?.is_none() {
                break;
            }
            count += 1;
            let paid = self.sink.budget.spend(item.own_bytes());
            let ended = paid.and_then(|()| offset(first + count));
            self.sink.checked(ended)?;
        }
        let ended = list.end_list(self.sink.pool, count);
        self.sink.checked(ended)
    }

    fn visit_map<A: MapAccess<'de>>(self, members: A) -> Result<(), A::Error> {
        let Shape::Object(object) = self.shape else {
            return Err(self.mismatch("an object".to_owned()));
        };
        self.node.append_present(self.sink.pool);
        self.sink.object(object, self.node, self.row, members)
    }
}

/// A value as a message shows it.
fn shown(value: &impl serde::Serialize) -> String {
    let text = serde_json::to_string(value).unwrap_or_default();
    text.chars().take(60).collect()
}

fn mismatch(field: &str, expected: &str, found: String) -> DecodeError {
    DecodeError::Mismatch {
        field: field.to_owned(),
        expected: expected.to_owned(),
        found,
    }
}
