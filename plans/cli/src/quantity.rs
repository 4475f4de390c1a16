//! Amounts as people write and read them.

use bytesize::ByteSize;

/// Bytes from text: `1GiB`, `512 MiB`, `2GB`, `1048576`.
///
/// # Errors
/// A sentence that says what is expected.
pub fn bytes(text: &str) -> Result<usize, String> {
    // A number alone that 64 bits do not have is read with its unit alone.
    let ByteSize(amount) = text
        .parse::<ByteSize>()
        .or_else(|_| format!("{text}B").parse())
        .map_err(|_| format!("expected an amount such as 1GiB, found {text}"))?;
    if !(bytesize::MIB..=bytesize::PIB).contains(&amount) {
        return Err(format!("expected 1 MiB to 1 PiB, found {text}"));
    }
    Ok(amount as usize)
}

/// Bytes for people.
pub fn of_bytes(bytes: u64) -> String {
    ByteSize(bytes).to_string()
}

/// A duration for people.
pub fn of_seconds(seconds: f64) -> String {
    match seconds {
        s if s < 1.0 => format!("{:.0} ms", s * 1e3),
        s if s < 120.0 => format!("{s:.1} s"),
        s if s < 7200.0 => format!("{:.1} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}

/// A distance for people.
pub fn of_metres(metres: f64) -> String {
    if metres >= 10_000.0 {
        format!("{:.1} km", metres / 1000.0)
    } else {
        format!("{metres:.1} m")
    }
}

/// The first digits of a digest, as many as a person is shown.
pub fn short_digest(digest: &str) -> String {
    digest.chars().take(12).collect()
}

/// A count with its noun: `1 unit`, `3 units`.
pub fn of(count: u64, noun: &str) -> String {
    if count == 1 {
        format!("1 {noun}")
    } else {
        format!("{count} {noun}s")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn amounts_of_memory() {
        assert_eq!(bytes("1GiB"), Ok(1 << 30));
        assert_eq!(bytes("1.5 gib"), Ok(3 << 29));
        assert_eq!(bytes("2GB"), Ok(2_000_000_000));
        assert_eq!(bytes("2097152"), Ok(1 << 21));
        for wrong in [
            "",
            "GiB",
            "1 parsec",
            "-1GiB",
            "0",
            "12B",
            "1e30",
            "9999999TiB",
            "1..2G",
        ] {
            assert!(bytes(wrong).is_err(), "{wrong}");
        }
        // More than 64 bits have, too.
        for far in ["12B", "2PiB", "16EiB", "1000000EB", "99999999999999999999"] {
            let said = format!("expected 1 MiB to 1 PiB, found {far}");
            assert_eq!(bytes(far), Err(said));
        }
        assert_eq!(bytes("1PiB"), Ok(1 << 50));
    }

    #[test]
    fn amounts_for_people() {
        assert_eq!(
            [0, 1023, 1536, 3 << 30].map(of_bytes),
            ["0 B", "1023 B", "1.5 KiB", "3.0 GiB"]
        );
        assert_eq!(
            [0.25, 12.0, 600.0, 9000.0].map(of_seconds),
            ["250 ms", "12.0 s", "10.0 min", "2.5 h"]
        );
        assert_eq!(
            (of(1, "unit"), of(0, "unit")),
            ("1 unit".to_owned(), "0 units".to_owned())
        );
    }
}
