//! Rows of a side that are fetched one at a time: in memory as long as there is some, else in a temporary file.
//!
//! When no more of them fits, all that are there go to the file, and those that follow go behind them. Where rows are makes
//! no difference to what they are.

use std::fmt;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;
use std::sync::{Arc, Mutex};

use arrow::array::RecordBatch;
use arrow::error::ArrowError;
use arrow::ipc::reader::FileReader;
use arrow::ipc::writer::FileWriter;
use datafusion::common::utils::memory::get_record_batch_memory_size;
use datafusion::execution::memory_pool::{MemoryLimit, MemoryReservation};
use datafusion::execution::runtime_env::RuntimeEnv;
use datafusion::execution::{DiskManager, SpillFile, SpillWriter};
use evermap_contract::{InMemory, RowStore, catalogue};
use evermap_schemas::Fault;

use crate::error::OrFault;
use crate::locked::locked;

/// A row store holds one in so many bytes of the memory at most: those who make the rows need memory at the same time.
const SHARE: usize = 4;

/// Puts rows in a row store, batch by batch.
pub struct RowWriter<'a> {
    memory: &'a MemoryReservation,
    runtime: &'a RuntimeEnv,
    /// Bytes of rows in memory, at most.
    most_bytes: usize,
    catalogue: Vec<RecordBatch>,
    rows: u64,
    /// What is in memory as long as there is no file.
    held: Vec<RecordBatch>,
    held_bytes: usize,
    file: Option<Filing>,
}

/// Rows that were put in a row store.
pub struct Filled {
    /// What is held of them in memory, wherever they are.
    pub catalogue: Vec<RecordBatch>,
    /// The rows.
    pub store: Arc<dyn RowStore>,
    /// Bytes of the file that they are in; 0 where they are in memory.
    pub file_bytes: u64,
}

impl<'a> RowWriter<'a> {
    /// A row store without rows yet. What is in memory is reserved in `memory`, of the pool of `runtime`.
    pub fn new(memory: &'a MemoryReservation, runtime: &'a RuntimeEnv) -> Self {
        let most_bytes = match runtime.memory_pool.memory_limit() {
            MemoryLimit::Finite(bytes) => bytes / SHARE,
            MemoryLimit::Infinite | MemoryLimit::Unknown => usize::MAX,
        };
        Self {
            memory,
            runtime,
            most_bytes,
            catalogue: Vec::new(),
            rows: 0,
            held: Vec::new(),
            held_bytes: 0,
            file: None,
        }
    }

    /// Puts rows behind those that are there.
    ///
    /// # Errors
    /// A resource fault where there is no memory for their catalogue, or no room for the file.
    pub fn push(&mut self, rows: RecordBatch) -> Result<(), Fault> {
        let listed = catalogue(&rows, self.rows)?;
        let listed_bytes = get_record_batch_memory_size(&listed);
        let bytes = get_record_batch_memory_size(&rows);
        self.rows += rows.num_rows() as u64;
        let fit = self.file.is_none() && self.held_bytes + bytes <= self.most_bytes;
        if fit && self.memory.try_grow(listed_bytes + bytes).is_ok() {
            self.held.push(rows);
            self.held_bytes += bytes;
        } else {
            let mut file = match self.file.take() {
                Some(file) => file,
                None => self.begun(&rows)?,
            };
            file.write(&rows)?;
            self.file = Some(file);
            self.memory.try_grow(listed_bytes).or_fault()?;
        }
        self.catalogue.push(listed);
        Ok(())
    }

    /// A file for rows like these, with those that were held in memory until now.
    fn begun(&mut self, like: &RecordBatch) -> Result<Filing, Fault> {
        let mut file = Filing::begin(&self.runtime.disk_manager, like)?;
        for rows in self.held.drain(..) {
            file.write(&rows)?;
        }
        self.memory.shrink(std::mem::take(&mut self.held_bytes));
        Ok(file)
    }

    /// There are no more rows.
    ///
    /// # Errors
    /// A resource fault where the file has no room, or cannot be opened.
    pub fn finish(self) -> Result<Filled, Fault> {
        let mut file_bytes = 0;
        let store: Arc<dyn RowStore> = match self.file {
            Some(file) => {
                let filed = file.finish()?;
                file_bytes = filed.file.size().unwrap_or_default();
                Arc::new(filed)
            }
            None => Arc::new(InMemory::new(self.held)),
        };
        Ok(Filled {
            catalogue: self.catalogue,
            store,
            file_bytes,
        })
    }
}

/// A temporary file of rows that is written, each row as a batch of its own.
struct Filing {
    file: Arc<dyn SpillFile>,
    writer: FileWriter<BufWriter<Box<dyn SpillWriter>>>,
}

impl Filing {
    fn begin(disk: &Arc<DiskManager>, like: &RecordBatch) -> Result<Self, Fault> {
        let file = disk.create_tmp_file("putting rows of a side aside");
        let file = file.or_fault()?;
        let opened = file.open_writer().or_fault()?;
        let writer = FileWriter::try_new_buffered(opened, &like.schema());
        Ok(Self {
            writer: writer.map_err(|error| no_room(file.path(), &error))?,
            file,
        })
    }

