//! Regular expressions that are none, which are shown in several lines with a mark below.

/// Why a regular expression of a query is none, in one line.
pub fn no_expression(message: &str) -> Option<String> {
    if message.contains("Compiled regex exceeds size limit") {
        return Some(
            "expected a smaller regular expression, found one too large to compile".to_owned(),
        );
    }
    let (_, behind) = message.split_once("regex parse error:")?;
    let mut lines = behind.lines().map(str::trim);
    let pattern = lines.find(|line| !line.is_empty())?;
    let why = lines.find_map(|line| line.strip_prefix("error: "))?;
    Some(match pattern.chars().all(|letter| letter == '~') {
        // One of several lines is framed.
        true => format!("expected a regular expression, found another text: {why}"),
        false => format!("expected a regular expression, found '{pattern}': {why}"),
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn what_is_wrong_with_a_regular_expression_is_said_in_one_line() {
        for (message, expected) in [
            (
                "External error: regex parse error:\n    a(b\n     ^\nerror: unclosed group",
                "expected a regular expression, found 'a(b': unclosed group",
            ),
            (
                "Execution error: Regular expression did not compile: Syntax(\n~~~~~~~~\nregex parse error:\n    [\n    ^\nerror: unclosed character class\n~~~~~~~~\n)",
                "expected a regular expression, found '[': unclosed character class",
            ),
            (
                "regex parse error:\n~~~~~~~~\n1: a\n2: (\n   ^\n~~~~~~~~\nerror: unclosed group",
                "expected a regular expression, found another text: unclosed group",
            ),
            (
                "External error: Compiled regex exceeds size limit of 10485760 bytes.",
                "expected a smaller regular expression, found one too large to compile",
            ),
        ] {
            assert_eq!(no_expression(message).unwrap(), expected);
        }
        assert_eq!(no_expression("Execution error: another"), None);
    }
}
