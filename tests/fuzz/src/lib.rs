//! The targets of the fuzzer: each takes any bytes, and must come back.
//!
//! ```text
//!   corpus/TARGET/* ──► tests/corpus.rs: replayed and mutated in every test run
//!          ▲ └────────► guided/: the same targets under cargo-fuzz, led by coverage
//!          └─ what it finds that reaches new code
//! ```

mod geometries;
mod logs;
mod queries;

use std::borrow::Cow;
use std::cell::OnceCell;
use std::str::from_utf8;
use std::sync::Once;

use arrow::array::StructArray;
use arrow::datatypes::Field;
use evermap_engine::nodes::raw::as_file;
use evermap_language::{
    Host, OperatorSpec, ParameterFault, PortSpec, QueryFault, Source, Vocabulary, parse, utf8,
};
use evermap_messages::{Decoder, MessageType};
use evermap_schemas::roles::{
    self, CameraNames, Fields, FoundImage, Message, OdometryOf, SampleBits,
};
use evermap_schemas::{ImageRef, Stamp};
use evermap_vision::{Grey, Rgb};
use evermap_vision::{
    decode_colour, decode_depth, decode_grey, decode_labels, holds_colour, image_size,
};
use serde_json::{Value, json};

/// A target.
pub type Target = fn(&[u8]);

/// All targets by name; each has a folder in `corpus` and a file in `guided/targets`.
pub const TARGETS: [(&str, Target); 9] = [
    ("definitions", definitions),
    ("payloads", payloads),
    ("roles", roles),
    ("plans", plans),
    ("logs", logs::logs),
    ("summaries", logs::summaries),
    ("images", images),
    ("queries", queries::queries),
    ("geometries", geometries::geometries),
];

/// Encodings of messages and of their definitions, and a name that a definition may have.
const ENCODINGS: [(&str, &str, &str); 6] = [
    ("cdr", "ros2msg", "a/msg/B"),
    ("cdr", "ros2idl", "a/msg/B"),
    ("ros1", "ros1msg", "a/B"),
    ("protobuf", "protobuf", "a.B"),
    ("json", "jsonschema", "a.B"),
    ("json", "", ""),
];

/// One byte for the encodings, then a definition.
fn definitions(bytes: &[u8]) {
    if let Some((first, schema)) = bytes.split_first() {
        let _ = message_type(*first, schema);
    }
}

fn message_type(kind: u8, schema: &[u8]) -> Option<MessageType> {
    let (messages, schemas, name) = ENCODINGS[usize::from(kind) % ENCODINGS.len()];
    MessageType::parse(messages, schemas, name, schema).ok()
}

/// A definition with its payloads: encodings (one byte), length of the definition (two), the definition, payloads of a
/// length (two) each.
fn channel(bytes: &[u8]) -> Option<(MessageType, Vec<&[u8]>)> {
    let (first, rest) = bytes.split_first()?;
    let (schema, mut rest) = counted(rest)?;
    let message_type = message_type(*first, schema)?;
    let mut payloads = Vec::new();
    while let Some((payload, behind)) = counted(rest) {
        payloads.push(payload);
        rest = behind;
    }
    Some((message_type, payloads))
}

/// Bytes behind their length, as many as there are, and what follows.
fn counted(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = bytes.split_first_chunk::<2>()?;
    let length = usize::from(u16::from_le_bytes(*length));
    Some(rest.split_at(length.min(rest.len())))
}

/// Decodes payloads by their own definition: whole, one member alone, and the place of a member.
fn payloads(bytes: &[u8]) {
    let Some((message_type, payloads)) = channel(bytes) else {
        return;
    };
    let mut whole = message_type.decoder(None);
    let mut first = message_type.decoder(Some(&[0]));
    for payload in payloads {
        let rows = (whole.push(payload).is_ok(), first.push(payload).is_ok());
        // Whether a payload is a row does not depend on what is read of it.
        assert_eq!(rows.0, rows.1);
        for member in message_type.fields().iter().take(4) {
            let found = message_type.locate(payload, &[member.name()]);
            if let Ok(Some(place)) = found {
                assert!(place.range.end <= payload.len());
            }
        }
    }
    finished(&mut whole, &message_type, usize::MAX);
    finished(&mut first, &message_type, 1);
}

