//! What is not there, and what may be meant.

use evermap_language::nearest;

/// The table that DataFusion did not find.
pub fn missing_table(message: &str) -> Option<&str> {
    let (_, behind) = message.split_once("table '")?;
    let (name, _) = behind.split_once("' not found")?;
    Some(name)
}

/// What may be meant by the name of a table that there is not: a misspelt one, in whichever schema, or one of another
/// version.
pub fn meant(table: &str, names: &[String]) -> Option<String> {
    let near = |name: &str| {
        let known = names.iter().map(String::as_str);
        known
            .clone()
            .find(|known| *known == name)
            .or_else(|| nearest(name, known))
    };
    if let Some((name, version)) = table.split_once('@') {
        return Some(format!("v{}.{}", version.parse::<u64>().ok()?, near(name)?));
    }
    match table.rsplit_once('.') {
        Some((schema, name)) => Some(format!("{schema}.{}", near(name)?)),
        None => near(table).map(str::to_owned),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_meant_may_be_of_another_version() {
        let names = ["lanes".to_owned(), "poses".to_owned()];
        let cases = [
            ("lanse", Some("lanes")),
            ("lanes@1", Some("v1.lanes")),
            ("pose@x", None),
            ("v2.posess", Some("v2.poses")),
            ("trees", None),
        ];
        for (table, expected) in cases {
            assert_eq!(meant(table, &names).as_deref(), expected, "{table}");
        }
    }
}
