//! OMG IDL as ROS 2 writes it (`ros2idl`): modules, structs, typedefs, enums, constants.
//!
//! Annotations are read over, but for those that change the wire: `@final`,
//! `@appendable`, `@mutable` and `@optional`. Source: OMG IDL 4.2; ROS 2 design article
//! "Interface definition using .idl files".

mod tokens;

use crate::SchemaError;
use crate::resolve::{Declaration, Declared, Library, Member};
use crate::wire::{Extensibility, StructType, Wire, integer};
use arrow::datatypes::DataType;
use std::collections::HashMap;
use std::sync::Arc;
use tokens::{Token, tokens};

/// Levels of nesting in the text that are followed.
const MAX_NESTING: usize = 64;

/// The struct `schema_name` that `text` defines.
pub(crate) fn parse(schema_name: &str, text: &str) -> Result<Arc<StructType>, SchemaError> {
    let mut parser = Parser {
        schema: schema_name,
        library: Library::new(schema_name, text.as_bytes())?,
        tokens: tokens(text),
        next: 0,
        scope: Vec::new(),
        constants: HashMap::new(),
    };
    while parser.peek().is_some() {
        parser.definition()?;
    }
    let mut library = parser.library;
    add_builtins(&mut library);
    library.resolve_first(&root_names(schema_name))
}

/// `a::msg::B`, `a/msg/B` and `a/B` all mean the struct `B` of module `a::msg`.
fn root_names(schema_name: &str) -> Vec<String> {
    let name = schema_name.trim().replace("::", "/");
    let with_msg = name.split_once('/').map(|(p, t)| format!("{p}/msg/{t}"));
    std::iter::once(name).chain(with_msg).collect()
}

fn add_builtins(library: &mut Library) {
    let parts = [("sec", DataType::Int32), ("nanosec", DataType::UInt32)];
    for name in ["Time", "Duration"] {
        let name = format!("builtin_interfaces/msg/{name}");
        library.add(Declaration::time(&name, parts.clone()));
    }
}

/// What annotations before a definition or member say about the wire.
#[derive(Default)]
struct Annotations {
    extensibility: Option<Extensibility>,
    mutable: bool,
    optional: bool,
}

struct Parser<'a> {
    schema: &'a str,
    tokens: Vec<(Token<'a>, u32)>,
    next: usize,
    scope: Vec<String>,
    constants: HashMap<String, u64>,
    library: Library,
}

