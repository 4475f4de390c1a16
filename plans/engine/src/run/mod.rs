//! A run: the units of a program in dependency order, what exists skipped, a version published at the end.
//!
//! A unit's recipe names the *contents* of what it reads, so it is known only when those units are done; then a
//! receipt under the recipe's digest means that the work was done before, by this run, an earlier one, or one that
//! was killed. An unchanged result has an unchanged digest and stops everything downstream.

pub mod done;
mod driver;
mod execute;
pub mod explain;
mod found;
mod mend;
mod pending;
mod previous;
mod previous_units;
pub mod record;
pub mod runner;
mod skip_reasons;

use evermap_contract::Registry;

use crate::map::receipt::Receipt;
use crate::map::store::Store;
use crate::map::version::{MappedSession, Version};
use crate::program::Program;
use crate::run::done::Done;
use crate::sql::Limits;

/// What happens during a run.
#[derive(Debug)]
pub enum Event<'a> {
    /// So many units are known.
    Planned {
        /// Units in all.
        units: usize,
    },
    /// A unit was begun.
    Started {
        /// What a person calls it.
        label: &'a str,
    },
    /// A unit is at work.
    Advanced {
        /// What a person calls it.
        label: &'a str,
        /// The share of its rows that it is done with, from 0 to 1; `None` where nobody knows.
        share: Option<f64>,
    },
    /// A unit was done.
    Done {
        /// What a person calls it.
        label: &'a str,
        /// What it did.
        receipt: &'a Receipt,
        /// Whether it had been done before.
        cached: bool,
    },
}

/// What is run, on what, and where it goes.
pub struct Run<'a> {
    /// The program.
    pub program: &'a Program,
    /// The operators.
    pub registry: &'a Registry,
    /// The map.
    pub store: &'a Store,
    /// All sessions of the coming version, sorted by name.
    pub sessions: &'a [MappedSession],
    /// The version before.
    pub base: Option<&'a Version>,
    /// What one unit may use.
    pub limits: Limits,
}

/// How a run ended.
#[derive(Debug, Clone)]
pub enum RunEnd {
    /// It did everything.
    Done(Box<RunResult>),
    /// Another run published this version while it was at work: it is to be prepared anew on that one. What was
    /// computed is kept.
    Overtaken {
        /// The version.
        by: u64,
    },
}

/// What a run did.
#[derive(Debug, Clone)]
pub struct RunResult {
    /// The version that the map is at now.
    pub version: Version,
    /// Whether this run published it; false where nothing had changed.
    pub published: bool,
    /// Every unit, with its stage.
    pub units: Vec<(String, Done)>,
}

#[cfg(test)]
mod tests;
