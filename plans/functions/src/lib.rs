//! SQL functions on map layers and logs.
//!
//! | module | functions |
//! |---|---|
//! | `poses` | of poses: `yaw`, `pitch`, `roll`, `transform`, `compose`, `inverse` … |
//! | `geometries` | of geometries: `st_*` as PostGIS names them, `distance_along` |
//! | `earth` | `geodetic`: where on earth a point of a map is |
//! | `json` | `to_json` |
//! | `binary` | `octet_length` |
//! | `date_part` | `date_part`, which is `extract` too |
//! | `contains`, `related` | of the graphs of views |
//!
//! Each is declared once, with its arguments, its result and an example: [`documented`] lists them.
//!
//! With [`use_indexes`], `contains` and `related` on `views` are answered by the layers `class_index` and
//! `relation_index`, and graphs are not read.

mod binary;
mod contains;
mod date_part;
mod earth;
mod function;
mod geometries;
mod graphs;
mod guard;
mod index;
mod json;
mod poses;
mod related;
#[cfg(test)]
mod tests;

use datafusion::logical_expr::{Documentation, ScalarUDF};
use datafusion::prelude::SessionContext;

use crate::function::Function;

pub use date_part::extracts;
pub use guard::{caught, keep_guarded_panics_quiet};
pub use index::{asks_graphs, use_indexes};
pub use json::{json_texts, to_json};

/// Adds the functions to a context.
pub fn register(context: &SessionContext) {
    for function in functions() {
        context.register_udf(function);
    }
}

/// Functions on geometries.
fn of_geometries() -> impl Iterator<Item = &'static function::Declaration> {
    geometries::DECLARATIONS
        .iter()
        .chain(&geometries::made::DECLARATIONS)
        .chain(&geometries::parts::DECLARATIONS)
}

/// Whether what the function of this name gives is a geometry.
pub fn makes_geometry(name: &str) -> bool {
    of_geometries().any(|declared| declared.name == name && (declared.result)().is_binary())
}

fn functions() -> Vec<ScalarUDF> {
    let declared = poses::DECLARATIONS.iter().chain(of_geometries());
    let declared = declared
        .chain(&json::DECLARATIONS)
        .chain(&binary::DECLARATIONS)
        .chain(&earth::DECLARATIONS);
    let declared = declared.map(|declared| ScalarUDF::from(Function::new(declared)));
    let others = [
        ScalarUDF::from(contains::Contains::default()),
        ScalarUDF::from(related::Related::default()),
        ScalarUDF::from(date_part::DatePart::default()),
    ];
    declared.chain(others).collect()
}

/// What each function is, by name.
pub fn documented() -> Vec<Documentation> {
    let functions = functions().into_iter();
    let documented = functions.filter_map(|function| function.documentation().cloned());
    documented.collect()
}
