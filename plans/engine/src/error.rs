//! What can go wrong below, as faults with a kind.

use evermap_datasets::fault::with_credentials;
use evermap_schemas::Fault;

pub use evermap_datasets::fault::{OrFault, external, fault_of, place_in_query};

/// A fault of an object store: what was asked, and what it said.
pub fn store_fault(error: &object_store::Error, what: &str) -> Fault {
    with_credentials(Fault::resource(format!("{what}: {error}")))
}

/// What a fault says, whoever must act.
pub fn without_kind(fault: &Fault) -> String {
    let text = fault.to_string();
    let kind = format!("{}: ", fault.kind.code());
    text.strip_prefix(&kind).unwrap_or(&text).to_owned()
}

/// That no map is at an address.
pub fn no_map(address: &str) -> Fault {
    Fault::user(format!("no map at {address}"))
        .next("make one with `evermap run PLAN --map DIR --sessions FILES`")
}

/// What another process says has gone wrong: its fault, where the text begins with the code of one.
#[cfg(feature = "cluster")]
pub fn remote_fault(error: &dyn std::fmt::Display, what: &str) -> Fault {
    let text = error.to_string();
    Fault::parse(&text).unwrap_or_else(|| Fault::resource(format!("{what}: {text}")))
}
