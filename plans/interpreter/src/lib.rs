//! Functions written in Python, run by an interpreter of the user's own.
//!
//! ```text
//!  Function ─► idle workers ─► Worker: python3 -c worker.py
//!     call        │  take         │ stdin   header, tables as Arrow streams
//!                 ◄── put back ───┘ stdout  header, rows as one Arrow stream
//! ```
//! An interpreter is a process of its own: what it links, leaks or crashes stays there. It is started when a function is
//! first checked or called, loads the function once, and waits for more calls until this process ends.
//!
//! What a function makes depends on its code, on what it is given, and on what is installed where it runs: its
//! [`Environment`]. All three are part of the recipe of the rows that come out.

mod pool;
mod worker;

use std::collections::BTreeMap;

use arrow::array::RecordBatch;
use arrow::datatypes::SchemaRef;
use evermap_schemas::Fault;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

/// Names the interpreter; `python3` of the path where it is not set, which is that of the active environment.
pub const INTERPRETER: &str = "EVERMAP_PYTHON";

/// A function with all that decides what it does, but where it runs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Function {
    /// The file that its code was read from, as messages name it.
    pub file: String,
    /// Its name.
    pub function: String,
    /// All of the file.
    pub code: String,
    /// The tables that it takes, by the names of its arguments.
    pub ports: Vec<String>,
    /// Its other arguments.
    pub params: Map<String, Value>,
}

/// Digest of the interpreter's version and of all packages that are installed there.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Environment(pub String);

/// A table: its columns, and batches of them.
#[derive(Debug, Clone)]
pub struct Table {
    /// The columns.
    pub schema: SchemaRef,
    /// The rows.
    pub batches: Vec<RecordBatch>,
}

/// What a call gave.
#[derive(Debug, Clone)]
pub struct CallResult {
    /// The rows, with the columns and types that the function gave them.
    pub rows: Table,
    /// What the function says that it left out, by reason.
    pub skipped: BTreeMap<String, u64>,
}

impl Function {
    /// Loads the function, and says where it would run.
    ///
    /// # Errors
    /// A user fault for code that does not load, for a function that is not there or takes other arguments; a resource
    /// fault for an interpreter that does not start.
    pub fn check(&self) -> Result<Environment, Fault> {
        let worker = pool::take(self)?;
        let environment = worker.environment.clone();
        pool::put_back(worker);
        Ok(environment)
    }

    /// Calls the function on tables, one for each of its ports, where the environment is the one that was checked.
    ///
    /// # Errors
    /// A user fault for another environment, for what the function raises, and for what is no table.
    pub fn call(&self, environment: &Environment, tables: &[Table]) -> Result<CallResult, Fault> {
        let mut worker = pool::take(self)?;
        if worker.environment != *environment {
            return Err(Fault::user(format!(
                "expected the Python environment {environment} of the machine that planned this run, found {}",
                worker.environment
            ))
            .next("install the same packages and the same Python on all machines"));
        }
        let made = worker.call(self, tables)?;
        pool::put_back(worker);
        Ok(made)
    }

    /// What a person calls it.
    pub fn label(&self) -> String {
        format!("{}:{}", self.file, self.function)
    }

    fn digest(&self) -> Result<blake3::Hash, Fault> {
        let text = serde_json::to_vec(self)
            .map_err(|error| Fault::bug(format!("a function does not serialise: {error}")))?;
        Ok(blake3::hash(&text))
    }
}

impl std::fmt::Display for Environment {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.0.get(..12).unwrap_or(&self.0))
    }
}

#[cfg(test)]
mod tests;