/// What was decoded, of so many members.
fn finished(decoder: &mut Decoder, message_type: &MessageType, members: usize) -> StructArray {
    let rows = decoder.len();
    #[allow(clippy::expect_used)] // a fault of the decoder is what is sought
    let arrays = decoder.finish().expect("decoded columns fit");
    let fields = message_type.fields().iter().take(members);
    let named = fields.zip(&arrays);
    let fields: Vec<Field> = named
        .map(|(field, array)| Field::new(field.name(), array.data_type().clone(), true))
        .collect();
    #[allow(clippy::expect_used)]
    StructArray::try_new_with_length(fields.into(), arrays, None, rows).expect("columns are alike")
}

/// An image that lies anywhere, and begins as the input ends.
fn image(bytes: &[u8]) -> FoundImage {
    FoundImage {
        place: ImageRef {
            session: "session".to_owned(),
            ..ImageRef::default()
        },
        magic: bytes.last_chunk().copied().unwrap_or_default(),
    }
}

/// Has every role read messages of a definition of their own. Where the last byte is one of the three largest, it says how many
/// bits a manifest gives the samples of their images.
fn roles(bytes: &[u8]) {
    let Some((message_type, payloads)) = channel(bytes) else {
        return;
    };
    let mut decoder = message_type.decoder(None);
    for payload in payloads {
        let _ = decoder.push(payload);
    }
    let members = finished(&mut decoder, &message_type, usize::MAX);
    let (cameras, robot) = (CameraNames::default(), OdometryOf::default());
    let image = image(bytes);
    let zero = OnceCell::new();
    let bits = bytes.last().and_then(|last| {
        let bits = SampleBits::ALL.get(usize::from(u8::MAX - last))?;
        SampleBits::new(u64::from(*bits))
    });
    let messages: Vec<Message<'_>> = Fields::all(&members)
        .map(|fields| Message {
            site: "site",
            session: "session",
            topic: "/topic",
            log_time: Stamp(1),
            fields,
            zero: &zero,
            image: Some(&image),
            cameras: &cameras,
            robot: &robot,
            bits,
            still: None,
        })
        .collect();
    for role in roles::ALL.iter().filter_map(|role| role.messages()) {
        let _ = (role.read)(&messages);
        for ahead in [role.robots, role.still].into_iter().flatten() {
            let _ = (ahead.read)(&messages);
        }
    }
}

/// Pixels of the largest image that is decoded: larger ones take time and show nothing else.
const PIXELS: u64 = 1 << 16;

/// Pixels of an image that is not too large.
fn small(bytes: &[u8]) -> Option<u64> {
    let [width, height] = image_size(bytes).ok()?;
    let pixels = u64::from(width) * u64::from(height);
    (pixels <= PIXELS).then_some(pixels)
}

/// Decodes an image in every way that there is, and what is made of it as a raw one.
fn images(bytes: &[u8]) {
    decoded(bytes);
    if let Some(file) = of_raw(bytes) {
        decoded(&file);
    }
}

/// The file of a raw image: a byte each for its width, its height and the bytes of a row, a line for its format, then its rows.
fn of_raw(bytes: &[u8]) -> Option<Vec<u8>> {
    let ([width, height, step], rest) = bytes.split_first_chunk::<3>()?;
    let end = rest.iter().position(|byte| *byte == b'\n')?;
    let mut place = image(bytes).place;
    place.format = from_utf8(&rest[..end]).ok()?.to_owned();
    let [width, height, step] = [*width, *height, *step].map(u32::from);
    (place.width, place.height, place.step) = (Some(width), Some(height), Some(step));
    let Cow::Owned(file) = as_file(&place, &rest[end + 1..]).ok()? else {
        // It is no raw one, and stays as it is.
        return None;
    };
    // Numbers of 32 bits are no picture, and an image without rows is none.
    if height > 0 && !file.starts_with(b"Pf") {
        assert_eq!(image_size(&file).ok(), Some([width, height]));
    }
    Some(file)
}

