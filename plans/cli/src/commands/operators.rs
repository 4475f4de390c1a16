//! `evermap operators`.

use std::io::Write as _;

use evermap_contract::{Entry, Registry};
use evermap_language::nearest;
use evermap_schemas::{Fault, record};

use crate::arguments::OperatorsArgs;
use crate::ending::{DONE, Ending};
use crate::operators;
use crate::output::print_rows;

record! {
    /// One operator.
    #[layer("operators", key(operator))]
    pub struct OperatorLine {
        /// Name, as plans write it after `op:`.
        operator: String,
        /// Raised when the same input gives another output.
        version: u32,
        /// Input ports; the first drives, those in brackets may stay unconnected.
        ports: String,
        /// Layer that it yields.
        yields: String,
        /// What it yields, in a sentence.
        summary: String,
    }
}

/// Lists the operators, or prints the page of one with the columns of its ports.
///
/// # Errors
/// A user fault that names the operators there are.
pub async fn operators(args: &OperatorsArgs) -> Ending {
    let registry = operators::registry();
    match &args.name {
        Some(name) => writeln!(
            std::io::stdout(),
            "{}",
            entry(&registry, name)?.reference().trim_end()
        )?,
        None => print_rows(args.format, registry.entries().map(line).collect()).await?,
    }
    DONE
}

fn entry<'r>(registry: &'r Registry, name: &str) -> Result<&'r Entry, Fault> {
    let near = nearest(name, registry.entries().map(|entry| entry.name));
    registry.get(name).map_err(|fault| match near {
        Some(near) => {
            Fault::user(format!("no operator {name}")).next(format!("did you mean {near}?"))
        }
        None => fault,
    })
}

fn line(entry: &Entry) -> OperatorLine {
    let port = |port: &evermap_contract::Port| {
        if port.optional {
            format!("[{}]", port.name)
        } else {
            port.name.to_owned()
        }
    };
    OperatorLine {
        operator: entry.name.to_owned(),
        version: entry.version,
        ports: entry.ports.iter().map(port).collect::<Vec<_>>().join(", "),
        yields: entry.output.name.to_owned(),
        summary: entry.page.summary().to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::operators;

    #[test]
    fn a_reference_names_every_parameter_port_and_column() {
        for entry in operators::registry().entries() {
            let text = entry.reference();
            assert!(text.starts_with(&format!("# {}", entry.name)));
            let columns = entry
                .ports
                .iter()
                .flat_map(|port| &port.layer.columns)
                .chain(&entry.output.columns);
            for column in columns {
                assert!(
                    text.contains(&format!("| `{}` |", column.name)),
                    "{}: {}",
                    entry.name,
                    column.name
                );
            }
            for name in entry
                .defaults
                .as_object()
                .into_iter()
                .flat_map(|defaults| defaults.keys())
            {
                assert!(
                    text.contains(&format!("| `{name}` | ")),
                    "{}: {name}",
                    entry.name
                );
            }
        }
    }
}
