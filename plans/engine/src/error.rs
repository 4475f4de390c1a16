//! DataFusion's errors, and everything else that can go wrong below, as faults with a kind.

use datafusion::error::DataFusionError;
use evermap_schemas::{Fault, Kind};

/// The fault inside, or the best reading of what DataFusion says. A fault that crossed a process border as text is
/// found again by its code.
pub fn fault_of(error: &DataFusionError) -> Fault {
    let root = error.find_root();
    if let DataFusionError::External(inner) = root
        && let Some(fault) = inner.downcast_ref::<Fault>()
    {
        return fault.clone();
    }
    let text = root.to_string();
    if let Some(fault) = Fault::parse(&text) {
        return fault;
    }
    let kind = match root {
        DataFusionError::SQL(..) | DataFusionError::Plan(_) | DataFusionError::SchemaError(..) => {
            Kind::User
        }
        DataFusionError::ResourcesExhausted(_)
        | DataFusionError::IoError(_)
        | DataFusionError::ObjectStore(_) => Kind::Resource,
        DataFusionError::Internal(_) => Kind::Bug,
        _ => Kind::Data,
    };
    Fault::new(kind, text.lines().next().unwrap_or_default())
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
