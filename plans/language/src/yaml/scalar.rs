//! Scalars by the core schema of YAML 1.2 (section 10.3).

use saphyr_parser::Tag;

use super::Kind;
use crate::fault::{Location, PlanFaults};
use crate::suggest::quoted;

/// The value of a plain (unquoted, untagged) scalar.
pub(crate) fn plain(text: &str) -> Kind {
    match text {
        "" | "~" | "null" | "Null" | "NULL" => return Kind::Null,
        "true" | "True" | "TRUE" => return Kind::Bool(true),
        "false" | "False" | "FALSE" => return Kind::Bool(false),
        ".nan" | ".NaN" | ".NAN" => return Kind::Float(f64::NAN),
        ".inf" | ".Inf" | ".INF" | "+.inf" | "+.Inf" | "+.INF" => {
            return Kind::Float(f64::INFINITY);
        }
        "-.inf" | "-.Inf" | "-.INF" => return Kind::Float(f64::NEG_INFINITY),
        _ => {}
    }
    let float = || is_float(text).then(|| text.parse().ok().map(Kind::Float));
    let number = integer(text).or_else(|| float().flatten());
    number.unwrap_or_else(|| Kind::Text(text.to_owned()))
}

/// The value of a scalar with an explicit tag.
pub(super) fn tagged(text: &str, tag: &Tag, location: Location, faults: &mut PlanFaults) -> Kind {
    let as_text = || Kind::Text(text.to_owned());
    if tag.handle == "!" && tag.suffix.is_empty() || tag.handle.is_empty() && tag.suffix == "!" {
        return as_text();
    }
    let kind = tag.is_yaml_core_schema().then(|| plain(text));
    match (tag.suffix.as_str(), kind) {
        ("str", Some(_)) => {}
        ("null", Some(kind @ Kind::Null))
        | ("bool", Some(kind @ Kind::Bool(_)))
        | ("int", Some(kind @ Kind::Integer(_)))
        | ("float", Some(kind @ Kind::Float(_))) => return kind,
        ("float", Some(Kind::Integer(value))) => return Kind::Float(value as f64),
        (suffix @ ("null" | "bool" | "int" | "float"), Some(_)) => {
            faults.error(location, format!("{} is not of `!!{suffix}`", quoted(text)));
        }
        _ => faults.error(location, unsupported(tag)),
    }
    as_text()
}

/// The message for a tag that means nothing here.
pub(super) fn unsupported(tag: &Tag) -> String {
    format!(
        "the tag {} means nothing here",
        quoted(&format!("{}{}", tag.handle, tag.suffix))
    )
}

/// The value of digits, decimal with or without a sign, octal or hexadecimal; `None` for another text.
fn integer(text: &str) -> Option<Kind> {
    let (number, radix) = match text.split_at_checked(2) {
        Some(("0o", octal)) => (octal, 8),
        Some(("0x", hexadecimal)) => (hexadecimal, 16),
        _ => (text, 10),
    };
    let digits = match radix {
        10 => number.strip_prefix(['-', '+']).unwrap_or(number),
        _ => number,
    };
    if digits.is_empty() || !digits.chars().all(|digit| digit.is_digit(radix)) {
        return None;
    }
    match i128::from_str_radix(number, radix) {
        Ok(value) if (i128::from(i64::MIN)..=i128::from(u64::MAX)).contains(&value) => {
            Some(Kind::Integer(value))
        }
        // Beyond 64 bits it is a number like any other, but no integer.
        _ => text.parse().ok().map(Kind::Float),
    }
}

/// `[-+]? ( \. [0-9]+ | [0-9]+ ( \. [0-9]* )? ) ( [eE] [-+]? [0-9]+ )?`
fn is_float(text: &str) -> bool {
    let unsigned = text.strip_prefix(['-', '+']).unwrap_or(text);
    let (mantissa, exponent) = match unsigned.split_once(['e', 'E']) {
        Some((mantissa, exponent)) => (mantissa, Some(exponent)),
        None => (unsigned, None),
    };
    let digits = |part: &str| part.bytes().all(|byte| byte.is_ascii_digit());
    let (whole, fraction) = mantissa.split_once('.').unwrap_or((mantissa, ""));
    let sound = digits(whole) && digits(fraction) && !(whole.is_empty() && fraction.is_empty());
    let sound_exponent = exponent.is_none_or(|exponent| {
        let exponent = exponent.strip_prefix(['-', '+']).unwrap_or(exponent);
        !exponent.is_empty() && digits(exponent)
    });
    sound && sound_exponent
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

    use super::*;

    fn value(text: &str) -> Kind {
        plain(text)
    }

    #[test]
    fn core_schema() {
        for text in ["", "~", "null", "Null", "NULL"] {
            assert_eq!(value(text), Kind::Null);
        }
        for (text, number) in [("0", 0), ("-7", -7), ("+7", 7), ("007", 7), ("0o14", 12)] {
            assert_eq!(value(text), Kind::Integer(number));
        }
        assert_eq!(value("0xFf"), Kind::Integer(255));
        assert_eq!(
            value("18446744073709551615"),
            Kind::Integer(u64::MAX.into())
        );
        for (text, number) in [
            ("1e-6", 1e-6),
            (".5", 0.5),
            ("5.", 5.0),
            ("-1.5E+3", -1500.0),
        ] {
            assert_eq!(value(text), Kind::Float(number));
        }
        assert_eq!(value("-.inf"), Kind::Float(f64::NEG_INFINITY));
        assert_eq!(value("True"), Kind::Bool(true));
        for text in [
            "yes", "on", "nULL", ".", "-", "+", "e5", "1e", "1e+", "0x", "0o8", "1_000", "inf",
            "nan", "NaN", "1.2.3", "12:30", "-0x1", "١", "..5", "+-1",
        ] {
            assert_eq!(value(text), Kind::Text(text.to_owned()), "{text}");
        }
    }

    #[test]
    fn an_integer_beyond_64_bits_is_a_plain_number() {
        let cases = [
            ("18446744073709551616", 18446744073709551616.0),
            ("-1000000000000000000000", -1e21),
        ];
        for (text, number) in cases {
            assert_eq!(value(text), Kind::Float(number));
        }
        let hexadecimal = format!("0x{}", "f".repeat(40));
        assert_eq!(value(&hexadecimal), Kind::Text(hexadecimal.clone()));
    }
}