fn decoded(bytes: &[u8]) {
    // Depth stands behind 12 bytes as well, and as floating-point numbers.
    let behind = bytes.get(12..).and_then(small);
    if (bytes.starts_with(b"Pf") || behind.is_some())
        && let Ok(depth) = decode_depth(bytes)
    {
        let pixels = u64::from(depth.width) * u64::from(depth.height);
        assert_eq!(depth.data.len() as u64, pixels);
    }
    let Some(pixels) = small(bytes) else {
        return;
    };
    let _ = holds_colour(bytes);
    let mut grey = Grey::default();
    if decode_grey(bytes, &mut grey).is_ok() {
        assert_eq!(
            grey.data.len() as u64,
            u64::from(grey.width) * u64::from(grey.height)
        );
    }
    let mut rgb = Rgb::default();
    if decode_colour(bytes, &mut rgb).is_ok() {
        assert_eq!(
            rgb.data.len() as u64,
            3 * u64::from(rgb.width) * u64::from(rgb.height)
        );
    }
    if let Ok(depth) = decode_depth(bytes) {
        assert_eq!(depth.data.len() as u64, pixels);
    }
    if let Ok(labels) = decode_labels(bytes) {
        assert_eq!(labels.data.len() as u64, pixels);
    }
}

struct Anywhere;

impl Host for Anywhere {
    fn tables(&self, query: &str) -> Result<Vec<String>, QueryFault> {
        Ok(query.split_whitespace().map(str::to_owned).collect())
    }

    fn parameter_faults(&self, _: &str, _: &Value) -> Vec<ParameterFault> {
        Vec::new()
    }

    fn plan(&self, name: &str, _: &str) -> Result<Source, String> {
        match name {
            "base" => Ok(Source {
                origin: "base".to_owned(),
                text: "plan: base\nsteps:\n  a: { op: filter, rows: poses }\nwrite: [a]".to_owned(),
            }),
            _ => Err("there is no such plan".to_owned()),
        }
    }

    fn code(&self, _: &str, _: &str) -> Result<String, String> {
        Ok("def made(rows):\n    return rows\n".to_owned())
    }
}

/// A line of settings, then a plan; a plan that is right is right again.
fn plans(bytes: &[u8]) {
    let Ok(text) = utf8(bytes, "plan") else {
        return;
    };
    let (settings, text) = text.split_once('\n').unwrap_or(("", text));
    let settings: Vec<String> = settings.split_whitespace().map(str::to_owned).collect();
    let vocabulary = Vocabulary {
        operators: vec![OperatorSpec {
            name: "filter".to_owned(),
            ports: ["rows", "beside"]
                .map(|name| PortSpec {
                    name: name.to_owned(),
                    optional: name == "beside",
                })
                .to_vec(),
            params: json!({ "properties": { "size_m": { "type": "number" } } }),
        }],
        sources: vec!["poses".to_owned()],
        open_sources: true,
        map_tables: vec!["runs".to_owned()],
    };
    let source = Source {
        origin: "plan".to_owned(),
        text: text.to_owned(),
    };
    match parse(&source, &settings, &vocabulary, &Anywhere) {
        Ok(plan) => {
            let names: Vec<_> = plan.steps.iter().map(|step| &step.name).collect();
            assert!(plan.write.iter().all(|name| names.contains(&name)));
        }
        Err(faults) => assert!(from_utf8(faults.pretty().as_bytes()).is_ok()),
    }
}

/// Runs the target of this name.
///
/// # Panics
/// Where there is none, or where it has found something.
pub fn run(name: &str, bytes: &[u8]) {
    // libFuzzer ends at any panic that it hears of.
    static QUIET: Once = Once::new();
    QUIET.call_once(evermap_functions::keep_guarded_panics_quiet);
    let found = TARGETS.iter().find(|(target, _)| *target == name);
    #[allow(clippy::panic)]
    let (_, target) = found.unwrap_or_else(|| panic!("no target {name}"));
    target(bytes);
}
