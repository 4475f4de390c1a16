//! ROS message definitions: the text of a type, followed by those of the types it uses.
//!
//! ```text
//! std_msgs/Header header
//! float64[36] covariance
//! ================================================================================
//! MSG: std_msgs/Header
//! ...
//! ```
//!
//! Sources: ROS 2 "About interfaces" and `rosidl_adapter`; ROS 1 wiki, "msg".

use crate::SchemaError;
use crate::resolve::{Declaration, Declared, Library, Member};
use crate::wire::{Extensibility, StructType, Wire, integer};
use arrow::datatypes::DataType;
use std::sync::Arc;

/// The two generations of the language; `byte`, `char`, `time` and `Header` differ.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Generation {
    Ros1,
    Ros2,
}

impl Generation {
    fn language(self) -> &'static str {
        match self {
            Generation::Ros1 => "ros1msg",
            Generation::Ros2 => "ros2msg",
        }
    }
}

/// One line of the text, for messages about it.
#[derive(Clone, Copy)]
struct SourceLine<'a> {
    generation: Generation,
    schema: &'a str,
    line: usize,
}

impl SourceLine<'_> {
    fn fault(&self, expected: &str, found: &str) -> SchemaError {
        SchemaError::Syntax {
            language: self.generation.language(),
            schema: self.schema.to_owned(),
            line: self.line,
            expected: expected.to_owned(),
            found: found.chars().take(80).collect(),
        }
    }
}

/// The message `schema_name` that `text` defines.
pub(crate) fn parse(
    generation: Generation,
    schema_name: &str,
    text: &str,
) -> Result<Arc<StructType>, SchemaError> {
    let root = short_name(schema_name);
    let mut library = Library::new(schema_name, text.as_bytes())?;
    let mut current = Declaration::new(&root, Extensibility::Unstated);
    let mut at_header = false;
    for (index, line) in text.lines().enumerate() {
        let place = SourceLine {
            generation,
            schema: schema_name,
            line: index + 1,
        };
        let line = line.split('#').next().unwrap_or_default().trim();
        if is_separator(line) {
            library.add(current);
            current = Declaration::new("", Extensibility::Unstated);
            at_header = true;
        } else if let Some(name) = header(line) {
            if at_header {
                current.name = short_name(name);
            }
            at_header = false;
        } else if line == "---" && !at_header {
            current = begin_response(current, &mut library).ok_or_else(|| {
                place.fault("one '---', between a service's request and response", line)
            })?;
        } else if at_header && !line.is_empty() {
            return Err(place.fault("'MSG: package/Type' after the separator", line));
        } else if let Some(member) = member(line, &current.name, place)? {
            library.count_member()?;
            // Its type's name was looked for in this scope.
            library.budget.spend(line.len() + current.name.len())?;
            current.members.push(member);
        }
    }
    library.add(current);
    add_builtins(generation, &mut library);
    library.resolve(&root)
}

/// `nav_msgs/msg/Odometry` as `nav_msgs/Odometry`.
fn short_name(name: &str) -> String {
    match name.trim().split('/').collect::<Vec<_>>().as_slice() {
        [package, "msg" | "srv" | "action", rest @ ..] if !rest.is_empty() => {
            format!("{package}/{}", rest.join("/"))
        }
        _ => name.trim().to_owned(),
    }
}

/// At the `---` of a service: files its request, adds its event, and begins its response.
/// Recorders of services store the text of the whole service under the event's name.
fn begin_response(mut request: Declaration, library: &mut Library) -> Option<Declaration> {
    if request.name.ends_with("_Response") {
        return None;
    }
    let stem = request.name.trim_end_matches("_Event");
    let service = stem.trim_end_matches("_Request").to_owned();
    let optional = |part: &str| Declared::Sequence(Box::new(named(&format!("{service}_{part}"))));
    let mut event = Declaration::new(&format!("{service}_Event"), Extensibility::Unstated);
    event.members = vec![
        Member::new("info", named("service_msgs/ServiceEventInfo")),
        Member::new("request", optional("Request")),
        Member::new("response", optional("Response")),
    ];
    library.add(event);
    request.name = format!("{service}_Request");
    library.add(request);
    let response = format!("{service}_Response");
    Some(Declaration::new(&response, Extensibility::Unstated))
}

fn named(name: &str) -> Declared {
    Declared::Named([name.to_owned()].into())
}

fn is_separator(line: &str) -> bool {
    line.len() >= 8 && line.bytes().all(|b| b == b'=')
}

fn header(line: &str) -> Option<&str> {
    let name = line.strip_prefix("MSG:").or(line.strip_prefix("SRV:"));
    name.map(str::trim)
}

