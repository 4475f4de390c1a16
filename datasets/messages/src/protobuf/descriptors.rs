//! Protobuf descriptors, read from a serialised `FileDescriptorSet` as far as decoding needs them.
//!
//! A set from a log may be anything: files that import themselves, options that are redefined, messages within
//! messages without end. So it is read with the reader of payloads, and what is kept is a tree of names, made in
//! time and memory proportional to the set. Imports are not followed: a type is whatever the set calls so.
//!
//! Sources: `google/protobuf/descriptor.proto`; protobuf.dev, "Feature Settings for Editions".

use super::wire::{Value, WireReader};
use crate::budget::SchemaBudget;
use crate::error::shown;
use crate::{DecodeError, SchemaError};
use std::collections::HashMap;

/// Messages within messages, in the set.
const MAX_NESTING: usize = 64;

/// How absence is told, and how messages lie on the wire: what an edition's features say of decoding.
#[derive(Debug, Clone, Copy, Default)]
struct Features {
    /// Absent numbers and strings differ from zero and empty ones.
    explicit: bool,
    /// Messages are groups.
    delimited: bool,
}

/// One field.
#[derive(Debug, Clone, Copy)]
pub(super) struct FieldDescriptor<'a> {
    pub(super) name: &'a str,
    pub(super) number: u32,
    /// As `FieldDescriptorProto.Type` numbers them; 0 where only the type's name is given.
    pub(super) kind: u64,
    pub(super) type_name: &'a str,
    pub(super) repeated: bool,
    pub(super) oneof: Option<usize>,
    /// Absence is told from zero.
    pub(super) presence: bool,
    /// A message lies between tags, not behind a length. Maps and what is in them never do.
    pub(super) delimited: bool,
}

/// One message.
#[derive(Debug, Clone, Copy)]
pub(super) struct MessageDescriptor<'a> {
    parts: Parts<'a>,
    features: Features,
    /// Whether it is an entry of a map.
    pub(super) map_entry: bool,
}

/// A package, a message or an enumeration.
#[derive(Debug, Default)]
struct Scope<'a> {
    parent: usize,
    message: Option<MessageDescriptor<'a>>,
    enumeration: bool,
}

/// All types of a set, by their place in a tree of names.
#[derive(Debug)]
pub(super) struct Descriptors<'a> {
    schema: String,
    scopes: Vec<Scope<'a>>,
    children: HashMap<(usize, &'a str), usize>,
    pub(super) budget: SchemaBudget,
}

/// What a field's type name means.
pub(super) enum ResolvedType {
    /// The message of this number.
    Message(usize),
    Enumeration,
}

/// The fields of one serialised message, which is sound.
#[derive(Debug, Clone, Copy)]
struct Parts<'a>(&'a [u8]);

impl<'a> Parts<'a> {
    fn read(bytes: &'a [u8]) -> Result<Self, DecodeError> {
        let mut reader = WireReader::new(bytes);
        while reader.field()?.is_some() {}
        Ok(Self(bytes))
    }

    fn all(self, number: u32) -> impl Iterator<Item = Value<'a>> {
        let mut reader = WireReader::new(self.0);
        let parts = std::iter::from_fn(move || reader.field().ok().flatten());
        parts.filter_map(move |(known, value)| (known == number).then_some(value))
    }

    fn messages(self, number: u32) -> impl Iterator<Item = &'a [u8]> {
        self.all(number).filter_map(Value::bytes)
    }

    fn text(self, number: u32) -> &'a str {
        let bytes = self.messages(number).last().unwrap_or_default();
        std::str::from_utf8(bytes).unwrap_or_default()
    }

    fn number(self, number: u32) -> Option<u64> {
        let numbers = self.all(number).filter_map(|value| match value {
            Value::Varint(found) => Some(found),
            _ => None,
        });
        numbers.last()
    }
}

impl<'a> Descriptors<'a> {
    /// The types of `set`, for the message `schema`.
    pub(super) fn read(schema: &str, set: &'a [u8]) -> Result<Self, SchemaError> {
        let mut found = Self {
            schema: schema.to_owned(),
            scopes: vec![Scope::default()],
            children: HashMap::new(),
            budget: SchemaBudget::of_descriptors(schema, set)?,
        };
        for file in found.parts(set)?.messages(1) {
            found.file(file)?;
        }
        Ok(found)
    }

