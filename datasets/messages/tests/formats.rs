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
    assert_eq!(columns[4].as_binary::<i32>().value(0), [7, 8]);
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
    assert_eq!(columns[3].as_binary::<i32>().value(0), b"hi");
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
