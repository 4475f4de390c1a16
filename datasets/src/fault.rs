//! DataFusion's errors as faults with a kind, and faults on their way through DataFusion.

use arrow::error::ArrowError;
use datafusion::error::DataFusionError;
use evermap_schemas::{Fault, Kind};

/// The fault inside, or the best reading of what DataFusion says. A fault that crossed a process border as text is
/// found again by its code.
pub fn fault_of(error: &DataFusionError) -> Fault {
    let mut cause: Option<&dyn std::error::Error> = Some(error);
    while let Some(error) = cause {
        if let Some(fault) = error.downcast_ref::<Fault>() {
            return fault.clone();
        }
        cause = error.source();
    }
    let root = error.find_root();
    if let Some(fault) = Fault::parse(&root.to_string()) {
        return fault;
    }
    let (kind, message) = match root {
        DataFusionError::ResourcesExhausted(message) => (Kind::Resource, message.clone()),
        DataFusionError::ObjectStore(error) => (Kind::Resource, error.to_string()),
        DataFusionError::IoError(error) => (Kind::Resource, error.to_string()),
        DataFusionError::Internal(message) => (Kind::Bug, message.clone()),
        DataFusionError::Plan(message) => (Kind::User, message.clone()),
        DataFusionError::SchemaError(error, _) => (Kind::User, error.to_string()),
        DataFusionError::SQL(..) => (Kind::User, root.strip_backtrace()),
        DataFusionError::ArrowError(error, _) => (kind_of(error), error.to_string()),
        _ => (Kind::Data, root.strip_backtrace()),
    };
    Fault::new(kind, message.lines().next().unwrap_or_default())
}

/// Whose fault it is when computing with values fails: a query says what is computed.
fn kind_of(error: &ArrowError) -> Kind {
    match error {
        ArrowError::DivideByZero | ArrowError::ArithmeticOverflow(_) | ArrowError::CastError(_) => {
            Kind::User
        }
        _ => Kind::Data,
    }
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

/// A fault inside DataFusion; [`fault_of`] takes it out again.
pub fn external(fault: Fault) -> DataFusionError {
    DataFusionError::External(Box::new(fault))
}