    fn parts(&self, bytes: &'a [u8]) -> Result<Parts<'a>, SchemaError> {
        Parts::read(bytes).map_err(|error| {
            self.refused(format!(
                "expected a serialised FileDescriptorSet, found: {error}"
            ))
        })
    }

    fn refused(&self, reason: String) -> SchemaError {
        SchemaError::refused(&self.schema, reason)
    }

    fn file(&mut self, bytes: &'a [u8]) -> Result<(), SchemaError> {
        let file = self.parts(bytes)?;
        let features = match file.text(12) {
            "proto3" => Features {
                explicit: false,
                delimited: false,
            },
            // Editions begin with what proto2 does, but for required fields.
            "" | "proto2" | "editions" => Features {
                explicit: true,
                delimited: false,
            },
            other => {
                return Err(self.refused(format!(
                    "expected the syntax proto2, proto3 or editions, found '{other}'"
                )));
            }
        };
        let features = self.features(file, 8, 50, features)?;
        let mut scope = 0;
        for name in file.text(2).split('.').filter(|name| !name.is_empty()) {
            scope = self.child(scope, name)?;
        }
        for message in file.messages(4) {
            self.message(message, scope, features, 0)?;
        }
        for enumeration in file.messages(5) {
            self.enumeration(enumeration, scope)?;
        }
        Ok(())
    }

    /// What the options in field `options`, whose features are in `number`, make of inherited features.
    fn features(
        &self,
        of: Parts<'a>,
        options: u32,
        number: u32,
        inherited: Features,
    ) -> Result<Features, SchemaError> {
        let mut features = inherited;
        for options in of.messages(options) {
            for set in self.parts(options)?.messages(number) {
                let set = self.parts(set)?;
                // FeatureSet.field_presence: EXPLICIT, IMPLICIT, LEGACY_REQUIRED; message_encoding: LENGTH_PREFIXED,
                // DELIMITED.
                if let Some(presence) = set.number(1) {
                    features.explicit = presence != 2;
                }
                if let Some(encoding) = set.number(5) {
                    features.delimited = encoding == 2;
                }
            }
        }
        Ok(features)
    }

    /// The scope of this name within another.
    fn child(&mut self, parent: usize, name: &'a str) -> Result<usize, SchemaError> {
        self.budget.spend(name.len() + 1)?;
        let next = self.scopes.len();
        let scope = *self.children.entry((parent, name)).or_insert(next);
        if scope == next {
            self.scopes.push(Scope {
                parent,
                ..Scope::default()
            });
        }
        Ok(scope)
    }

    fn enumeration(&mut self, bytes: &'a [u8], parent: usize) -> Result<(), SchemaError> {
        let name = self.parts(bytes)?.text(1);
        let scope = self.child(parent, name)?;
        self.scopes[scope].enumeration = true;
        Ok(())
    }

    fn message(
        &mut self,
        bytes: &'a [u8],
        parent: usize,
        features: Features,
        depth: usize,
    ) -> Result<(), SchemaError> {
        if depth > MAX_NESTING {
            return Err(self.refused(format!(
                "expected at most {MAX_NESTING} messages within each other, found more"
            )));
        }
        let parts = self.parts(bytes)?;
        let scope = self.child(parent, parts.text(1))?;
        if self.scopes[scope].message.is_some() {
            // Recorders repeat definitions; the first of a name stays.
            return Ok(());
        }
        let features = self.features(parts, 7, 12, features)?;
        let mut map_entry = false;
        for options in parts.messages(7) {
            map_entry |= self.parts(options)?.number(7) == Some(1);
        }
        self.scopes[scope].message = Some(MessageDescriptor {
            parts,
            features,
            map_entry,
        });
        for nested in parts.messages(3) {
            self.message(nested, scope, features, depth + 1)?;
        }
        for enumeration in parts.messages(4) {
            self.enumeration(enumeration, scope)?;
        }
        Ok(())
    }

    /// The message of this number.
    pub(super) fn message_at(&self, scope: usize) -> Option<MessageDescriptor<'a>> {
        self.scopes.get(scope)?.message
    }

    /// The fields of a message, as declared.
    pub(super) fn fields(
        &self,
        message: MessageDescriptor<'a>,
    ) -> impl Iterator<Item = Result<FieldDescriptor<'a>, SchemaError>> {
        let fields = message.parts.messages(2);
        fields.map(move |field| self.field(field, message.features))
    }

    fn field(
        &self,
        bytes: &'a [u8],
        inherited: Features,
    ) -> Result<FieldDescriptor<'a>, SchemaError> {
        let parts = self.parts(bytes)?;
        let name = parts.text(1);
        let number = parts
            .number(3)
            .and_then(|number| u32::try_from(number).ok());
        let Some(number @ 1..=0x1FFF_FFFF) = number else {
            return Err(self.refused(format!(
                "expected a number from 1 to 536870911 for the field '{name}', found none"
            )));
        };
        let features = self.features(parts, 8, 21, inherited)?;
        let kind = parts.number(5).unwrap_or(0);
        let label = parts.number(4).unwrap_or(1);
        let oneof = parts
            .number(9)
            .and_then(|index| usize::try_from(index).ok());
        let optional = parts.number(17) == Some(1) || label == 2;
        Ok(FieldDescriptor {
            name,
            number,
            kind,
            type_name: parts.text(6),
            repeated: label == 3,
            oneof,
            presence: features.explicit || oneof.is_some() || optional,
            delimited: features.delimited,
        })
    }

    /// The message that is called so in full.
    pub(super) fn message_named(&mut self, name: &str) -> Result<usize, SchemaError> {
        match self.lookup(0, name)? {
            Some(ResolvedType::Message(scope)) => Ok(scope),
            _ => Err(self.unknown(name)),
        }
    }

    /// What a type name means in a message: the full name behind a dot, else a name looked for from the innermost
    /// scope outwards.
    pub(super) fn resolve(
        &mut self,
        within: usize,
        name: &str,
    ) -> Result<ResolvedType, SchemaError> {
        let mut scope = within;
        if let Some(full) = name.strip_prefix('.') {
            return self.lookup(0, full)?.ok_or_else(|| self.unknown(full));
        }
        loop {
            if let Some(found) = self.lookup(scope, name)? {
                return Ok(found);
            }
            if scope == 0 {
                return Err(self.unknown(name));
            }
            scope = self.scopes[scope].parent;
        }
    }

    fn lookup(&mut self, from: usize, name: &str) -> Result<Option<ResolvedType>, SchemaError> {
        let mut scope = from;
        for part in name.split('.') {
            self.budget.spend(part.len() + 1)?;
            match self.children.get(&(scope, part)) {
                Some(child) => scope = *child,
                None => return Ok(None),
            }
        }
        let found = &self.scopes[scope];
        Ok(match (&found.message, found.enumeration) {
            (Some(_), _) => Some(ResolvedType::Message(scope)),
            (None, true) => Some(ResolvedType::Enumeration),
            (None, false) => None,
        })
    }

    fn unknown(&self, missing: &str) -> SchemaError {
        SchemaError::UnknownType {
            schema: self.schema.clone(),
            missing: shown(missing),
        }
    }
}
