//! The list of operators, without their types.

use std::collections::BTreeMap;
use std::sync::Arc;

use evermap_schemas::{Fault, Layer, LayerRow};
use serde_json::Value;

use crate::kernel::Kernel;
use crate::params::{self, ParamFault, Parameter};
use crate::{Operator, Page, Port, Shape};

/// One operator, as the engine and the reference see it.
#[derive(Clone)]
pub struct Entry {
    /// The operator's name.
    pub name: &'static str,
    /// The operator's version.
    pub version: u32,
    /// The page beside the operator.
    pub page: Page,
    /// How much the kernel must see at once.
    pub shape: Shape,
    /// Inputs; the first drives.
    pub ports: Vec<Port>,
    /// The layer that it yields.
    pub output: Layer,
    /// Default parameters, as a JSON object.
    pub defaults: Value,
    /// JSON Schema of the parameters.
    pub params_schema: Value,
    typed: fn(&Value, &Value) -> Result<Typed, Vec<ParamFault>>,
}

/// Parameters that were understood.
struct Typed {
    normal: Value,
    kernel: Box<dyn FnOnce() -> Kernel>,
}

fn typed<O: Operator>(schema: &Value, given: &Value) -> Result<Typed, Vec<ParamFault>> {
    let params = params::typed::<O::Params>(schema, given)?;
    O::check(&params).map_err(|fault| vec![ParamFault::checked(fault)])?;
    Ok(Typed {
        normal: serde_json::to_value(&params).unwrap_or_default(),
        kernel: Box::new(|| (O::work().kernel)(params)),
    })
}

impl Entry {
    /// The entry of an operator.
    pub fn of<O: Operator>() -> Self {
        let work = O::work();
        Self {
            name: O::NAME,
            version: O::VERSION,
            page: Page(O::PAGE),
            shape: work.shape,
            ports: work.ports,
            output: O::Output::layer(),
            defaults: serde_json::to_value(O::Params::default()).unwrap_or_default(),
            params_schema: schemars::schema_for!(O::Params).to_value(),
            typed: typed::<O>,
        }
    }

    /// The parameters, in the order of their declaration.
    pub fn parameters(&self) -> Vec<Parameter> {
        params::declared(&self.params_schema, &self.defaults)
    }

    /// All that is wrong with parameters as a plan gives them.
    pub fn faults(&self, given: &Value) -> Vec<ParamFault> {
        let typed = (self.typed)(&self.params_schema, given);
        typed.err().unwrap_or_default()
    }

    /// The complete parameters, in declaration order: equal work has equal text.
    ///
    /// # Errors
    /// A user fault with all that [`Entry::faults`] finds.
    pub fn normalise(&self, given: &Value) -> Result<Value, Fault> {
        Ok(self.understood(given)?.normal)
    }

    /// The kernel for parameters as a plan gives them; what it leaves out has its default.
    pub(crate) fn kernel(&self, given: &Value) -> Result<Kernel, Fault> {
        Ok((self.understood(given)?.kernel)())
    }

    fn understood(&self, given: &Value) -> Result<Typed, Fault> {
        let typed = (self.typed)(&self.params_schema, given);
        typed.map_err(|faults| params::fault(self.name, faults))
    }

    /// A port by name.
    pub fn port(&self, name: &str) -> Option<&Port> {
        self.ports.iter().find(|port| port.name == name)
    }
}

/// Operators by name. Clones share one list.
#[derive(Clone, Default)]
pub struct Registry(Arc<BTreeMap<&'static str, Entry>>);

impl Registry {
    /// A registry of these entries; the later of two with one name stays.
    pub fn new(entries: impl IntoIterator<Item = Entry>) -> Self {
        let named = entries.into_iter().map(|entry| (entry.name, entry));
        Self(Arc::new(named.collect()))
    }

    /// An operator by name.
    ///
    /// # Errors
    /// A user fault that lists the names there are.
    pub fn get(&self, name: &str) -> Result<&Entry, Fault> {
        self.0.get(name).ok_or_else(|| {
            let known: Vec<_> = self.0.keys().copied().collect();
            Fault::user(format!(
                "no operator {name}; there are {}",
                known.join(", ")
            ))
        })
    }

    /// All operators, sorted by name.
    pub fn entries(&self) -> impl Iterator<Item = &Entry> {
        self.0.values()
    }
}
