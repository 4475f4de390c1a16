//! What plans can be written with, and what the language asks of its host.

use std::io::Read;
use std::path::Path;

use datafusion::error::DataFusionError;
use evermap_contract::{GivenFile, ParamFault, Registry};
use evermap_datasets::{Dataset, read_at_most, without_mark};
use evermap_language::{
    Host, OperatorSpec, ParameterFault, PortSpec, QueryFault, Source, Vocabulary,
};
use evermap_schemas::Fault;
use serde::Deserialize;
use serde_json::Value;

use super::PlanText;
use crate::error::{fault_of, place_in_query};
use crate::map::tables::own;
use crate::sql::tables;

/// Everything plans can be written with.
pub fn vocabulary(registry: &Registry) -> Vocabulary {
    let operators = registry.entries().map(|entry| OperatorSpec {
        name: entry.name.to_owned(),
        ports: entry
            .ports
            .iter()
            .map(|port| PortSpec {
                name: port.name.to_owned(),
                optional: port.optional,
            })
            .collect(),
        params: entry.params_schema.clone(),
    });
    Vocabulary {
        operators: operators.collect(),
        sources: Dataset::table_names()
            .iter()
            .map(ToString::to_string)
            .collect(),
        open_sources: true,
        map_tables: own().map(|table| table.name.to_owned()).collect(),
    }
}

/// The longest file of Python that is read (bytes).
const LONGEST_CODE: u64 = 1 << 20;

/// The largest file that a parameter names (bytes).
const LARGEST_FILE: u64 = 32 << 20;

fn query_fault(error: &DataFusionError) -> QueryFault {
    let Fault { message, next, .. } = fault_of(error);
    QueryFault {
        message: match next.as_str() {
            "" => message,
            next => format!("{message}; {next}"),
        },
        at: place_in_query(error),
    }
}

/// Names the files that parameters were given by their paths again.
pub fn by_path(params: &mut Value) {
    let params = params.as_object_mut().into_iter().flatten();
    let entries = params.filter_map(|(_, value)| value.as_object_mut());
    for (_, entry) in entries.flatten() {
        if let Ok(given) = GivenFile::deserialize(&*entry) {
            let path = std::path::absolute(&given.file);
            *entry = path
                .map_or(given.file, |path| path.display().to_string())
                .into();
        }
    }
}

/// What a plan is read among.
pub struct Surroundings<'a> {
    /// The plan.
    pub plan: &'a PlanText,
    /// The operators.
    pub registry: &'a Registry,
}

impl Host for Surroundings<'_> {
    fn tables(&self, query: &str) -> Result<Vec<String>, QueryFault> {
        tables(query).map_err(|error| query_fault(&error))
    }

    fn parameter_faults(&self, operator: &str, params: &Value) -> Vec<ParameterFault> {
        let entry = self.registry.get(operator);
        let faults = entry.map_or_else(|_| Vec::new(), |entry| entry.faults(params));
        let told = |fault: ParamFault| ParameterFault {
            parameter: fault.param,
            entry: fault.entry,
            message: fault.message,
        };
        faults.into_iter().map(told).collect()
    }

    fn plan(&self, name: &str, extended_by: &str) -> Result<Source, String> {
        (self.plan.find)(name, extended_by)
    }

    fn code(&self, path: &str, named_by: &str) -> Result<String, String> {
        let folder = Path::new(named_by).parent().unwrap_or(Path::new(""));
        let path = folder.join(path);
        let failed = |error| format!("cannot read {}: {error}", path.display());
        let file = std::fs::File::open(&path).map_err(failed)?;
        let mut code = String::new();
        let read = file.take(LONGEST_CODE + 1).read_to_string(&mut code);
        match read.map_err(failed)? as u64 > LONGEST_CODE {
            true => Err(format!(
                "{} has more than {LONGEST_CODE} bytes",
                path.display()
            )),
            false => Ok(without_mark(&code).to_owned()),
        }
    }

    fn file(&self, path: &str, named_by: &str) -> Result<Value, String> {
        let folder = Path::new(named_by).parent().unwrap_or(Path::new(""));
        let there = folder.join(path);
        let failed = |error| format!("{error} at {}", there.display());
        let given = GivenFile {
            file: there.display().to_string(),
            hex: read_at_most(&there, LARGEST_FILE).map_err(failed)?,
        };
        serde_json::to_value(given).map_err(|error| error.to_string())
    }

    fn manifest(&self) -> Option<Source> {
        self.plan.manifest.clone()
    }
}
