//! DataFusion's errors, and everything else that can go wrong below, as faults with a kind.

use datafusion::error::DataFusionError;
use evermap_schemas::Fault;

/// The fault inside, or the best reading of what DataFusion says. A fault that crossed a process border as text is
/// found again by its code.
pub fn fault_of(error: &DataFusionError) -> Fault {
    let root = error.find_root();
    Fault::parse(&root.to_string()).unwrap_or_else(|| {
        let fault = evermap_datasets::scan::fault_of(root);
        let line = fault.message.lines().next().unwrap_or_default();
        Fault {
            message: line.to_owned(),
            ..fault
        }
    })
}

/// What DataFusion gives, with a fault in place of its error.
pub trait OrFault<T> {
    /// The value, or [`fault_of`] the error.
    ///
    /// # Errors
    /// As said.
    fn or_fault(self) -> Result<T, Fault>;
}

impl<T> OrFault<T> for Result<T, DataFusionError> {
    fn or_fault(self) -> Result<T, Fault> {
        self.map_err(|error| fault_of(&error))
    }
}

/// A fault on its way through DataFusion.
pub fn external(fault: Fault) -> DataFusionError {
    DataFusionError::External(Box::new(fault))
}

/// A fault of an object store: what was asked, and what it said.
pub fn store_fault(error: &object_store::Error, what: &str) -> Fault {
    Fault::resource(format!("{what}: {error}"))
}

/// What another process says has gone wrong: its fault, where the text begins with the code of one.
#[cfg(feature = "cluster")]
pub fn remote_fault(error: &dyn std::fmt::Display, what: &str) -> Fault {
    let text = error.to_string();
    Fault::parse(&text).unwrap_or_else(|| Fault::resource(format!("{what}: {text}")))
}
