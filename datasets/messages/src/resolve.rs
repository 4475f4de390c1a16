//! From declarations that name each other to one finite message type.

use crate::budget::SchemaBudget;
use crate::error::shown;
use crate::wire::{Extensibility, StructType, Wire};
use crate::{MAX_DEPTH, SchemaError};
use arrow::datatypes::DataType;
use std::collections::{HashMap, HashSet};
use std::sync::Arc;

/// Bytes of one fixed-size member.
const MAX_FIXED_BYTES: u64 = i32::MAX as u64;

/// A type as written.
#[derive(Debug, Clone)]
pub(crate) enum Declared {
    Wire(Wire),
    /// Full names to try, best first.
    Named(Arc<[String]>),
    Sequence(Box<Declared>),
    Array(Box<Declared>, u64),
}

/// A member as written.
#[derive(Debug, Clone)]
pub(crate) struct Member {
    pub(crate) name: String,
    pub(crate) declared: Declared,
}

/// A struct as written.
#[derive(Debug, Clone)]
pub(crate) struct Declaration {
    pub(crate) name: String,
    pub(crate) members: Vec<Member>,
    pub(crate) extensibility: Extensibility,
}

impl Member {
    pub(crate) fn new(name: &str, declared: Declared) -> Self {
        Member {
            name: name.to_owned(),
            declared,
        }
    }
}

impl Declaration {
    pub(crate) fn new(name: &str, extensibility: Extensibility) -> Self {
        Declaration {
            name: name.to_owned(),
            members: Vec::new(),
            extensibility,
        }
    }

    /// A type that recorders may leave out because every installation has it.
    pub(crate) fn builtin(name: &str, members: &[(&str, Declared)]) -> Self {
        let members = members.iter().cloned();
        Declaration {
            members: members.map(|(name, of)| Member::new(name, of)).collect(),
            ..Declaration::new(name, Extensibility::Final)
        }
    }

    /// A built-in time or duration: seconds and what is over.
    pub(crate) fn time(name: &str, parts: [(&str, DataType); 2]) -> Self {
        let parts = parts.map(|(name, of)| (name, Declared::Wire(Wire::Scalar(of))));
        Declaration::builtin(name, &parts)
    }
}

/// All declarations of a schema.
pub(crate) struct Library {
    schema: String,
    pub(crate) budget: SchemaBudget,
    /// Members of all structs.
    members: usize,
    structs: HashMap<String, Declaration>,
    aliases: HashMap<String, Declared>,
    done: HashMap<String, Arc<StructType>>,
    open: Vec<String>,
}

impl Library {
    /// An empty library for the definition `text`.
    pub(crate) fn new(schema: &str, text: &[u8]) -> Result<Self, SchemaError> {
        Ok(Library {
            schema: schema.to_owned(),
            budget: SchemaBudget::of_text(schema, text)?,
            members: 0,
            structs: HashMap::new(),
            aliases: HashMap::new(),
            done: HashMap::new(),
            open: Vec::new(),
        })
    }

    /// Counts a member, before it is kept.
    pub(crate) fn count_member(&mut self) -> Result<(), SchemaError> {
        self.members += 1;
        self.budget.check_columns(self.members)
    }

    /// Adds a struct; the first of a name stays, as recorders repeat definitions.
    pub(crate) fn add(&mut self, declaration: Declaration) {
        self.structs
            .entry(declaration.name.clone())
            .or_insert(declaration);
    }

    /// Adds another name for a type.
    pub(crate) fn add_alias(&mut self, name: String, declared: Declared) {
        self.aliases.entry(name).or_insert(declared);
    }

    /// The first of `names` that is a struct, with all it uses.
    pub(crate) fn resolve_first(self, names: &[String]) -> Result<Arc<StructType>, SchemaError> {
        let known = names.iter().find(|name| self.structs.contains_key(*name));
        let root = known.or(names.first()).cloned().unwrap_or_default();
        self.resolve(&root)
    }

