//! ROS 2 messages, hand-built byte by byte.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use arrow::array::{Array, AsArray};
use arrow::datatypes::{DataType, Fields, Float64Type, Int32Type, UInt32Type};
use evermap_messages::MessageType;

const STAMPED: &str = "\
std_msgs/Header header  # when and where
uint8 MODE_A=1
string NAME = \"a # b\"
string<=10 label \"default = 3\"
float64[2] pair
uint8[] data
float64[<=3] bounded
bool ok
std_msgs/Empty nothing
uint8[3] colour
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
================================================================================
MSG: std_msgs/Empty
";

fn payload() -> Vec<u8> {
    let mut p = vec![0, 1, 0, 0];
    p.extend(7_i32.to_le_bytes());
    p.extend(9_u32.to_le_bytes());
    p.extend(4_u32.to_le_bytes());
    p.extend(b"map\0");
    p.extend(3_u32.to_le_bytes());
    p.extend(b"hi\0");
    p.extend([0; 1]); // to offset 24
    p.extend(1.5_f64.to_le_bytes());
    p.extend((-2.5_f64).to_le_bytes());
    p.extend(2_u32.to_le_bytes());
    p.extend([0xAA, 0xBB, 0, 0]); // data, padding to offset 48
    p.extend(1_u32.to_le_bytes());
    p.extend([0; 4]);
    p.extend(4.25_f64.to_le_bytes());
    p.extend([1, 0, 10, 20, 30]);
    p
}

#[test]
fn every_member_lands_in_its_column() {
    let message =
        MessageType::parse("cdr", "ros2msg", "my/msg/Stamped", STAMPED.as_bytes()).unwrap();
    let names: Vec<_> = message.fields().iter().map(|f| f.name().as_str()).collect();
    assert_eq!(
        names,
        [
            "header", "label", "pair", "data", "bounded", "ok", "nothing", "colour"
        ]
    );
    let mut decoder = message.decoder(None);
    decoder.push(&payload()).unwrap();
    assert_eq!(decoder.len(), 1);
    let columns = decoder.finish().unwrap();
    let header = columns[0].as_struct();
    let stamp = header.column(0).as_struct();
    assert_eq!(stamp.column(0).as_primitive::<Int32Type>().value(0), 7);
    assert_eq!(stamp.column(1).as_primitive::<UInt32Type>().value(0), 9);
    assert_eq!(header.column(1).as_string::<i32>().value(0), "map");
    assert_eq!(columns[1].as_string::<i32>().value(0), "hi");
    let pair = columns[2].as_fixed_size_list().value(0);
    assert_eq!(pair.as_primitive::<Float64Type>().values(), &[1.5, -2.5]);
    assert_eq!(columns[3].as_binary_view().value(0), [0xAA, 0xBB]);
    let bounded = columns[4].as_list::<i32>().value(0);
    assert_eq!(bounded.as_primitive::<Float64Type>().values(), &[4.25]);
    assert!(columns[5].as_boolean().value(0));
    assert_eq!(columns[6].len(), 1);
    assert_eq!(columns[6].data_type(), &DataType::Struct(Fields::empty()));
    assert_eq!(columns[7].as_fixed_size_binary().value(0), [10, 20, 30]);
}

/// ROS 2 writes units of UTF-16 in cells of 32 bits, others characters.
#[test]
fn wide_text_loses_no_character() {
    let message = MessageType::parse("cdr", "ros2msg", "my/msg/W", b"wstring w\n").unwrap();
    let mut decoder = message.decoder(None);
    let texts: [(&[u32], &str); 4] = [
        (&[0xE9, 0x78], "éx"),
        (&[0xD83D, 0xDE00, 0x78], "😀x"),
        (&[0x1F600, 0x78], "😀x"),
        (&[0x78, 0x0011_0000, 0xD83D, 0x79], "x\u{FFFD}\u{FFFD}y"),
    ];
    for (cells, _) in texts {
        let count = cells.len() as u32;
        let values = || [count].into_iter().chain(cells.iter().copied());
        let little: Vec<u8> = values().flat_map(u32::to_le_bytes).collect();
        let big: Vec<u8> = values().flat_map(u32::to_be_bytes).collect();
        decoder
            .push(&[&[0_u8, 1, 0, 0][..], &little].concat())
            .unwrap();
        decoder.push(&[&[0_u8; 4][..], &big].concat()).unwrap();
    }
    let columns = decoder.finish().unwrap();
    let found: Vec<&str> = columns[0].as_string::<i32>().iter().flatten().collect();
    let expected: Vec<&str> = texts.iter().flat_map(|(_, text)| [*text; 2]).collect();
    assert_eq!(found, expected);
}

#[test]
fn a_payload_cut_anywhere_appends_nothing() {
    let message =
        MessageType::parse("cdr", "ros2msg", "my/msg/Stamped", STAMPED.as_bytes()).unwrap();
    let whole = payload();
    let mut decoder = message.decoder(None);
    for end in 0..whole.len() {
        decoder.push(&whole[..end]).unwrap_err();
        assert_eq!(decoder.len(), 0);
    }
    decoder.push(&whole).unwrap();
    for column in decoder.finish().unwrap() {
        assert_eq!(column.len(), 1);
    }
    let located = message.locate(&whole, &["data"]).unwrap().unwrap();
    assert_eq!(&whole[located.range], [0xAA, 0xBB]);
    let colour = message.locate(&whole, &["colour"]).unwrap().unwrap();
    assert_eq!(&whole[colour.range], [10, 20, 30]);
    assert_eq!(message.locate(&whole, &["header"]).unwrap(), None);
}
