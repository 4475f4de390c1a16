#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use arrow::array::{Array, AsArray};
use arrow::datatypes::{Field, Int64Type, TimeUnit};

use super::*;

/// A text of which the client says this type, or none.
fn read(text: &str, declared: Option<&Type>, target: &DataType) -> PgWireResult<Option<Value>> {
    let bound = Bound {
        bytes: text.as_bytes(),
        is_text: true,
        is_declared: declared.is_some(),
        kind: declared.unwrap_or(&Type::UNKNOWN),
        target,
    };
    bound.read()
}

fn value(text: &str, declared: Option<&Type>, target: &DataType) -> ScalarValue {
    read(text, declared, target).unwrap().unwrap().value
}

fn list_of(item: DataType) -> DataType {
    DataType::List(Arc::new(Field::new_list_field(item, true)))
}

#[test]
fn texts_of_no_type_are_what_their_place_has() {
    for (text, target, expected) in [
        (" a ", DataType::Null, ScalarValue::from(" a ")),
        ("{a,b}", DataType::Utf8, ScalarValue::from("{a,b}")),
        (" -7 ", DataType::Int32, ScalarValue::from(-7_i32)),
        (
            "18446744073709551615",
            DataType::UInt64,
            ScalarValue::from(u64::MAX),
        ),
        ("t", DataType::Boolean, ScalarValue::from(true)),
        (
            "1970-01-01 00:00:01.5+00",
            DataType::Timestamp(TimeUnit::Nanosecond, None),
            ScalarValue::TimestampNanosecond(Some(1_500_000_000), None),
        ),
    ] {
        assert_eq!(value(text, None, &target), expected, "{text}");
    }
    let instants = DataType::Timestamp(TimeUnit::Nanosecond, None);
    for (text, target) in [
        ("1.5", DataType::Int64),
        ("-1", DataType::UInt32),
        ("5", instants.clone()),
        ("1500-01-01 00:00:00", instants),
        ("soon", DataType::Float64),
    ] {
        let refused = read(text, None, &target).unwrap_err().to_string();
        let said = format!("found `{text}`");
        assert!(refused.contains(&said), "{refused}");
    }
    // The library knows these.
    assert_eq!(read("\\x01", None, &DataType::Binary).unwrap(), None);
    assert_eq!(
        read("7", Some(&Type::INT4), &DataType::Int32).unwrap(),
        None
    );
}

#[test]
fn lists_are_of_the_type_of_their_place() {
    let numbers = value(
        "{1,NULL,-3}",
        Some(&Type::INT2_ARRAY),
        &list_of(DataType::Int64),
    );
    let ScalarValue::List(numbers) = numbers else {
        unreachable!("{numbers}");
    };
    let numbers = numbers.value(0);
    let numbers: Vec<_> = numbers.as_primitive::<Int64Type>().iter().collect();
    assert_eq!(numbers, [Some(1), None, Some(-3)]);
    for text in ["{1,x}", "{1,{2}}"] {
        assert!(
            read(text, None, &list_of(DataType::UInt32)).is_err(),
            "{text}"
        );
    }
    let ScalarValue::List(none) = value("{}", None, &list_of(DataType::UInt32)) else {
        unreachable!("no list");
    };
    assert_eq!((none.len(), none.value(0).len()), (1, 0));
}

#[test]
fn exact_numbers_lose_nothing() {
    let numeric = |text, target: &DataType| read(text, Some(&Type::NUMERIC), target);
    let half = numeric("1.5", &DataType::Float64).unwrap().unwrap();
    assert_eq!(half, ScalarValue::from(1.5_f64).into());
    let one = numeric("1.00", &DataType::Float64).unwrap().unwrap();
    assert_eq!(
        (one.value, one.whole),
        (ScalarValue::from(1.0_f64), Some(1_i64.into()))
    );
    let large = numeric("18446744073709551615", &DataType::Float64)
        .unwrap()
        .unwrap();
    assert_eq!(large.whole, Some(u64::MAX.into()));
    let told = numeric("2.0", &DataType::UInt64).unwrap().unwrap();
    assert_eq!(told.value, ScalarValue::from(2_u64));
    for (text, target) in [
        ("1.5", DataType::UInt32),
        ("-1", DataType::UInt64),
        ("x", DataType::Float64),
    ] {
        assert!(numeric(text, &target).is_err(), "{text}");
    }
    let list = |text| {
        let kind = Some(&Type::NUMERIC_ARRAY);
        read(text, kind, &list_of(DataType::Float64))
            .unwrap()
            .unwrap()
    };
    assert_eq!(list("{1,2.5}").whole, None);
    let Some(ScalarValue::List(whole)) = list("{9007199254740993,NULL}").whole else {
        unreachable!("no list");
    };
    assert_eq!(
        whole.value(0).as_primitive::<Int64Type>().value(0),
        9_007_199_254_740_993
    );
}

