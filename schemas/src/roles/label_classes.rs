//! What the values of label images mean, from the log's metadata: `{"0": "tree", "1": "sky"}`.

use std::collections::BTreeMap;

use arrow::array::ArrayRef;

use crate::roles::Role;
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

/// Entries whose key is no pixel value are left out.
fn read(
    site: &str,
    session: &str,
    record: &BTreeMap<String, String>,
) -> Result<Vec<ArrayRef>, Fault> {
    let row = |(value, class): (&String, &String)| {
        Some(LabelClass {
            site: site.to_owned(),
            session: session.to_owned(),
            value: value.trim().parse().ok()?,
            class: class.clone(),
        })
    };
    LabelClass::encode_columns(record.iter().filter_map(row).collect())
}
