//! The records of runs: a Parquet file each, named by the version that it ended at and the digest of the file.

use std::fmt;

use bytes::Bytes;
use evermap_functions::caught;
use evermap_schemas::Fault;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;

use crate::digest::{digest, is_digest};
use crate::map::damage::{Damage, has_end};
use crate::map::rows::RUNS;
use crate::map::store::Store;

/// The name of a record.
pub fn record_name(version: u64, file: &[u8]) -> String {
    format!("{RUNS}/{version:06}-{}.parquet", digest(file))
}

/// The version that the run of a record ended at; `None` where the name is no record's.
pub fn record_version(name: &str) -> Option<u64> {
    let (text, _) = split(name)?;
    let version: u64 = text.parse().ok()?;
    (format!("{version:06}") == text).then_some(version)
}

/// What stands before and behind the hyphen of a name.
fn split(name: &str) -> Option<(&str, &str)> {
    let file = name.strip_prefix(RUNS)?.strip_prefix('/')?;
    file.strip_suffix(".parquet")?.split_once('-')
}

/// The digest in a name; `None` in those that an older evermap gave.
fn digest_in(name: &str) -> Option<&str> {
    let (_, digest) = split(name)?;
    is_digest(digest.as_bytes()).then_some(digest)
}

/// What is wrong with a record.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum RecordDamage {
    /// It is no Parquet file, or not all of one, or does not read.
    Unreadable(&'static str),
    /// It has another content than its name says.
    Changed(Damage),
}

impl fmt::Display for RecordDamage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unreadable(found) => write!(f, "expected a Parquet file, found {found}"),
            Self::Changed(damage) => {
                let found = damage.found.as_deref().unwrap_or("no file");
                write!(f, "expected {}, found {found}", damage.expected)
            }
        }
    }
}

/// What is wrong with the record of this name; reads all of it. What was removed meanwhile is as it should be.
///
/// # Errors
/// A resource fault when the store does not answer.
pub async fn record_damage(store: &Store, name: &str) -> Result<Option<RecordDamage>, Fault> {
    if let Some(found) = store.no_file(name).await? {
        return Ok(Some(RecordDamage::Unreadable(found)));
    }
    let Some(file) = store.read(name).await? else {
        return Ok(None);
    };
    let name = name.to_owned();
    let looked = tokio::task::spawn_blocking(move || damage_of(&name, file)).await;
    looked.map_err(|error| Fault::bug(format!("reading a record ended: {error}")))
}

fn damage_of(name: &str, file: Bytes) -> Option<RecordDamage> {
    if !has_end(&file) {
        return Some(RecordDamage::Unreadable("one that is torn"));
    }
    match digest_in(name) {
        Some(expected) => {
            let found = digest(&file);
            let damage = || Damage {
                file: name.to_owned(),
                expected: format!("the digest {expected}"),
                found: Some(found.clone()),
            };
            (found != expected).then(|| RecordDamage::Changed(damage()))
        }
        None => (!reads(file)).then_some(RecordDamage::Unreadable("one that does not read")),
    }
}

/// Whether all rows of a Parquet file can be read.
fn reads(file: Bytes) -> bool {
    let read = || {
        let rows = ParquetRecordBatchReaderBuilder::try_new(file).ok()?;
        let mut rows = rows.build().ok()?;
        rows.try_for_each(|batch| batch.ok().map(drop))
    };
    // What was flipped may be more than the library expects.
    caught(read).flatten().is_some()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use evermap_schemas::batch;
    use parquet::arrow::ArrowWriter;

    use super::*;
    use crate::map::rows::LayerFile;

    fn parquet() -> Vec<u8> {
        let rows = (0..50).map(|rows| LayerFile {
            layer: format!("layer_{rows}"),
            file: "a.parquet".to_owned(),
            rows,
            bytes: 7 * rows,
        });
        let table = batch(rows.collect::<Vec<_>>()).unwrap();
        let mut file = Vec::new();
        let mut writer = ArrowWriter::try_new(&mut file, table.schema(), None).unwrap();
        writer.write(&table).unwrap();
        writer.close().unwrap();
        file
    }

    #[test]
    fn any_flipped_byte_of_a_record_is_found_by_its_name() {
        let file = parquet();
        let name = record_name(3, &file);
        assert!(name.starts_with("runs/000003-"), "{name}");
        assert_eq!(record_version(&name), Some(3));
        assert_eq!(damage_of(&name, file.clone().into()), None);
        for at in (0..file.len()).step_by(37) {
            let mut flipped = file.clone();
            flipped[at] ^= 0x10;
            assert!(damage_of(&name, flipped.into()).is_some(), "byte {at}");
        }
    }

    #[test]
    fn records_of_an_older_evermap_are_read_whole() {
        let name = "runs/000003-0193e2a4-7c1b-7000-8000-000000000000.parquet";
        let file = parquet();
        assert_eq!(damage_of(name, file.clone().into()), None);
        assert_eq!(record_version(name), Some(3));
        for other in ["runs/3-a.parquet", "runs/mine.parquet", "000003-a.parquet"] {
            assert_eq!(record_version(other), None);
        }
        let torn = damage_of(name, file[..file.len() - 3].to_vec().into());
        assert_eq!(torn, Some(RecordDamage::Unreadable("one that is torn")));
        // Its first page begins behind the mark at its beginning.
        let mut pages = file;
        pages[4..60].fill(0xff);
        let said = damage_of(name, pages.into()).unwrap().to_string();
        assert_eq!(
            said,
            "expected a Parquet file, found one that does not read"
        );
    }
}
