//! The other formats, hand-built.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use arrow::array::{Array, ArrayRef, AsArray};
use arrow::datatypes::{
    DataType, Float32Type, Float64Type, Int8Type, Int32Type, Int64Type, UInt8Type, UInt32Type,
};
use evermap_messages::{DecodeError, MessageType, SchemaError};

fn decode(message: &MessageType, payload: &[u8]) -> Vec<ArrayRef> {
    let mut decoder = message.decoder(None);
    decoder.push(payload).unwrap();
    decoder.finish().unwrap()
}

#[test]
fn ros1_has_no_alignment_and_its_own_small_types() {
    let text = "Header header\nbyte signed\nchar unsigned\nduration d\nfloat64 x\nEmpty[2] none\n\
        ================\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n\
        ================\nMSG: my/Empty\n";
    let message = MessageType::parse("ros1", "ros1msg", "my/Thing", text.as_bytes()).unwrap();
    let mut p = Vec::new();
    p.extend(5_u32.to_le_bytes());
    p.extend([1, 0, 0, 0, 2, 0, 0, 0]);
    p.extend([3, 0, 0, 0, b'm', b'a', b'p', 0xFF, 0xFE]);
    p.extend((-4_i32).to_le_bytes());
    p.extend((-5_i32).to_le_bytes());
    p.extend(0.5_f64.to_le_bytes());
    let columns = decode(&message, &p);
    let header = columns[0].as_struct();
    assert_eq!(header.column(0).as_primitive::<UInt32Type>().value(0), 5);
    assert_eq!(header.column(2).as_string::<i32>().value(0), "map");
    assert_eq!(columns[1].as_primitive::<Int8Type>().value(0), -1);
    assert_eq!(columns[2].as_primitive::<UInt8Type>().value(0), 254);
    let d = columns[3].as_struct();
    assert_eq!(d.column(1).as_primitive::<Int32Type>().value(0), -5);
    assert_eq!(columns[4].as_primitive::<Float64Type>().value(0), 0.5);
    assert_eq!(columns[5].as_fixed_size_list().values().len(), 2);
}

#[test]
fn a_count_of_elements_without_bytes_is_not_believed() {
    let text = "Empty[] none\n================\nMSG: my/Empty\n";
    let message = MessageType::parse("ros1", "ros1msg", "my/Thing", text.as_bytes()).unwrap();
    let mut decoder = message.decoder(None);
    decoder.push(&[3, 0, 0, 0]).unwrap();
    decoder.push(&[0xFF; 4]).unwrap_err();
    assert_eq!(
        decoder.finish().unwrap()[0]
            .as_list::<i32>()
            .value_length(0),
        3
    );
}

const IDL: &str = r#"
// a comment
#include "std_msgs/msg/header.idl"
module my { module msg {
  module Thing_Constants { const uint8 SIZE = 3; const string S = "};"; };
  typedef double double__3[Thing_Constants::SIZE];
  enum Mode { @value(0) OFF, ON };
  @verbatim (language="comment", text="a ) b" "c")
  struct Thing {
    @unit(value="m") float x, y;
    double__3 d;
    my::msg::Mode mode;
    sequence<octet, 5> data;
    sequence<Inner> inners;
    unsigned long long big;
    wstring<9> wide;
    long grid[2][3];
  };
}; };
====================
IDL: my/msg/Inner
module my { module msg { struct Inner { boolean ok; string<3> s; }; }; };
"#;

