//! The trait that an operator implements.

use evermap_schemas::{Fault, LayerRow};
use schemars::JsonSchema;
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::{Kernel, Port};

/// An operator: parameters, ports, one output layer, a kernel. Implemented by an empty struct, in a file of its own,
/// with its page beside it.
pub trait Operator: 'static {
    /// A noun for what it yields; also the file's name.
    const NAME: &'static str;
    /// Raised when the same input gives another output: artifacts of older versions are then computed anew.
    const VERSION: u32;
    /// The page beside the file: `include_str!("name.md")`.
    const PAGE: &'static str;
    /// Parameters; every one has a default, a unit in its name, and a doc comment.
    type Params: Default + Serialize + DeserializeOwned + JsonSchema;
    /// The row of the output layer.
    type Output: LayerRow;

    /// The inputs; the first drives the kernel.
    fn ports() -> Vec<Port>;

    /// The kernel for these parameters.
    ///
    /// # Errors
    /// A user fault for parameters that make no sense together.
    fn kernel(params: Self::Params) -> Result<Kernel, Fault>;
}