fn bytes(groups: &[u16], first: i16, sign: u16, behind: u16) -> Vec<u8> {
    let mut bytes = Vec::new();
    bytes.extend(u16::try_from(groups.len()).unwrap().to_be_bytes());
    bytes.extend(first.to_be_bytes());
    bytes.extend(sign.to_be_bytes());
    bytes.extend(behind.to_be_bytes());
    bytes.extend(groups.iter().flat_map(|group| group.to_be_bytes()));
    bytes
}

#[test]
fn exact_numbers_are_read_from_bytes() {
    for (made, expected) in [
        (bytes(&[], 0, 0, 0), "0"),
        (bytes(&[1, 5000], 0, 0, 1), "1.5"),
        (bytes(&[12, 34], 1, 0x4000, 0), "-120034"),
        (bytes(&[1], 2, 0, 2), "100000000.00"),
        (bytes(&[5], -2, 0, 8), "0.00000005"),
        (bytes(&[], 0, 0xC000, 0), "NaN"),
    ] {
        assert_eq!(numeric(&made).as_deref(), Some(expected));
    }
    let right = bytes(&[1, 5000], 0, 0, 1);
    let wrong: [&[u8]; 5] = [
        &right[..9],
        &[&right[..], &[0]].concat(),
        &bytes(&[10_000], 0, 0, 0),
        &bytes(&[], 0, 1, 0),
        &[],
    ];
    for bytes in wrong {
        assert_eq!(numeric(bytes), None, "{bytes:?}");
    }
    let mut list = Vec::new();
    for number in [1_u32, 1, Type::NUMERIC.oid(), 2, 1] {
        list.extend(number.to_be_bytes());
    }
    list.extend(u32::try_from(right.len()).unwrap().to_be_bytes());
    list.extend(&right);
    let numerics = |list: &[u8]| Format::of(&Type::NUMERIC_ARRAY).unwrap().many(list);
    assert_eq!(numerics(&list), None, "one is missing");
    list.extend((-1_i32).to_be_bytes());
    let found = numerics(&list).unwrap();
    assert_eq!(found.iter().collect::<Vec<_>>(), [Some("1.5"), None]);
    list[12..16].copy_from_slice(&i32::MAX.to_be_bytes());
    assert_eq!(numerics(&list), None, "billions of them");
}

/// Clients say them without dashes, or by their bytes.
#[test]
fn uuids_are_texts_with_dashes() {
    let id = Uuid::from_u128(0x0193_F0A1_7E2B_7C3D_8E4F_5A6B_7C8D_9E0F);
    let expected = id.to_string();
    assert_eq!(expected, "0193f0a1-7e2b-7c3d-8e4f-5a6b7c8d9e0f");
    let written = [id.simple().to_string(), expected.to_uppercase()];
    for text in &written {
        for target in [DataType::Utf8, DataType::Null] {
            let found = value(text, Some(&Type::UUID), &target);
            assert_eq!(found, ScalarValue::from(expected.as_str()));
        }
    }
    let of_bytes = |bytes: &[u8], kind: &Type, target: &DataType| {
        let bound = Bound {
            bytes,
            is_text: false,
            is_declared: true,
            kind,
            target,
        };
        bound.read().map(|read| read.unwrap().value)
    };
    let found = of_bytes(id.as_bytes(), &Type::UUID, &DataType::Utf8).unwrap();
    assert_eq!(found, ScalarValue::from(expected.as_str()));

    let texts = list_of(DataType::Utf8);
    let mut list = Vec::new();
    for number in [1_u32, 1, Type::UUID.oid(), 2, 1, 16] {
        list.extend(number.to_be_bytes());
    }
    list.extend(id.as_bytes());
    list.extend((-1_i32).to_be_bytes());
    let text = format!("{{{},NULL}}", written[0]);
    for found in [
        value(&text, Some(&Type::UUID_ARRAY), &texts),
        of_bytes(&list, &Type::UUID_ARRAY, &texts).unwrap(),
    ] {
        let ScalarValue::List(found) = found else {
            unreachable!("{found}");
        };
        let found = found.value(0);
        let found: Vec<_> = found.as_string::<i32>().iter().collect();
        assert_eq!(found, [Some(expected.as_str()), None]);
    }
    let no_uuid = read("7", Some(&Type::UUID), &DataType::Utf8).unwrap_err();
    let said = "expected a value of the type uuid, found `7`";
    assert!(no_uuid.to_string().contains(said), "{no_uuid}");
    assert!(of_bytes(&[1, 2], &Type::UUID, &DataType::Utf8).is_err());
    assert!(of_bytes(&list[..40], &Type::UUID_ARRAY, &texts).is_err());
}
