//! Who has written a log.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use mcap::MAGIC;
use mcap::read::LinearReader;
use mcap::records::Record;

/// Bytes in which a log has named its writer.
const HEAD: u64 = 64 << 10;

/// Who has written the log at a path, as it says itself; `None` where there is no log that can be read.
pub fn recorder_of(path: &Path) -> Option<String> {
    // Who opens a pipe may wait for ever.
    if !path.metadata().ok()?.is_file() {
        return None;
    }
    let mut head = Vec::new();
    let mut file = File::open(path).ok()?.take(HEAD);
    file.read_to_end(&mut head).ok()?;
    let records = head.strip_prefix(MAGIC)?;
    let library = match LinearReader::sans_magic(records).next() {
        Some(Ok(Record::Header(header))) => header.library,
        _ => String::new(),
    };
    Some(match library.trim() {
        "" => "an unknown program".to_owned(),
        library => library.to_owned(),
    })
}
