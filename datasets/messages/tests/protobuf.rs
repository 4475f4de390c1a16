//! Protobuf: random wire, in any order, against `prost-reflect`'s reading of it.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use arrow::array::{Array, ArrayRef, AsArray};
use arrow::datatypes::*;
use evermap_messages::MessageType;
use proptest::prelude::*;
use prost_reflect::prost::Message;
use prost_reflect::prost_types::field_descriptor_proto::{Label, Type};
use prost_reflect::prost_types::{
    DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet, MessageOptions,
    OneofDescriptorProto,
};
use prost_reflect::{DescriptorPool, DynamicMessage, ReflectMessage, Value};

fn field(name: &str, number: i32, of: Type, repeated: bool) -> FieldDescriptorProto {
    FieldDescriptorProto {
        name: Some(name.to_owned()),
        number: Some(number),
        r#type: Some(of as i32),
        label: Some(if repeated {
            Label::Repeated
        } else {
            Label::Optional
        } as i32),
        type_name: (of == Type::Message).then(|| ".t.Inner".to_owned()),
        ..Default::default()
    }
}

/// `Outer` has one field of every kind; `Inner` is a small message; `Node` holds itself.
fn descriptors() -> FileDescriptorSet {
    let mut outer = vec![
        field("f64", 1, Type::Double, false),
        field("i32", 2, Type::Int32, false),
        field("s64", 3, Type::Sint64, false),
        field("flag", 4, Type::Bool, false),
        field("text", 5, Type::String, false),
        field("data", 6, Type::Bytes, false),
        field("inner", 7, Type::Message, false),
        field("inners", 8, Type::Message, true),
        field("numbers", 9, Type::Sint32, true),
        field("names", 10, Type::String, true),
        field("a", 11, Type::Fixed32, false),
        field("b", 12, Type::Message, false),
        field("floats", 13, Type::Float, true),
    ];
    outer[10].oneof_index = Some(0);
    outer[11].oneof_index = Some(0);
    let inner = vec![
        field("x", 1, Type::Uint32, false),
        field("deep", 2, Type::Int64, true),
        field("data", 3, Type::Bytes, false),
    ];
    let mut recursive = vec![
        field("id", 1, Type::Int32, false),
        field("next", 2, Type::Message, false),
    ];
    recursive[1].type_name = Some(".t.Node".to_owned());
    let message = |name: &str, field: Vec<FieldDescriptorProto>| DescriptorProto {
        name: Some(name.to_owned()),
        field,
        ..Default::default()
    };
    let mut outer = message("Outer", outer);
    outer.oneof_decl.push(OneofDescriptorProto {
        name: Some("choice".to_owned()),
        ..Default::default()
    });
    let file = FileDescriptorProto {
        name: Some("t.proto".to_owned()),
        package: Some("t".to_owned()),
        syntax: Some("proto3".to_owned()),
        message_type: vec![outer, message("Inner", inner), message("Node", recursive)],
        ..Default::default()
    };
    FileDescriptorSet { file: vec![file] }
}

fn parse(name: &str) -> MessageType {
    let set = descriptors().encode_to_vec();
    MessageType::parse("protobuf", "protobuf", name, &set).unwrap()
}

fn varint(mut value: u64, to: &mut Vec<u8>) {
    while value >= 0x80 {
        to.push(value as u8 | 0x80);
        value >>= 7;
    }
    to.push(value as u8);
}

/// One field on the wire: any number, with a wire type that fits it or not.
fn wire_field(inner: impl Strategy<Value = Vec<u8>>) -> impl Strategy<Value = Vec<u8>> {
    (1..16_u64, any::<u64>(), 0..6_usize, inner).prop_map(|(number, word, how, inner)| {
        let mut bytes = Vec::new();
        let fitting = match number {
            1 => 1,
            2..=4 => 0,
            11 => 5,
            9 | 13 if how < 3 => how,
            9 => 0,
            13 => 5,
            _ => 2,
        };
        let wire_type = if how == 5 { word % 3 } else { fitting as u64 };
        varint(number << 3 | wire_type, &mut bytes);
        match wire_type {
            0 => varint(word >> (word % 64), &mut bytes),
            1 => bytes.extend(word.to_le_bytes()),
            5 => bytes.extend((word as u32).to_le_bytes()),
            _ => {
                let body = match number {
                    7 | 8 | 12 => inner,
                    5 | 10 => vec![b'a'; (word % 5) as usize],
                    6 => word.to_le_bytes()[..(word % 8) as usize].to_vec(),
                    9 => vec![(word % 128) as u8; (word % 4) as usize],
                    13 => word.to_le_bytes()[..4 * (word % 3) as usize].to_vec(),
                    _ => Vec::new(),
                };
                varint(body.len() as u64, &mut bytes);
                bytes.extend(body);
            }
        }
        bytes
    })
}

