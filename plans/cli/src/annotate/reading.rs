//! JSON of strangers, read for what is looked for in it. The rest is passed over, and held by nobody: a number takes many
//! times its two bytes where all of a file becomes values.

use std::fmt::{Display, Formatter};
use std::marker::PhantomData;

use evermap_algorithms::labels::shapes::MOST_POINTS;
use evermap_schemas::Fault;
use serde::de::{Deserialize, Deserializer, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde_json::{Number, Value};

use super::features::TOO_MANY_POINTS;
use super::is_blank;

/// A file has no more features than this; nor pictures, kinds or annotations.
pub(super) const MOST_FEATURES: usize = 500_000;

/// What is read of a value that may be anything: it begins as of `null`, and takes what it knows.
pub(super) trait Lenient: Default {
    /// What is there. Elements and members follow of a list and an object.
    fn found(&mut self, _: JsonToken<'_>) {}

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

/// What a value is that is not `null`, before what is in it.
pub(super) enum JsonToken<'a> {
    Truth(bool),
    Number(Number),
    Text(&'a str),
    List,
    Object,
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

/// Reads the elements of a text that is a list, one after the other.
///
/// # Errors
/// For what is no JSON, or no list.
pub(super) fn each<R: Lenient>(text: &str, take: impl FnMut(R)) -> serde_json::Result<()> {
    let mut from = serde_json::Deserializer::from_str(text);
    from.deserialize_seq(EachVisitor(take, PhantomData))?;
    from.end()
}

struct EachVisitor<R, F>(F, PhantomData<R>);

impl<'de, R: Lenient, F: FnMut(R)> Visitor<'de> for EachVisitor<R, F> {
    type Value = ();

    fn expecting(&self, to: &mut Formatter<'_>) -> std::fmt::Result {
        to.write_str("a list")
    }

    fn visit_seq<A: SeqAccess<'de>>(mut self, mut list: A) -> Result<(), A::Error> {
        while let Some(AnyJson(element)) = list.next_element()? {
            (self.0)(element);
        }
        Ok(())
    }
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
    fn found(mut self, token: JsonToken<'_>) -> R {
        self.0.found(token);
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

    fn visit_bool<E>(self, truth: bool) -> Result<R, E> {
        Ok(self.found(JsonToken::Truth(truth)))
    }

    fn visit_i64<E>(self, value: i64) -> Result<R, E> {
        Ok(self.found(JsonToken::Number(value.into())))
    }

    fn visit_u64<E>(self, value: u64) -> Result<R, E> {
        Ok(self.found(JsonToken::Number(value.into())))
    }

    fn visit_f64<E>(self, value: f64) -> Result<R, E> {
        Ok(match Number::from_f64(value) {
            Some(number) => self.found(JsonToken::Number(number)),
            None => self.0,
        })
    }

    fn visit_str<E>(self, text: &str) -> Result<R, E> {
        Ok(self.found(JsonToken::Text(text)))
    }

    fn visit_seq<A: SeqAccess<'de>>(mut self, mut list: A) -> Result<R, A::Error> {
        self.0.found(JsonToken::List);
        while self.0.element(&mut list)?.is_some() {}
        Ok(self.0)
    }

    fn visit_map<A: MapAccess<'de>>(mut self, mut object: A) -> Result<R, A::Error> {
        self.0.found(JsonToken::Object);
        while let Some(name) = object.next_key::<String>()? {
            self.0.member(&name, &mut object)?;
        }
        Ok(self.0)
    }
}

/// What an object has under a name. Of a list or an object it is only known that there is one.
#[derive(Debug, Clone, Default, PartialEq, Eq, Hash)]
pub(super) enum Member {
    #[default]
    Nothing,
    Truth(bool),
    Number(Number),
    Text(String),
    List,
    Object,
}

impl Lenient for Member {
    fn found(&mut self, token: JsonToken<'_>) {
        *self = match token {
            JsonToken::Truth(truth) => Self::Truth(truth),
            JsonToken::Number(number) => Self::Number(number),
            JsonToken::Text(text) => Self::Text(text.to_owned()),
            JsonToken::List => Self::List,
            JsonToken::Object => Self::Object,
        };
    }
}

/// As JSON has it.
impl Display for Member {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Nothing => f.write_str("null"),
            Self::Truth(truth) => truth.fmt(f),
            Self::Number(number) => number.fmt(f),
            Self::Text(text) => Value::from(text.as_str()).fmt(f),
            Self::List => f.write_str("a list"),
            Self::Object => f.write_str("an object"),
        }
    }
}

