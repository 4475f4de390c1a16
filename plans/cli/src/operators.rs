//! The operators of this program: those of the catalog, and those of a program that links this crate.

use std::sync::OnceLock;

use evermap_contract::{Entry, Registry};
use evermap_schemas::Fault;

static OPERATORS: OnceLock<Registry> = OnceLock::new();

/// Every operator there is.
pub fn registry() -> Registry {
    OPERATORS.get_or_init(evermap_catalog::registry).clone()
}

/// Puts operators beside those of the catalog. Once, and before anything asks for them.
///
/// # Errors
/// A user fault for a name that the catalog has; a bug fault when it is too late.
pub(crate) fn join(own: impl IntoIterator<Item = Entry>) -> Result<(), Fault> {
    let catalog = evermap_catalog::registry();
    let own: Vec<Entry> = own.into_iter().collect();
    if let Some(twice) = own.iter().find(|entry| catalog.get(entry.name).is_ok()) {
        let name = twice.name;
        let fault = Fault::user(format!("the catalog has an operator {name} already"));
        return Err(fault.next("give yours another name"));
    }
    let all = Registry::new(catalog.entries().cloned().chain(own));
    let late = |_| Fault::bug("operators are added after some were asked for");
    OPERATORS.set(all).map_err(late)
}
