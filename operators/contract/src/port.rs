//! What an operator reads, and how much of it at once.

use evermap_schemas::{Layer, LayerRow};

/// How much of a port a kernel must see at once. It says *where data must be*, not what is computed; the engine
/// turns it into partitioning and order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Grain {
    /// Any rows, in any split.
    Row,
    /// All rows with equal values in `columns`, together, ordered by `order`.
    Key {
        /// Columns whose values name a group. With `session` among them the work is split by session.
        columns: &'static [&'static str],
        /// Columns that order the rows of a group.
        order: &'static [&'static str],
    },
    /// All rows of one site, in the order of the layer's key.
    Whole,
}

impl Grain {
    /// One session's rows ordered by stamp: the most common grain.
    pub const SESSION: Grain = Grain::Key {
        columns: &["site", "session"],
        order: &["stamp"],
    };

    /// Whether rows of one session are enough for the kernel.
    pub fn is_per_session(&self) -> bool {
        match self {
            Grain::Row => true,
            Grain::Key { columns, .. } => columns.contains(&"session"),
            Grain::Whole => false,
        }
    }

    /// The columns whose equal values make a group: none for `Row`, the site for `Whole`.
    pub fn group_columns(&self) -> &'static [&'static str] {
        match self {
            Grain::Row => &[],
            Grain::Key { columns, .. } => columns,
            Grain::Whole => &["site"],
        }
    }
}

/// A named input.
#[derive(Debug, Clone)]
pub struct Port {
    /// Name, as plans write it.
    pub name: &'static str,
    /// The columns that are read, with their types. An input may have more.
    pub layer: Layer,
    /// How much of it the kernel sees at once.
    pub grain: Grain,
    /// The [`evermap_schemas::ImageRef`] column that the engine replaces by encoded image bytes, if any.
    pub pixels: Option<&'static str>,
    /// Whether a plan may leave the port unconnected; the kernel then sees an empty table.
    pub optional: bool,
}

impl Port {
    /// A port that reads the rows of `T`.
    pub fn of<T: LayerRow>(name: &'static str, grain: Grain) -> Self {
        Self {
            name,
            layer: T::layer(),
            grain,
            pixels: None,
            optional: false,
        }
    }

    /// The rows carry images by reference in `column`; the kernel wants their bytes, in a `Binary` column of the same
    /// name. An image that cannot be fetched is null.
    #[must_use]
    pub fn with_pixels(mut self, column: &'static str) -> Self {
        self.pixels = Some(column);
        self
    }

    /// The columns that order the port's rows before a kernel sees them.
    pub fn order(&self) -> Vec<&'static str> {
        match &self.grain {
            Grain::Row => Vec::new(),
            Grain::Key { columns, order } => columns.iter().chain(*order).copied().collect(),
            Grain::Whole => self.layer.key.to_vec(),
        }
    }

    /// The port may stay unconnected.
    #[must_use]
    pub fn optional(mut self) -> Self {
        self.optional = true;
        self
    }
}