impl Member {
    /// Whether there is a list of this name.
    ///
    /// # Errors
    /// A user fault for what is none: who reads nothing of it takes for gone what is there.
    pub(super) fn is_list(&self, name: &str) -> Result<bool, Fault> {
        let found = match self {
            Self::Nothing => return Ok(false),
            Self::List => return Ok(true),
            Self::Object => "an object",
            Self::Text(_) => "a text",
            Self::Number(_) => "a number",
            Self::Truth(_) => "true or false",
        };
        let fault = format!("expected a list of {name}, found {found}");
        Err(Fault::user(fault).next("export it from the program anew, as it writes it"))
    }

    /// A number, or what else is there, as the file has it; `None` where nothing is.
    pub(super) fn written(&self) -> Option<String> {
        match self {
            Self::Nothing => None,
            Self::Text(text) => Some(text.clone()),
            other => Some(other.to_string()),
        }
    }

    /// A text, if it is one.
    pub(super) fn text(&self) -> Option<&str> {
        match self {
            Self::Text(text) => Some(text),
            _ => None,
        }
    }

    /// A text that is not blank, or a number as text.
    pub(super) fn word(&self) -> Option<String> {
        match self {
            Self::Text(text) if !is_blank(text) => Some(text.clone()),
            Self::Number(number) => Some(number.to_string()),
            _ => None,
        }
    }

    /// A number, if it is one.
    pub(super) fn number(&self) -> Option<f64> {
        match self {
            Self::Number(number) => number.as_f64(),
            _ => None,
        }
    }
}

/// What is to be a list: the first of its elements, `MOST` at most.
#[derive(Debug)]
pub(super) struct Listed<T, const MOST: usize = MOST_FEATURES> {
    /// What is there.
    pub(super) is: Member,
    pub(super) first: Vec<T>,
    pub(super) count: usize,
}

impl<T, const MOST: usize> Default for Listed<T, MOST> {
    fn default() -> Self {
        Self {
            is: Member::Nothing,
            first: Vec::new(),
            count: 0,
        }
    }
}

impl<T: Lenient, const MOST: usize> Lenient for Listed<T, MOST> {
    fn found(&mut self, token: JsonToken<'_>) {
        self.is.found(token);
    }

    fn element<'de, A: SeqAccess<'de>>(&mut self, list: &mut A) -> Result<Option<()>, A::Error> {
        let found = match self.count < MOST {
            true => {
                let found = list.next_element::<AnyJson<T>>()?;
                found.map(|AnyJson(one)| self.first.push(one))
            }
            false => passed(list)?,
        };
        self.count += usize::from(found.is_some());
        Ok(found)
    }
}

impl<T> Listed<T> {
    /// All elements; `None` where there is no list of this name.
    ///
    /// # Errors
    /// As [`Member::is_list`] and [`not_more`].
    pub(super) fn if_there(self, name: &str) -> Result<Option<Vec<T>>, Fault> {
        match self.is.is_list(name)? {
            true => self.all(name).map(Some),
            false => Ok(None),
        }
    }

    /// All elements.
    ///
    /// # Errors
    /// As [`not_more`].
    pub(super) fn all(self, name: &str) -> Result<Vec<T>, Fault> {
        not_more(self.count, name)?;
        Ok(self.first)
    }
}

/// Holds the number of what a list has to how many there may be.
///
/// # Errors
/// A user fault for more.
pub(super) fn not_more(found: usize, name: &str) -> Result<(), Fault> {
    match found > MOST_FEATURES {
        false => Ok(()),
        true => {
            let fault = format!("expected at most {MOST_FEATURES} {name}, found {found}");
            Err(Fault::user(fault).next("make several files of it"))
        }
    }
}

/// The points of an outline, no more than one may have, or why it is none.
#[derive(Debug)]
pub(super) struct OutlinePoints<P>(Result<Vec<P>, &'static str>);

impl<P> Default for OutlinePoints<P> {
    fn default() -> Self {
        Self(Ok(Vec::new()))
    }
}

impl<P: PartialEq> OutlinePoints<P> {
    /// One more. What is written twice in a row is one, where there are many.
    pub(super) fn add(&mut self, point: P) {
        let Ok(points) = &mut self.0 else {
            return;
        };
        if points.len() == MOST_POINTS {
            points.dedup();
        }
        match () {
            () if points.len() < MOST_POINTS => points.push(point),
            () if points.last() == Some(&point) => {}
            () => self.end(TOO_MANY_POINTS),
        }
    }

    /// It is no outline, for this reason or one before.
    pub(super) fn end(&mut self, fault: &'static str) {
        if self.0.is_ok() {
            self.0 = Err(fault);
        }
    }

    pub(super) fn all(self) -> Result<Vec<P>, &'static str> {
        self.0
    }
}
