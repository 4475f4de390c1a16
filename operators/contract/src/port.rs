//! What an operator reads, and how much of it belongs together.

use evermap_schemas::{Layer, LayerRow};
use serde::{Deserialize, Serialize};

/// How much of a table goes with a unit of work.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Reach {
    /// The rows of the session at hand.
    Session,
    /// All rows of its site.
    Site,
}

impl Reach {
    /// The columns whose equal values say what goes together.
    pub(crate) fn columns(self) -> &'static [&'static str] {
        match self {
            Reach::Session => Key::SESSION.columns,
            Reach::Site => Key::SITE.columns,
        }
    }
}

/// What makes a group, and in which order its rows come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Key {
    /// Columns whose values name a group; the first is `site`. With `session` among them work is split by session.
    pub columns: &'static [&'static str],
    /// Columns that order the rows of a group; where there are none, the key of the layer does.
    pub order: &'static [&'static str],
}

impl Key {
    /// One session's rows, by stamp.
    pub const SESSION: Key = Key {
        columns: &["site", "session"],
        order: &["stamp"],
    };
    /// One camera's rows of a session, by stamp.
    pub const CAMERA: Key = Key {
        columns: &["site", "session", "camera"],
        order: &["stamp"],
    };
    /// All rows of a site, in the order of the layer's key.
    pub const SITE: Key = Key {
        columns: &["site"],
        order: &[],
    };

    /// How much of a table holds a group whole.
    pub fn reach(&self) -> Reach {
        if self.columns.contains(&"session") {
            Reach::Session
        } else {
            Reach::Site
        }
    }

    /// The columns that order rows of this layer so that groups lie together, each in its order.
    pub(crate) fn sorting(&self, layer: &Layer) -> Vec<&'static str> {
        let order = if self.order.is_empty() {
            layer.key
        } else {
            self.order
        };
        let mut columns = self.columns.to_vec();
        for column in order {
            if !columns.contains(column) {
                columns.push(column);
            }
        }
        columns
    }
}

/// A named input.
#[derive(Debug, Clone)]
pub struct Port {
    /// Name, as plans write it.
    pub name: &'static str,
    /// The columns that are read, with their types. An input may have more.
    pub layer: Layer,
    /// How much of it goes with a unit of work.
    pub reach: Reach,
    /// The [`evermap_schemas::ImageRef`] column whose images are wanted too: their encoded bytes come in a `Binary` column
    /// beside it, see [`pixels_column`]. An image that cannot be fetched is null there.
    pub pixels: Option<&'static str>,
    /// Whether the rows are fetched one at a time, and need not fit into memory together.
    pub fetched: bool,
    /// Whether a plan may leave the port unconnected; the kernel then sees an empty table.
    pub optional: bool,
    /// Whether there is nothing to do where it has no rows.
    pub needed: bool,
}

impl Port {
    /// A port that reads a session's rows of `T`.
    pub fn session<T: LayerRow>(name: &'static str) -> Self {
        Self::of::<T>(name, Reach::Session)
    }

    /// A port that reads a site's rows of `T`.
    pub fn site<T: LayerRow>(name: &'static str) -> Self {
        Self::of::<T>(name, Reach::Site)
    }

    /// A port that reads so much of a table of `T`.
    pub fn of<T: LayerRow>(name: &'static str, reach: Reach) -> Self {
        Self {
            name,
            layer: T::layer(),
            reach,
            pixels: None,
            fetched: false,
            optional: false,
            needed: false,
        }
    }

    /// The images of this column are wanted, not only where they are.
    #[must_use]
    pub fn pixels(mut self, column: &'static str) -> Self {
        self.pixels = Some(column);
        self
    }

    /// The rows of this side are fetched one at a time, by [`Sides::fetched`](crate::Sides::fetched): for tables that would
    /// fill the memory, of heavy rows. [`Sides::rows`](crate::Sides::rows) gives what else they have than lists, structs and
    /// bytes.
    #[must_use]
    pub fn fetched(mut self) -> Self {
        self.fetched = true;
        self
    }

    /// The port may stay unconnected.
    #[must_use]
    pub fn optional(mut self) -> Self {
        self.optional = true;
        self
    }

    /// Where the side has no rows, there are none to make: driving rows are not even read.
    #[must_use]
    pub fn needed(mut self) -> Self {
        self.needed = true;
        self
    }

    /// The columns that a side's rows are ordered by: what goes together first, then the layer's key.
    pub fn sorting(&self) -> Vec<&'static str> {
        let columns = self.reach.columns();
        Key {
            columns,
            order: &[],
        }
        .sorting(&self.layer)
    }
}

/// The name of the column that holds the images of an [`evermap_schemas::ImageRef`] column.
pub fn pixels_column(column: &str) -> String {
    format!("{column}_pixels")
}