#[test]
fn idl_modules_typedefs_enums_and_arrays() {
    let text = IDL.replace(
        "  @verbatim",
        "  struct Inner { boolean ok; string<3> s; };\n  @verbatim",
    );
    let message = MessageType::parse("cdr", "ros2idl", "my/msg/Thing", text.as_bytes()).unwrap();
    let mut p = vec![0, 0, 0, 0]; // big-endian
    p.extend(1.5_f32.to_be_bytes());
    p.extend(2.5_f32.to_be_bytes());
    for d in [1.0_f64, 2.0, 3.0] {
        p.extend(d.to_be_bytes());
    }
    p.extend([0, 0, 0, 1]); // mode
    p.extend([0, 0, 0, 2, 7, 8, 0, 0]); // data, to offset 44
    p.extend([0, 0, 0, 1, 1, 0, 0, 0, 0, 0, 0, 2, b'k', 0]); // one inner, to 58
    p.extend([0; 6]);
    p.extend(9_u64.to_be_bytes());
    p.extend([0, 0, 0, 2, 0, 0, 0, b'h', 0, 0, 0, 0xE9]); // "hé"
    for n in 1_i32..=6 {
        p.extend(n.to_be_bytes());
    }
    let columns = decode(&message, &p);
    assert_eq!(columns[1].as_primitive::<Float32Type>().value(0), 2.5);
    let d = columns[2].as_fixed_size_list().value(0);
    assert_eq!(d.as_primitive::<Float64Type>().values(), &[1.0, 2.0, 3.0]);
    assert_eq!(columns[3].as_primitive::<Int32Type>().value(0), 1);
    assert_eq!(columns[4].as_binary_view().value(0), [7, 8]);
    let inner = columns[5].as_list::<i32>().value(0);
    assert_eq!(inner.as_struct().column(1).as_string::<i32>().value(0), "k");
    assert_eq!(columns[7].as_string::<i32>().value(0), "hé");
    let grid = columns[8].as_fixed_size_list().values().clone();
    let grid = grid.as_fixed_size_list().values().clone();
    assert_eq!(
        grid.as_primitive::<Int32Type>().values(),
        &[1, 2, 3, 4, 5, 6]
    );
    let located = message.locate(&p, &["data"]).unwrap().unwrap();
    assert_eq!(&p[located.range], [7, 8]);
    assert!(MessageType::parse("cdr", "ros2idl", "my/msg/Thing", IDL.as_bytes()).is_ok());
}

#[test]
fn cdr2_aligns_to_four_and_delimits() {
    let text = "float64 x\nstring[] names\n";
    let message = MessageType::parse("cdr", "ros2msg", "my/msg/T", text.as_bytes()).unwrap();
    let names = [1, 0, 0, 0, 2, 0, 0, 0, b'a', 0];
    for (kind, delimited) in [(7_u8, false), (9, true)] {
        let mut p = vec![0, kind, 0, 0];
        if delimited {
            p.extend(22_u32.to_le_bytes());
        }
        p.extend(0.5_f64.to_le_bytes());
        p.extend(10_u32.to_le_bytes());
        p.extend(names);
        let columns = decode(&message, &p);
        assert_eq!(columns[0].as_primitive::<Float64Type>().value(0), 0.5);
        let list = columns[1].as_list::<i32>().value(0);
        assert_eq!(list.as_string::<i32>().value(0), "a");
    }
    let mut decoder = message.decoder(None);
    let refused = DecodeError::Encapsulation { identifier: 3 };
    assert_eq!(decoder.push(&[0, 3, 0, 0]), Err(refused));
    let zstd = [0x28, 0xB5, 0x2F, 0xFD, 0];
    assert_eq!(decoder.push(&zstd), Err(DecodeError::Compressed));
}

#[test]
fn unsound_schemas_are_refused_in_one_line() {
    let parse = |encoding, text: &str| {
        MessageType::parse("cdr", encoding, "a/msg/A", text.as_bytes()).unwrap_err()
    };
    assert!(matches!(
        parse("ros2msg", "A a"),
        SchemaError::Recursive { .. }
    ));
    assert!(matches!(
        parse("ros2msg", "B b"),
        SchemaError::UnknownType { .. }
    ));
    assert!(matches!(
        parse("ros2msg", "int32"),
        SchemaError::Syntax { line: 1, .. }
    ));
    assert!(matches!(
        parse("ros2msg", "int32[0] a"),
        SchemaError::Refused { .. }
    ));
    assert!(matches!(
        parse("flatbuffer", ""),
        SchemaError::Unsupported { .. }
    ));
    let union = "module a { module msg { union U switch (long) { case 1: long x; }; }; };";
    assert!(parse("ros2idl", union).to_string().contains("union 'U'"));
    // A schema that unfolds to 2^40 columns.
    let doubling: String = (0..40)
        .map(|n| format!("================\nMSG: a/T{n}\nT{0} x\nT{0} y\n", n + 1))
        .collect();
    let bomb = format!("T0 t\n{doubling}================\nMSG: a/T40\nint8 z\n");
    assert!(matches!(
        parse("ros2msg", &bomb),
        SchemaError::Refused { .. }
    ));
    assert!(!parse("ros2msg", &bomb).to_string().contains('\n'));
}