    /// The message `root` with all it uses.
    pub(crate) fn resolve(mut self, root: &str) -> Result<Arc<StructType>, SchemaError> {
        if !self.structs.contains_key(root) {
            return Err(self.unknown(root));
        }
        self.structure(root)
    }

    fn structure(&mut self, name: &str) -> Result<Arc<StructType>, SchemaError> {
        if let Some(done) = self.done.get(name) {
            return Ok(done.clone());
        }
        self.enter(name)?;
        let Some(declaration) = self.structs.remove(name) else {
            return Err(self.unknown(name));
        };
        let mut members: Vec<(String, Wire)> = Vec::with_capacity(declaration.members.len());
        let mut names = HashSet::with_capacity(declaration.members.len());
        for member in &declaration.members {
            if !names.insert(member.name.as_str()) {
                return Err(self.refused(format!(
                    "expected distinct member names, found '{}' twice in '{name}'",
                    member.name
                )));
            }
            members.push((member.name.clone(), self.wire(&member.declared)?));
        }
        self.open.pop();
        let built = StructType::new(members, declaration.extensibility);
        self.budget.check_columns(built.columns)?;
        if built.depth > MAX_DEPTH {
            return Err(self.too_deep());
        }
        let done = Arc::new(built);
        self.done.insert(name.to_owned(), done.clone());
        Ok(done)
    }

    fn enter(&mut self, name: &str) -> Result<(), SchemaError> {
        if self.open.iter().any(|open| open == name) {
            return Err(SchemaError::Recursive {
                schema: self.schema.clone(),
                recursive: shown(name),
            });
        }
        if self.open.len() >= MAX_DEPTH {
            return Err(self.too_deep());
        }
        self.open.push(name.to_owned());
        Ok(())
    }

    fn wire(&mut self, declared: &Declared) -> Result<Wire, SchemaError> {
        match declared {
            Declared::Wire(wire) => Ok(wire.clone()),
            Declared::Sequence(item) => Ok(Wire::Sequence(Arc::new(self.wire(item)?))),
            Declared::Array(item, size) => {
                let item = self.wire(item)?;
                self.check_array(&item, *size)?;
                Ok(Wire::Array(Arc::new(item), *size as usize))
            }
            Declared::Named(names) => self.named(names),
        }
    }

    fn named(&mut self, names: &[String]) -> Result<Wire, SchemaError> {
        for name in names {
            self.budget.spend(name.len())?;
            if let Some(alias) = self.aliases.get(name).cloned() {
                self.enter(name)?;
                let wire = self.wire(&alias)?;
                self.open.pop();
                return Ok(wire);
            }
            let known = self.structs.contains_key(name)
                || self.done.contains_key(name)
                || self.open.contains(name);
            if known {
                return Ok(Wire::Struct(self.structure(name)?));
            }
        }
        Err(self.unknown(names.first().map_or("", String::as_str)))
    }

    fn check_array(&self, item: &Wire, size: u64) -> Result<(), SchemaError> {
        let bytes = size.saturating_mul(item.fixed_bytes());
        if size == 0 || size > MAX_FIXED_BYTES || bytes > MAX_FIXED_BYTES {
            return Err(self.refused(format!(
                "expected arrays of 1 to {MAX_FIXED_BYTES} bytes, found {size} elements ({bytes} bytes)"
            )));
        }
        Ok(())
    }

    fn unknown(&self, missing: &str) -> SchemaError {
        SchemaError::UnknownType {
            schema: self.schema.clone(),
            missing: shown(missing),
        }
    }

    fn too_deep(&self) -> SchemaError {
        self.refused(format!(
            "expected at most {MAX_DEPTH} levels of nesting, found more"
        ))
    }

    fn refused(&self, reason: String) -> SchemaError {
        SchemaError::refused(&self.schema, reason)
    }
}
