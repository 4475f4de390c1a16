//! What is typed, or sent, to standard input: it may have no end.

use std::io::Read;

use evermap_language::LONGEST_TEXT;
use evermap_schemas::Fault;

/// All of standard input, which is `what` ("a plan"), if it is no longer than a plan may be.
///
/// # Errors
/// A user fault for more, and where it cannot be read.
pub fn standard_input(what: &str) -> Result<Vec<u8>, Fault> {
    read(std::io::stdin(), what)
}

fn read(input: impl Read, what: &str) -> Result<Vec<u8>, Fault> {
    let mut bytes = Vec::new();
    let read = input
        .take(LONGEST_TEXT as u64 + 1)
        .read_to_end(&mut bytes)
        .map_err(|error| Fault::user(format!("cannot read {what}: {error}")))?;
    match read > LONGEST_TEXT {
        true => {
            let most = LONGEST_TEXT >> 20;
            let fault = format!("expected {what} of at most {most} MiB, found more");
            Err(Fault::user(fault)
                .at("standard input")
                .next("look what is sent there"))
        }
        false => Ok(bytes),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn what_never_ends_is_read_to_the_limit() {
        let longest = std::io::repeat(b'y').take(LONGEST_TEXT as u64);
        assert_eq!(read(longest, "a plan").unwrap().len(), LONGEST_TEXT);
        let told = read(std::io::repeat(b'y'), "a plan").unwrap_err();
        let expected = "expected a plan of at most 4 MiB, found more (at standard input)";
        assert!(told.to_string().contains(expected), "{told}");
    }
}