fn inner() -> impl Strategy<Value = Vec<u8>> {
    prop::collection::vec((0..4_u8, any::<u32>()), 0..4).prop_map(|fields| {
        let mut bytes = Vec::new();
        for (which, word) in fields {
            match which {
                0 => bytes.push(0x08),
                1 => bytes.push(0x10),
                _ => {
                    let body = &word.to_le_bytes()[..(word % 5) as usize];
                    bytes.extend([0x1A, body.len() as u8]);
                    bytes.extend(body);
                    continue;
                }
            }
            varint(u64::from(word), &mut bytes);
        }
        bytes
    })
}

fn same(column: &ArrayRef, row: usize, message: &DynamicMessage, name: &str) {
    let field = message.descriptor().get_field_by_name(name).unwrap();
    if field.supports_presence() {
        assert_eq!(column.is_valid(row), message.has_field(&field), "{name}");
        if column.is_null(row) {
            return;
        }
    }
    equal(column, row, &message.get_field(&field));
}

fn equal(column: &ArrayRef, row: usize, value: &Value) {
    match value {
        Value::Bool(v) => assert_eq!(column.as_boolean().value(row), *v),
        Value::I32(v) => assert_eq!(column.as_primitive::<Int32Type>().value(row), *v),
        Value::I64(v) => assert_eq!(column.as_primitive::<Int64Type>().value(row), *v),
        Value::U32(v) => assert_eq!(column.as_primitive::<UInt32Type>().value(row), *v),
        Value::F32(v) => {
            let found = column.as_primitive::<Float32Type>().value(row);
            assert_eq!(found.to_bits(), v.to_bits());
        }
        Value::F64(v) => {
            let found = column.as_primitive::<Float64Type>().value(row);
            assert_eq!(found.to_bits(), v.to_bits());
        }
        Value::String(v) => assert_eq!(column.as_string::<i32>().value(row), v),
        Value::Bytes(v) => assert_eq!(column.as_binary_view().value(row), &v[..]),
        Value::List(values) => {
            let list = column.as_list::<i32>().value(row);
            assert_eq!(list.len(), values.len());
            for (index, value) in values.iter().enumerate() {
                equal(&list, index, value);
            }
        }
        Value::Message(message) => {
            let body = column.as_struct();
            for (name, column) in body.column_names().iter().zip(body.columns()) {
                same(column, row, message, name);
            }
        }
        other => panic!("no {other:?} in this test"),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    #[test]
    fn any_wire_reads_as_prost_reflect_reads_it(
        payloads in prop::collection::vec(
            prop::collection::vec(wire_field(inner()), 0..12).prop_map(|f| f.concat()), 1..4),
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..20),
    ) {
        let pool = DescriptorPool::from_file_descriptor_set(descriptors()).unwrap();
        let descriptor = pool.get_message_by_name("t.Outer").unwrap();
        let message = parse("t.Outer");
        let mut all = message.decoder(None);
        let mut some = message.decoder(Some(&[11, 6]));
        let mut expected = Vec::new();
        for payload in &payloads {
            let mut variants = vec![payload.clone()];
            variants.extend((0..payload.len()).map(|cut| payload[..cut].to_vec()));
            for (place, byte) in &damage {
                let mut bad = payload.clone();
                if !bad.is_empty() {
                    *place.get_mut(&mut bad) = *byte;
                }
                variants.push(bad);
            }
            for variant in variants {
                let reference = DynamicMessage::decode(descriptor.clone(), &variant[..]);
                let accepted = all.push(&variant).is_ok();
                prop_assert_eq!(some.push(&variant).is_ok(), accepted);
                match reference {
                    Ok(reference) if accepted => expected.push(Some(reference)),
                    // Text that is not UTF-8, or a wire type that does not fit, is kept or
                    // skipped here, and refused there.
                    Err(_) if accepted => expected.push(None),
                    Err(_) => {}
                    Ok(_) => prop_assert!(false, "refused {variant:?}"),
                }
                prop_assert_eq!((all.len(), some.len()), (expected.len(), expected.len()));
            }
        }
        let columns = all.finish().unwrap();
        let part = some.finish().unwrap();
        prop_assert_eq!(part[0].as_ref(), columns[11].as_ref());
        prop_assert_eq!(part[1].as_ref(), columns[6].as_ref());
        for (field, column) in message.fields().iter().zip(&columns) {
            column.to_data().validate_full().unwrap();
            prop_assert_eq!(column.len(), expected.len());
            for (row, reference) in expected.iter().enumerate() {
                if let Some(reference) = reference {
                    same(column, row, reference, field.name());
                }
            }
        }
    }
}