impl<'a> Parser<'a> {
    fn peek(&self) -> Option<&Token<'a>> {
        self.tokens.get(self.next).map(|(token, _)| token)
    }

    fn fault(&self, expected: &str) -> SchemaError {
        let last = self.tokens.last().map_or(1, |(_, line)| *line);
        let here = self.tokens.get(self.next);
        SchemaError::Syntax {
            language: "ros2idl",
            schema: self.schema.to_owned(),
            line: here.map_or(last, |(_, line)| *line) as usize,
            expected: expected.to_owned(),
            found: here.map_or("the end of the text".to_owned(), |(t, _)| t.shown()),
        }
    }

    fn refused(&self, reason: String) -> SchemaError {
        SchemaError::refused(self.schema, reason)
    }

    fn is_sign(&self, sign: char) -> bool {
        self.peek() == Some(&Token::Sign(sign))
    }

    fn eat(&mut self, sign: char) -> bool {
        let met = self.is_sign(sign);
        self.next += usize::from(met);
        met
    }

    fn expect(&mut self, sign: char) -> Result<(), SchemaError> {
        if self.eat(sign) {
            Ok(())
        } else {
            Err(self.fault(&format!("'{sign}'")))
        }
    }

    fn name(&mut self, what: &str) -> Result<String, SchemaError> {
        match self.peek() {
            Some(Token::Name(name)) => {
                let name = (*name).to_owned();
                self.next += 1;
                Ok(name)
            }
            _ => Err(self.fault(what)),
        }
    }

    /// Letters of the names of all open modules.
    fn scope_length(&self) -> usize {
        self.scope.iter().map(|part| part.len() + 1).sum()
    }

    fn full_name(&mut self, name: &str) -> Result<String, SchemaError> {
        self.library
            .budget
            .spend(self.scope_length() + name.len())?;
        let mut parts = self.scope.clone();
        parts.push(name.to_owned());
        Ok(parts.join("/"))
    }

    /// Full names that `name` may mean here, innermost scope first.
    fn candidates(&mut self, name: &str) -> Result<Vec<String>, SchemaError> {
        let path = name.replace("::", "/");
        if let Some(absolute) = path.strip_prefix('/') {
            return Ok(vec![absolute.to_owned()]);
        }
        let depths = self.scope.len() + 1;
        let letters = depths.saturating_mul(self.scope_length() + path.len());
        self.library.budget.spend(letters)?;
        let names = (0..depths).rev().map(|depth| {
            let mut parts = self.scope[..depth].to_vec();
            parts.push(path.clone());
            parts.join("/")
        });
        Ok(names.collect())
    }

    fn definition(&mut self) -> Result<(), SchemaError> {
        let annotations = self.annotations()?;
        let keyword = self.name("module, struct, typedef, enum or const")?;
        match keyword.as_str() {
            "module" => self.module()?,
            "struct" => self.structure(&annotations)?,
            "typedef" => self.typedef()?,
            "enum" => self.enumeration()?,
            "const" => self.constant()?,
            "union" | "bitset" | "bitmask" | "interface" | "valuetype" | "native" => {
                let name = self.name("a name")?;
                return Err(self.refused(format!(
                    "expected structs of numbers, strings, sequences and structs, found {keyword} '{name}', which has no columns here"
                )));
            }
            _ => {
                self.next -= 1;
                return Err(self.fault("module, struct, typedef, enum or const"));
            }
        }
        self.expect(';')
    }

    fn module(&mut self) -> Result<(), SchemaError> {
        let name = self.name("a module name")?;
        if self.scope.len() >= MAX_NESTING {
            return Err(self.refused(format!("expected at most {MAX_NESTING} nested modules")));
        }
        self.scope.push(name);
        self.expect('{')?;
        while !self.eat('}') {
            self.definition()?;
        }
        self.scope.pop();
        Ok(())
    }

    fn structure(&mut self, annotations: &Annotations) -> Result<(), SchemaError> {
        let name = self.name("a struct name")?;
        if self.is_sign(';') {
            return Ok(());
        }
        if self.is_sign(':') {
            return Err(self.refused(format!(
                "expected plain structs, found '{name}' with a base type"
            )));
        }
        if annotations.mutable {
            return Err(self.refused(format!(
                "expected final or appendable structs, found mutable '{name}'"
            )));
        }
        let extensibility = annotations.extensibility.unwrap_or(Extensibility::Unstated);
        let mut declaration = Declaration::new(&self.full_name(&name)?, extensibility);
        self.expect('{')?;
        while !self.eat('}') {
            let annotations = self.annotations()?;
            let declared = self.declared_type(0)?;
            for (name, declared) in self.declarators(declared)? {
                if annotations.optional {
                    return Err(self.refused(format!(
                        "expected members that are always there, found @optional '{name}'"
                    )));
                }
                self.library.count_member()?;
                declaration.members.push(Member { name, declared });
            }
        }
        self.library.add(declaration);
        Ok(())
    }

    fn typedef(&mut self) -> Result<(), SchemaError> {
        let declared = self.declared_type(0)?;
        for (name, declared) in self.declarators(declared)? {
            let name = self.full_name(&name)?;
            self.library.add_alias(name, declared);
        }
        self.next -= 1; // the ';' that `definition` expects
        Ok(())
    }

    fn enumeration(&mut self) -> Result<(), SchemaError> {
        let name = self.name("an enum name")?;
        self.expect('{')?;
        while !self.eat('}') {
            self.annotations()?;
            self.name("an enumerator")?;
            if !self.eat(',') && !self.is_sign('}') {
                return Err(self.fault("',' or '}'"));
            }
        }
        let declared = Declared::Wire(Wire::Enumeration);
        let name = self.full_name(&name)?;
        self.library.add_alias(name, declared);
        Ok(())
    }

    fn constant(&mut self) -> Result<(), SchemaError> {
        self.declared_type(0)?;
        let name = self.name("a constant name")?;
        self.expect('=')?;
        let start = self.next;
        while !self.is_sign(';') {
            if self.peek().is_none() {
                return Err(self.fault("';'"));
            }
            self.next += 1;
        }
        // Only whole numbers matter, as sizes.
        if self.next == start + 1
            && let Some(value) = self.value_at(start)?
        {
            let name = self.full_name(&name)?;
            self.constants.insert(name, value);
        }
        Ok(())
    }

    fn value_at(&mut self, index: usize) -> Result<Option<u64>, SchemaError> {
        let name = match self.tokens.get(index) {
            Some((Token::Number(text), _)) => {
                return Ok(match text.strip_prefix("0x") {
                    Some(hex) => u64::from_str_radix(hex, 16).ok(),
                    None => text.parse().ok(),
                });
            }
            Some((Token::Name(name), _)) => *name,
            _ => return Ok(None),
        };
        let names = self.candidates(name)?;
        Ok(names.iter().find_map(|n| self.constants.get(n).copied()))
    }

    fn size(&mut self) -> Result<u64, SchemaError> {
        let value = self.value_at(self.next)?;
        match value {
            Some(value) => {
                self.next += 1;
                Ok(value)
            }
            None => Err(self.fault("a whole number or the name of one")),
        }
    }

    fn annotations(&mut self) -> Result<Annotations, SchemaError> {
        let mut found = Annotations::default();
        while self.eat('@') {
            let name = self.name("an annotation")?;
            let arguments = self.arguments()?;
            match name.as_str() {
                "final" => found.extensibility = Some(Extensibility::Final),
                "appendable" => found.extensibility = Some(Extensibility::Appendable),
                "mutable" => found.mutable = true,
                "optional" => found.optional = true,
                "extensibility" => match arguments.first().map(String::as_str) {
                    Some("FINAL") => found.extensibility = Some(Extensibility::Final),
                    Some("APPENDABLE") => found.extensibility = Some(Extensibility::Appendable),
                    _ => found.mutable = true,
                },
                _ => {}
            }
        }
        Ok(found)
    }

    /// The names inside the parentheses after an annotation, if there are any.
    fn arguments(&mut self) -> Result<Vec<String>, SchemaError> {
        let mut names = Vec::new();
        let mut depth = usize::from(self.eat('('));
        while depth > 0 {
            match self.peek() {
                None => return Err(self.fault("')'")),
                Some(Token::Sign('(')) => depth += 1,
                Some(Token::Sign(')')) => depth -= 1,
                Some(Token::Name(name)) => names.push((*name).to_owned()),
                Some(_) => {}
            }
            self.next += 1;
        }
        Ok(names)
    }

    /// `name`, `name[3]`, `name[3][4]`, several with commas, up to and with the `;`.
    fn declarators(&mut self, base: Declared) -> Result<Vec<(String, Declared)>, SchemaError> {
        let mut found = Vec::new();
        loop {
            let name = self.name("a name")?;
            let mut sizes = Vec::new();
            while self.eat('[') {
                sizes.push(self.size()?);
                self.expect(']')?;
            }
            if sizes.len() > MAX_NESTING {
                return Err(self.refused(format!("expected at most {MAX_NESTING} dimensions")));
            }
            let declared = sizes.iter().rev().fold(base.clone(), |item, size| {
                Declared::Array(Box::new(item), *size)
            });
            found.push((name, declared));
            if !self.eat(',') {
                self.expect(';')?;
                return Ok(found);
            }
        }
    }

    fn declared_type(&mut self, depth: usize) -> Result<Declared, SchemaError> {
        if depth > MAX_NESTING {
            return Err(self.refused(format!("expected at most {MAX_NESTING} nested types")));
        }
        let name = self.name("a type")?;
        match name.as_str() {
            "sequence" => {
                self.expect('<')?;
                let item = self.declared_type(depth + 1)?;
                if self.eat(',') {
                    self.size()?;
                }
                self.expect('>')?;
                Ok(Declared::Sequence(Box::new(item)))
            }
            "string" | "wstring" => {
                if self.eat('<') {
                    self.size()?;
                    self.expect('>')?;
                }
                let wide = name == "wstring";
                let wire = if wide { Wire::WideText } else { Wire::Text };
                Ok(Declared::Wire(wire))
            }
            "map" | "wchar" | "any" | "fixed" => Err(self.refused(format!(
                "expected numbers, strings, sequences and structs, found type '{name}'"
            ))),
            _ => self.plain_type(name),
        }
    }

    fn plain_type(&mut self, name: String) -> Result<Declared, SchemaError> {
        let scalar = match name.as_str() {
            "unsigned" | "long" => self.long_type(&name)?,
            "short" => DataType::Int16,
            other => match scalar(other) {
                Some(scalar) => scalar,
                None => return Ok(Declared::Named(self.candidates(&name)?.into())),
            },
        };
        Ok(Declared::Wire(Wire::Scalar(scalar)))
    }

    /// `long`, `long long`, `unsigned short` and the like, of which `first` is read.
    fn long_type(&mut self, first: &str) -> Result<DataType, SchemaError> {
        let mut words = vec![first.to_owned()];
        while let Some(Token::Name(word)) = self.peek()
            && matches!(*word, "long" | "short" | "double")
        {
            words.push((*word).to_owned());
            self.next += 1;
        }
        match words.join(" ").as_str() {
            "long" => Ok(DataType::Int32),
            "long long" => Ok(DataType::Int64),
            "unsigned short" => Ok(DataType::UInt16),
            "unsigned long" => Ok(DataType::UInt32),
            "unsigned long long" => Ok(DataType::UInt64),
            other => Err(self.refused(format!(
                "expected a number of at most 64 bits, found type '{other}'"
            ))),
        }
    }
}

fn scalar(name: &str) -> Option<DataType> {
    Some(match name {
        "boolean" => DataType::Boolean,
        "octet" | "char" => DataType::UInt8,
        "float" => DataType::Float32,
        "double" => DataType::Float64,
        _ => return integer(name),
    })
}