/// A member, or none for blank lines and constants.
fn member(line: &str, scope: &str, place: SourceLine) -> Result<Option<Member>, SchemaError> {
    if line.is_empty() {
        return Ok(None);
    }
    let Some((type_text, rest)) = line.split_once(char::is_whitespace) else {
        return Err(place.fault("a type and a name", line));
    };
    let rest = rest.trim_start();
    let end = rest
        .find(|c: char| !(c.is_ascii_alphanumeric() || c == '_'))
        .unwrap_or(rest.len());
    let (name, tail) = rest.split_at(end);
    if name.is_empty() {
        return Err(place.fault("a member name after the type", line));
    }
    if tail.trim_start().starts_with('=') {
        return Ok(None);
    }
    let declared = declared(type_text, scope, place)?;
    Ok(Some(Member::new(name, declared)))
}

fn declared(text: &str, scope: &str, place: SourceLine) -> Result<Declared, SchemaError> {
    let (base, size) = match text.strip_suffix(']').and_then(|t| t.rsplit_once('[')) {
        Some((base, size)) => (base, Some(size.trim())),
        None => (text, None),
    };
    let item = base_type(base, scope, place)?;
    let Some(size) = size else { return Ok(item) };
    if size.is_empty() || size.starts_with("<=") {
        return Ok(Declared::Sequence(Box::new(item)));
    }
    match size.parse::<u32>() {
        Ok(size) => Ok(Declared::Array(Box::new(item), u64::from(size))),
        Err(_) => Err(place.fault("an array size such as [3], [<=3] or []", text)),
    }
}

fn base_type(base: &str, scope: &str, place: SourceLine) -> Result<Declared, SchemaError> {
    // Bounds limit what may be sent, not how.
    let name = base.split_once("<=").map_or(base, |(name, _)| name);
    if let Some(wire) = primitive(name, place.generation) {
        return Ok(Declared::Wire(wire));
    }
    let legal = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '/';
    if name.is_empty() || name != base || !name.chars().all(legal) {
        return Err(place.fault("a type name", base));
    }
    Ok(Declared::Named(
        candidates(name, scope, place.generation).into(),
    ))
}

/// Where a type name may be defined, best first.
fn candidates(name: &str, scope: &str, generation: Generation) -> Vec<String> {
    if matches!(name, "time" | "duration") {
        let kind = if name == "time" { "Time" } else { "Duration" };
        return vec![format!("builtin_interfaces/{kind}")];
    }
    if name.contains('/') {
        return vec![short_name(name)];
    }
    let package = scope.split('/').next().unwrap_or_default();
    let own = format!("{package}/{name}");
    match name {
        // ROS 1 always means the standard header; ROS 2 only where the package has none.
        "Header" if generation == Generation::Ros1 => vec!["std_msgs/Header".to_owned(), own],
        "Header" => vec![own, "std_msgs/Header".to_owned()],
        _ => vec![own, name.to_owned()],
    }
}

fn primitive(name: &str, generation: Generation) -> Option<Wire> {
    let scalar = match (name, generation) {
        ("bool", _) => DataType::Boolean,
        ("byte", Generation::Ros1) => DataType::Int8,
        ("char", _) | ("byte", Generation::Ros2) => DataType::UInt8,
        ("float32", _) => DataType::Float32,
        ("float64", _) => DataType::Float64,
        ("string", _) => return Some(Wire::Text),
        ("wstring", Generation::Ros2) => return Some(Wire::WideText),
        _ => integer(name)?,
    };
    Some(Wire::Scalar(scalar))
}

/// Adds the types that recorders may leave out because every installation has them.
fn add_builtins(generation: Generation, library: &mut Library) {
    let (time, duration) = match generation {
        Generation::Ros1 => (
            [("sec", DataType::UInt32), ("nsec", DataType::UInt32)],
            [("sec", DataType::Int32), ("nsec", DataType::Int32)],
        ),
        Generation::Ros2 => {
            let parts = [("sec", DataType::Int32), ("nanosec", DataType::UInt32)];
            (parts.clone(), parts)
        }
    };
    library.add(Declaration::time("builtin_interfaces/Time", time));
    library.add(Declaration::time("builtin_interfaces/Duration", duration));
    let number = |scalar| Declared::Wire(Wire::Scalar(scalar));
    let gid = Declared::Array(Box::new(number(DataType::UInt8)), 16);
    let members = [
        ("event_type", number(DataType::UInt8)),
        ("stamp", named("builtin_interfaces/Time")),
        ("client_gid", gid),
        ("sequence_number", number(DataType::Int64)),
    ];
    library.add(Declaration::builtin(
        "service_msgs/ServiceEventInfo",
        &members,
    ));
}