#[test]
fn bytes_are_found_where_they_lie_and_recursion_stays_bytes() {
    let message = parse("t.Outer");
    let payload = [0x10, 5, 0x32, 2, 9, 8, 0x3A, 4, 0x1A, 2, 7, 6];
    let data = message.locate(&payload, &["data"]).unwrap().unwrap();
    assert_eq!(&payload[data.range], [9, 8]);
    let nested = message
        .locate(&payload, &["inner", "data"])
        .unwrap()
        .unwrap();
    assert_eq!(&payload[nested.range], [7, 6]);
    assert_eq!(message.locate(&payload, &["text"]).unwrap(), None);
    let node = parse("t.Node");
    assert_eq!(node.fields()[1].data_type(), &DataType::BinaryView);
    let mut decoder = node.decoder(None);
    decoder.push(&[0x08, 1, 0x12, 2, 0x08, 2]).unwrap();
    let columns = decoder.finish().unwrap();
    assert_eq!(columns[1].as_binary_view().value(0), [0x08, 2]);
}

/// `Mapped` has the maps `counts` (of texts, 1) and `numbers` (2), of numbers of 32 bits.
fn mapped() -> FileDescriptorSet {
    let entry = |name: &str, key: Type| DescriptorProto {
        name: Some(name.to_owned()),
        field: vec![
            field("key", 1, key, false),
            field("value", 2, Type::Int32, false),
        ],
        options: Some(MessageOptions {
            map_entry: Some(true),
            ..Default::default()
        }),
        ..Default::default()
    };
    let map = |name: &str, number: i32, of: &str| FieldDescriptorProto {
        type_name: Some(format!(".t.Mapped.{of}")),
        ..field(name, number, Type::Message, true)
    };
    let message = DescriptorProto {
        name: Some("Mapped".to_owned()),
        field: vec![
            map("counts", 1, "CountsEntry"),
            map("numbers", 2, "NumbersEntry"),
        ],
        nested_type: vec![
            entry("CountsEntry", Type::String),
            entry("NumbersEntry", Type::Int32),
        ],
        ..Default::default()
    };
    let file = FileDescriptorProto {
        name: Some("m.proto".to_owned()),
        package: Some("t".to_owned()),
        syntax: Some("proto3".to_owned()),
        message_type: vec![message],
        ..Default::default()
    };
    FileDescriptorSet { file: vec![file] }
}

#[test]
fn of_a_map_the_last_entry_of_a_key_counts() {
    let set = mapped();
    let message =
        MessageType::parse("protobuf", "protobuf", "t.Mapped", &set.encode_to_vec()).unwrap();
    let counted = |key: &str, value: u8| {
        let length = key.len() as u8;
        let (tag, text) = ([0x0A, length + 4, 0x0A, length], key.as_bytes());
        [&tag[..], text, &[0x10, value]].concat()
    };
    let payload = [
        counted("a", 1),
        vec![0x12, 4, 0x08, 7, 0x10, 1],
        counted("b", 2),
        counted("a", 3),
        // No key is the empty one; a number of 32 bits is what is left of one of 64.
        vec![0x0A, 2, 0x10, 4],
        counted("", 5),
        vec![0x12, 8, 0x08, 0x87, 0x80, 0x80, 0x80, 0x10, 0x10, 2],
    ]
    .concat();
    let mut decoder = message.decoder(None);
    decoder.push(&counted("a", 9)).unwrap();
    decoder.push(&payload).unwrap();
    let columns = decoder.finish().unwrap();
    let entries = columns[0].as_list::<i32>().value(1);
    let entries = entries.as_struct();
    let keys: Vec<_> = entries
        .column(0)
        .as_string::<i32>()
        .iter()
        .flatten()
        .collect();
    assert_eq!(keys, ["b", "a", ""]);
    let values = entries.column(1).as_primitive::<Int32Type>();
    assert_eq!(values.values(), &[2, 3, 5]);
    let numbers = columns[1].as_list::<i32>().value(1);
    let numbers = numbers.as_struct();
    assert_eq!(numbers.column(0).as_primitive::<Int32Type>().values(), &[7]);
    assert_eq!(numbers.column(1).as_primitive::<Int32Type>().values(), &[2]);

    let pool = DescriptorPool::from_file_descriptor_set(set).unwrap();
    let descriptor = pool.get_message_by_name("t.Mapped").unwrap();
    let reference = DynamicMessage::decode(descriptor, &payload[..]).unwrap();
    for (name, expected) in [("counts", 3), ("numbers", 1)] {
        let map = reference.get_field_by_name(name).unwrap();
        assert_eq!(map.as_map().unwrap().len(), expected);
    }
}
