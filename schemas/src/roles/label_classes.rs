//! What the values of label images mean, from the log's metadata: `{"0": "tree", "1": "sky"}`.

use std::collections::BTreeMap;

use crate::roles::{ReadRows, Role};
use crate::{Fault, Record, record};

record! {
    /// What a value in the label images of a session means: the log's metadata `label_classes`.
    #[layer("label_classes", key(site, session, value))]
    pub struct LabelClass {
        /// Site that the session belongs to.
        site: String,
        /// Session that it holds for.
        session: String,
        /// Pixel value.
        value: u8,
        /// Name of the class.
        class: String,
    }
}

/// Metadata records that name the classes of label images.
pub const ROLE: Role = Role::of_metadata::<LabelClass>("label_classes", read);

/// Characters of a key that is no pixel value that are told.
const MOST_TOLD: usize = 40;

/// Entries whose key is no pixel value are left out, and told.
fn read(site: &str, session: &str, record: &BTreeMap<String, String>) -> Result<ReadRows, Fault> {
    let mut rows = Vec::with_capacity(record.len());
    let mut senseless = Vec::new();
    for (index, (value, class)) in record.iter().enumerate() {
        let Ok(value) = value.trim().parse::<u8>() else {
            let found: String = value.chars().take(MOST_TOLD).collect();
            let expected = "expected pixel values from 0 to 255 in label_classes";
            senseless.push((index, format!("{expected}, found {found:?}")));
            continue;
        };
        rows.push(LabelClass {
            site: site.to_owned(),
            session: session.to_owned(),
            value,
            class: class.clone(),
        });
    }
    let columns = LabelClass::encode_columns(rows)?;
    Ok(ReadRows { columns, senseless })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn names_of_what_is_no_pixel_value_are_told_and_the_others_are_read() {
        let long = "9".repeat(1000);
        let said = ["0", " 255 ", "256", "26000", "-1", "car\n", &long];
        let record = said.map(|value| (value.to_owned(), "a class".to_owned()));
        let read = read("town", "a", &record.into()).unwrap();
        assert_eq!(read.columns[0].len(), 2);
        let told = read.senseless.iter().map(|(_, told)| told.as_str());
        let found = told.map(|told| told.rsplit_once(' ').unwrap().1);
        let found: Vec<&str> = found.collect();
        let nines = format!("{:?}", "9".repeat(MOST_TOLD));
        let expected = ["\"-1\"", "\"256\"", "\"26000\"", &nines, "\"car\\n\""];
        assert_eq!(found, expected);
        let first = "expected pixel values from 0 to 255 in label_classes, found \"-1\"";
        assert_eq!(read.senseless[0].1, first);
    }
}
