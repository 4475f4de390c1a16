//! The trait that an operator implements.

use evermap_schemas::{Fault, LayerRow};
use schemars::JsonSchema;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::Work;

/// An operator: parameters, one output layer, and its work. Implemented by an empty struct, in a file of its own, with
/// its page beside it.
pub trait Operator: 'static {
    /// A noun for what it yields; also the file's name.
    const NAME: &'static str;
    /// Raised when the same input gives another output: artifacts of older versions are then computed anew.
    const VERSION: u32;
    /// The page beside the file: `include_str!("name.md")`.
    const PAGE: &'static str;
    /// Parameters; every one has a default, a unit in its name, a doc comment, and a range where one makes sense.
    /// [`NothingToChoose`] where there are none.
    type Params: Default + Clone + Serialize + DeserializeOwned + JsonSchema + Send + Sync + 'static;
    /// The row of the output layer.
    type Output: LayerRow;

    /// What is read, in which shape, and what is done with it.
    fn work() -> Work<Self::Params>;

    /// Whether the parameters make sense together. Each by itself has been held to its type and range.
    ///
    /// # Errors
    /// A user fault where they do not; one that is of a single parameter has its name as its place, one of an entry of its
    /// value `NAME.ENTRY`.
    fn check(_: &Self::Params) -> Result<(), Fault> {
        Ok(())
    }
}

/// There is nothing to choose.
#[derive(Debug, Clone, Default, Serialize, Deserialize, JsonSchema)]
pub struct NothingToChoose {}
