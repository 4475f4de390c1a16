//! JSON of strangers, read for what is looked for in it. The rest is passed over, and held by nobody: a number takes many
//! times its two bytes where all of a file becomes values.

use std::fmt::Formatter;

use serde::de::{Deserialize, Deserializer, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde_json::Number;

/// What is read of a value that may be anything: it begins as of `null`, and takes what it knows.
pub(super) trait Lenient: Default {
    /// That something is there, whatever it is.
    fn found(&mut self) {}

    /// What is no list and no object.
    fn scalar(&mut self, _: JsonScalar<'_>) {
        self.found();
    }

    /// That a list begins.
    fn list(&mut self) {
        self.found();
    }

    /// That an object begins.
    fn object(&mut self) {
        self.found();
    }

    /// The next element of a list; `None` behind its end.
    ///
    /// # Errors
    /// For what is no JSON.
    fn element<'de, A: SeqAccess<'de>>(&mut self, list: &mut A) -> Result<Option<()>, A::Error> {
        passed(list)
    }

    /// The value of an object's member of this name; where a name is there twice, the last one counts.
    ///
    /// # Errors
    /// For what is no JSON.
    fn member<'de, A: MapAccess<'de>>(&mut self, _: &str, object: &mut A) -> Result<(), A::Error> {
        skipped(object)
    }
}

/// A text, a number, true or false.
pub(super) enum JsonScalar<'a> {
    Truth,
    Number(Number),
    Text(&'a str),
}

/// Passes over the next element of a list; `None` behind its end.
///
/// # Errors
/// For what is no JSON.
pub(super) fn passed<'de, A: SeqAccess<'de>>(list: &mut A) -> Result<Option<()>, A::Error> {
    Ok(list.next_element::<IgnoredAny>()?.map(drop))
}

/// Passes over the value of a member.
///
/// # Errors
/// For what is no JSON.
pub(super) fn skipped<'de, A: MapAccess<'de>>(object: &mut A) -> Result<(), A::Error> {
    object.next_value::<IgnoredAny>().map(drop)
}

/// Reads the value of a member.
///
/// # Errors
/// For what is no JSON.
pub(super) fn value<'de, R: Lenient, A: MapAccess<'de>>(object: &mut A) -> Result<R, A::Error> {
    object.next_value::<AnyJson<R>>().map(|read| read.0)
}

/// What was read of a value.
pub(super) struct AnyJson<R>(pub(super) R);

impl<'de, R: Lenient> Deserialize<'de> for AnyJson<R> {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        from.deserialize_any(LenientVisitor(R::default())).map(Self)
    }
}

struct LenientVisitor<R>(R);

impl<R: Lenient> LenientVisitor<R> {
    fn scalar(mut self, scalar: JsonScalar<'_>) -> R {
        self.0.scalar(scalar);
        self.0
    }
}

impl<'de, R: Lenient> Visitor<'de> for LenientVisitor<R> {
    type Value = R;

    fn expecting(&self, to: &mut Formatter<'_>) -> std::fmt::Result {
        to.write_str("JSON")
    }

    fn visit_unit<E>(self) -> Result<R, E> {
        Ok(self.0)
    }

    fn visit_bool<E>(self, _: bool) -> Result<R, E> {
        Ok(self.scalar(JsonScalar::Truth))
    }

    fn visit_i64<E>(self, value: i64) -> Result<R, E> {
        Ok(self.scalar(JsonScalar::Number(value.into())))
    }

    fn visit_u64<E>(self, value: u64) -> Result<R, E> {
        Ok(self.scalar(JsonScalar::Number(value.into())))
    }

    fn visit_f64<E>(self, value: f64) -> Result<R, E> {
        Ok(match Number::from_f64(value) {
            Some(number) => self.scalar(JsonScalar::Number(number)),
            None => self.0,
        })
    }

    fn visit_str<E>(self, text: &str) -> Result<R, E> {
        Ok(self.scalar(JsonScalar::Text(text)))
    }

    fn visit_seq<A: SeqAccess<'de>>(mut self, mut list: A) -> Result<R, A::Error> {
        self.0.list();
        while self.0.element(&mut list)?.is_some() {}
        Ok(self.0)
    }

    fn visit_map<A: MapAccess<'de>>(mut self, mut object: A) -> Result<R, A::Error> {
        self.0.object();
        while let Some(name) = object.next_key::<String>()? {
            self.0.member(&name, &mut object)?;
        }
        Ok(self.0)
    }
}