    fn write(&mut self, rows: &RecordBatch) -> Result<(), Fault> {
        let mut each = (0..rows.num_rows()).map(|row| rows.slice(row, 1));
        let written = each.try_for_each(|row| self.writer.write(&row));
        written.map_err(|error| no_room(self.file.path(), &error))
    }

    fn finish(mut self) -> Result<Filed, Fault> {
        let finished = self.writer.finish();
        finished.map_err(|error| no_room(self.file.path(), &error))?;
        let missing = || Fault::bug("a temporary file has no path");
        let opened = File::open(self.file.path().ok_or_else(missing)?);
        let reader = opened
            .map_err(ArrowError::from)
            .and_then(|file| FileReader::try_new(file, None));
        Ok(Filed {
            reader: Mutex::new(reader.map_err(|error| unreadable(&error))?),
            file: self.file,
        })
    }
}

/// A row store in a temporary file, which goes with it.
struct Filed {
    reader: Mutex<FileReader<File>>,
    file: Arc<dyn SpillFile>,
}

impl fmt::Debug for Filed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Filed({:?})", self.file.path())
    }
}

impl RowStore for Filed {
    fn row(&self, number: u64) -> Result<RecordBatch, Fault> {
        let mut reader = locked(&self.reader);
        let found = reader.set_index(usize::try_from(number).unwrap_or(usize::MAX));
        found.map_err(|error| Fault::bug(error.to_string()))?;
        let missing = || Fault::bug(format!("there is no row {number} in a temporary file"));
        let row = reader.next().ok_or_else(missing)?;
        row.map_err(|error| unreadable(&error))
    }
}

fn no_room(file: Option<&Path>, error: &ArrowError) -> Fault {
    let folder = file.and_then(Path::parent).unwrap_or(Path::new("."));
    let folder = folder.display();
    Fault::resource(format!(
        "cannot write rows to a temporary file in {folder}: {error}"
    ))
    .next("make room there, set TMPDIR to a folder that has it, or give more memory with --memory")
}

fn unreadable(error: &ArrowError) -> Fault {
    Fault::resource(format!("cannot read rows from a temporary file: {error}"))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use datafusion::execution::memory_pool::MemoryConsumer;
    use evermap_schemas::layers::Features;
    use evermap_schemas::{Bytes, Kind, Stamp, batch, rows};

    use super::*;
    use crate::sql::{Limits, runtime};
    use crate::temporary::counted;

    /// An image with as many features as its number says, and some.
    fn image(number: i64) -> Features {
        let count = 100 + number as usize % 7;
        let places = |off: f32| (0..count).map(|at| at as f32 + off).collect();
        Features {
            site: "s".to_owned(),
            session: "a".to_owned(),
            stamp: Stamp(number),
            keyframe: number as u32,
            camera: "front".to_owned(),
            width: 400,
            height: 300,
            u: places(number as f32),
            v: places(0.5),
            size_px: places(1.0),
            descriptors: Bytes(vec![number as u8; 64 * count]),
        }
    }

    /// Forty images in batches of four, 30 kB each.
    fn images() -> Vec<RecordBatch> {
        let batches = (0..10).map(|first| {
            let images = (4 * first..4 * first + 4).map(image);
            batch(images.collect()).unwrap()
        });
        batches.collect()
    }

    fn limits(memory_bytes: usize) -> Limits {
        Limits {
            memory_bytes,
            partitions: 1,
        }
    }

    #[test]
    fn rows_are_the_same_in_memory_and_in_a_file_that_goes_with_them() {
        // Of the least, not even a batch fits beside what is left to others.
        for (memory_bytes, in_file) in [(1 << 30, false), (150_000, true), (40_000, true)] {
            let runtime = counted(&runtime(limits(memory_bytes)).unwrap());
            let memory = MemoryConsumer::new("a test").register(&runtime.memory_pool);
            let mut writer = RowWriter::new(&memory, &runtime);
            for batch in images() {
                writer.push(batch).unwrap();
            }
            let Filled {
                catalogue,
                store,
                file_bytes,
            } = writer.finish().unwrap();
            assert_eq!(file_bytes > 0, in_file, "{memory_bytes}");
            let listed = catalogue.iter().map(RecordBatch::num_rows);
            assert_eq!(listed.sum::<usize>(), 40);
            // In whatever order they are asked for.
            for number in (0..40).map(|at| at * 17 % 40) {
                let row = store.row(number).unwrap();
                assert_eq!(rows::<Features>(&row).unwrap(), [image(number as i64)]);
            }
            store.row(40).unwrap_err();
            assert_eq!(memory.size() > 200_000, !in_file, "{} B", memory.size());
            assert_eq!(runtime.disk_manager.used_disk_space(), file_bytes);
            drop(store);
            assert_eq!(runtime.disk_manager.used_disk_space(), 0);
        }
    }

    #[test]
    fn a_catalogue_that_finds_no_memory_is_a_fault_of_resources() {
        let runtime = runtime(limits(1)).unwrap();
        let memory = MemoryConsumer::new("a test").register(&runtime.memory_pool);
        let mut writer = RowWriter::new(&memory, &runtime);
        let fault = writer.push(images().remove(0)).unwrap_err();
        assert_eq!(fault.kind, Kind::Resource, "{fault}");
    }
}