#[test]
fn json_follows_its_schema() {
    let schema = r##"{"type":"object","properties":{
        "stamp":{"$ref":"#/$defs/time"},"n":{"type":"integer"},"x":{"type":["number","null"]},
        "data":{"type":"string","contentEncoding":"base64"},"any":{"oneOf":[{},{"type":"string"}]},
        "kind":{"oneOf":[{"const":0},{"const":1}]},"list":{"type":"array","items":{"type":"number"}}},
        "$defs":{"time":{"type":"object","properties":{"sec":{"type":"integer"}}}}}"##;
    let message = MessageType::parse("json", "jsonschema", "T", schema.as_bytes()).unwrap();
    let payload = br#"{"stamp":{"sec":4},"n":7.0,"x":true,"data":"aGk=","any":{"b":[1]},"kind":1,"list":[1,null]}"#;
    let columns = decode(&message, payload);
    let stamp = columns[0].as_struct();
    assert_eq!(stamp.column(0).as_primitive::<Int64Type>().value(0), 4);
    assert_eq!(columns[1].as_primitive::<Int64Type>().value(0), 7);
    assert_eq!(columns[2].as_primitive::<Float64Type>().value(0), 1.0);
    assert_eq!(columns[3].as_binary_view().value(0), b"hi");
    assert_eq!(columns[4].as_string::<i32>().value(0), r#"{"b":[1]}"#);
    assert_eq!(columns[5].as_primitive::<Int64Type>().value(0), 1);
    assert_eq!(columns[6].as_list::<i32>().value(0).null_count(), 1);
    let located = message.locate(payload, &["data"]).unwrap().unwrap();
    assert!(located.base64);
    assert_eq!(&payload[located.range], b"aGk=");
    let mut some = message.decoder(Some(&[1]));
    some.push(br#"{"data":"*"}"#).unwrap_err();
    some.push(b"{}").unwrap();
    assert_eq!(some.finish().unwrap()[0].null_count(), 1);
    let untyped = MessageType::parse("json", "", "", b"").unwrap();
    assert_eq!(untyped.fields()[0].data_type(), &DataType::Utf8);
    assert_eq!(
        decode(&untyped, b" [1, 2] ")[0].as_string::<i32>().value(0),
        "[1, 2]"
    );
}

proptest::proptest! {
    #[test]
    fn numbers_of_json_are_those_that_were_written(x in proptest::num::f64::NORMAL) {
        let schema = br#"{"type":"object","properties":{"x":{"type":"number"}}}"#;
        let message = MessageType::parse("json", "jsonschema", "T", schema).unwrap();
        let read = decode(&message, format!(r#"{{"x":{x:?}}}"#).as_bytes());
        proptest::prop_assert_eq!(read[0].as_primitive::<Float64Type>().value(0).to_bits(), x.to_bits());
    }
}

/// Protobuf on the wire: a varint, a field of bytes, a field of a number.
fn varint(mut value: u64) -> Vec<u8> {
    let mut bytes = Vec::new();
    while value >= 128 {
        bytes.push(value as u8 | 128);
        value >>= 7;
    }
    bytes.push(value as u8);
    bytes
}
fn lengthed(number: u64, body: &[u8]) -> Vec<u8> {
    [
        varint(number << 3 | 2),
        varint(body.len() as u64),
        body.to_vec(),
    ]
    .concat()
}
fn numbered(number: u64, value: u64) -> Vec<u8> {
    [varint(number << 3), varint(value)].concat()
}
/// A field's descriptor; `rest` are further fields of it.
fn field(name: &str, number: u64, kind: u64, rest: &[Vec<u8>]) -> Vec<u8> {
    let parts = [
        lengthed(1, name.as_bytes()),
        numbered(3, number),
        numbered(5, kind),
        rest.concat(),
    ];
    lengthed(2, &parts.concat())
}
fn message(name: &str, parts: &[Vec<u8>]) -> Vec<u8> {
    lengthed(4, &[lengthed(1, name.as_bytes()), parts.concat()].concat())
}
fn file(parts: &[Vec<u8>]) -> Vec<u8> {
    lengthed(1, &[lengthed(1, b"a.proto"), parts.concat()].concat())
}

#[test]
fn an_edition_of_protobuf_decodes_as_its_features_say() {
    // FieldOptions.features (21): presence IMPLICIT (1: 2), message encoding DELIMITED (5: 2).
    let implicit = lengthed(8, &lengthed(21, &numbered(1, 2)));
    let delimited = lengthed(8, &lengthed(21, &numbered(5, 2)));
    let set = file(&[
        lengthed(2, b"p"),
        message("Inner", &[field("n", 1, 5, &[])]),
        message(
            "M",
            &[
                field("explicit", 1, 5, &[]),
                field("implicit", 2, 5, &[implicit]),
                field("group", 3, 11, &[delimited, lengthed(6, b".p.Inner")]),
                field("relative", 4, 11, &[lengthed(6, b"Inner")]),
            ],
        ),
        lengthed(12, b"editions"),
        numbered(14, 1000),
    ]);
    let message = MessageType::parse("protobuf", "protobuf", "p.M", &set).unwrap();
    let nullable: Vec<bool> = message.fields().iter().map(|f| f.is_nullable()).collect();
    assert_eq!(nullable, [true, false, true, true]);
    // The group lies between tags 3 and 4, the relative message behind a length.
    let columns = decode(&message, &[0x1B, 0x08, 7, 0x1C, 0x22, 2, 0x08, 9]);
    assert!(columns[0].is_null(0));
    assert_eq!(columns[1].as_primitive::<Int32Type>().value(0), 0);
    let n = |column: usize| columns[column].as_struct().column(0).clone();
    assert_eq!(n(2).as_primitive::<Int32Type>().value(0), 7);
    assert_eq!(n(3).as_primitive::<Int32Type>().value(0), 9);
}

#[test]
fn hostile_descriptors_are_read_or_refused() {
    let parse = |set: &[u8], name| MessageType::parse("protobuf", "protobuf", name, set);
    let plain = message("M", &[field("x", 1, 5, &[])]);
    // A public import of itself, and options that are redefined, are nothing to decoding.
    let own = file(&[lengthed(3, b"a.proto"), numbered(10, 0), plain.clone()]);
    assert_eq!(parse(&own, "M").unwrap().fields().len(), 1);
    let redefined = file(&[
        lengthed(2, b"google.protobuf"),
        message("MessageOptions", &[field("map_entry", 7, 9, &[])]),
        message(
            "M",
            &[field("x", 1, 5, &[]), lengthed(7, &lengthed(7, b"x"))],
        ),
    ]);
    assert_eq!(
        parse(&redefined, "google.protobuf.M")
            .unwrap()
            .fields()
            .len(),
        1
    );
    let nested = (0..100).fold(plain, |inner, _| {
        let mut inner = inner;
        inner[0] = 3 << 3 | 2;
        message("N", &[inner])
    });
    parse(&file(&[nested]), "M").unwrap_err();
    // Messages that hold each other twice: 2^30 columns.
    let doubling: Vec<Vec<u8>> = (0..30)
        .map(|n| {
            let next = [lengthed(6, format!(".T{}", n + 1).as_bytes())];
            let fields = [field("a", 1, 11, &next), field("b", 2, 11, &next)];
            message(&format!("T{n}"), &fields)
        })
        .collect();
    let last = message("T30", &[field("x", 1, 5, &[])]);
    let refused = parse(&file(&[doubling.concat(), last]), "T0").unwrap_err();
    assert!(refused.to_string().contains("columns"), "{refused}");
    for cut in 0..own.len() {
        let _ = parse(&own[..cut], "M");
    }
}

/// Members, lines and scopes by the ten thousand: each is refused, or read in time that follows its length.
#[test]
fn definitions_out_of_proportion_are_refused() {
    let ros = |text: &str| MessageType::parse("cdr", "ros2msg", "a/msg/X", text.as_bytes());
    let members = |n: usize| (0..n).map(|n| format!("int8 a{n}\n")).collect::<String>();
    assert_eq!(ros(&members(4096)).unwrap().fields().len(), 4096);
    let wide = ros(&members(4097)).unwrap_err().to_string();
    assert!(
        wide.contains("at most 4096 members of a message, found 4097"),
        "{wide}"
    );
    let within = format!("T t\n================\nMSG: a/T\n{}", members(20_000 - 2));
    assert_eq!(ros(&within).unwrap().fields().len(), 1);
    ros(&members(30_000)).unwrap_err();
    ros(&"# nothing\n".repeat(200_000)).unwrap_err();
    let doubling: String = (0..50)
        .map(|n| format!("================\nMSG: a/T{n}\nT{0}[2] x\nT{0} y\n", n + 1))
        .collect();
    ros(&format!(
        "T0[2] t\n{doubling}================\nMSG: a/T50\nint8 z\n"
    ))
    .unwrap_err();
    // A name is looked for in every scope: 40 of 1,000 letters, 10,000 times.
    let scopes: Vec<String> = (0..40)
        .map(|n| format!("m{n}{}", "x".repeat(1_000)))
        .collect();
    let idl = [
        scopes.iter().map(|s| format!("module {s} {{\n")).collect(),
        "struct S {\n".to_owned(),
        (0..10_000).map(|n| format!("T a{n};\n")).collect(),
        "};\n".to_owned(),
        "};\n".repeat(40),
    ]
    .concat();
    let refused = MessageType::parse("cdr", "ros2idl", "a/msg/S", idl.as_bytes()).unwrap_err();
    assert!(refused.to_string().contains("steps"), "{refused}");
}

/// Few bytes that stand for many columns' worth of nothing.
#[test]
fn messages_that_unfold_out_of_proportion_are_refused_and_others_are_not() {
    let unfolds = |message: &MessageType, payload: &[u8]| {
        let mut decoder = message.decoder(None);
        let refused = decoder.push(payload).unwrap_err();
        assert!(matches!(refused, DecodeError::Unfolds { .. }), "{refused}");
        assert!(decoder.is_empty());
    };
    // ROS 1: arrays of arrays of messages without members.
    let text = "Z[] z\n================\nMSG: my/Z\nA[16000] a\n================\nMSG: my/A\n\
        B[65536] b\n================\nMSG: my/B\nEmpty[1] e\n================\nMSG: my/Empty\n";
    let ros1 = MessageType::parse("ros1", "ros1msg", "my/R", text.as_bytes()).unwrap();
    unfolds(&ros1, &65_536_u32.to_le_bytes());
    // Protobuf: two bytes for sixty absent numbers.
    let numbers: Vec<Vec<u8>> = (1..=60)
        .map(|n| field(&format!("f{n}"), n, 3, &[]))
        .collect();
    let repeated = [numbered(4, 3), lengthed(6, b".I")];
    let set = file(&[
        message("I", &numbers),
        message("M", &[field("a", 1, 11, &repeated)]),
    ]);
    let protobuf = MessageType::parse("protobuf", "protobuf", "M", &set).unwrap();
    unfolds(&protobuf, &[0x0A, 0].repeat(100_000));
    assert_eq!(decode(&protobuf, &[0x0A, 0].repeat(10_000))[0].len(), 1);
    // JSON: three bytes for two hundred absent properties.
    let properties: Vec<String> = (0..200)
        .map(|n| format!("\"p{n}\":{{\"type\":\"integer\"}}"))
        .collect();
    let schema = format!(
        "{{\"properties\":{{\"a\":{{\"type\":\"array\",\"items\":{{\"properties\":{{{}}}}}}}}}}}",
        properties.join(",")
    );
    let json = MessageType::parse("json", "jsonschema", "T", schema.as_bytes()).unwrap();
    unfolds(
        &json,
        format!("{{\"a\":[{}{{}}]}}", "{},".repeat(100_000)).as_bytes(),
    );
    assert_eq!(
        decode(&json, br#"{"a":[{},{}]}"#)[0]
            .as_list::<i32>()
            .value_length(0),
        2
    );
}

#[test]
fn the_last_of_equal_json_names_counts() {
    let schema = br#"{"properties":{"n":{"type":"integer"},"l":{"type":"array","items":
        {"properties":{"x":{"type":"string"},"m":{"properties":{"k":{"type":"number"}}}}}}}}"#;
    let message = MessageType::parse("json", "jsonschema", "T", schema).unwrap();
    let payload = br#"{"n":1,"l":[{"x":"a"}],"other":{"n":[7]},"n":2,
        "l":[{"x":"b","m":{"k":1},"m":null},{"m":{},"m":{"k":3}}]}"#;
    let columns = decode(&message, payload);
    assert_eq!(columns[0].as_primitive::<Int64Type>().value(0), 2);
    let list = columns[1].as_list::<i32>().value(0);
    let items = list.as_struct();
    assert_eq!(items.len(), 2);
    assert_eq!(
        items
            .column(0)
            .as_string::<i32>()
            .iter()
            .collect::<Vec<_>>(),
        [Some("b"), None]
    );
    let inner = items.column(1);
    assert!(inner.is_null(0) && inner.is_valid(1));
    let k = inner.as_struct().column(0).as_primitive::<Float64Type>();
    assert_eq!(k.value(1), 3.0);
    columns[1].to_data().validate_full().unwrap();
}
