//! `evermap functions`.

use datafusion::logical_expr::Documentation;
use evermap_engine::map::{diff_documentation, lineage_documentation};
use evermap_schemas::record;

use crate::arguments::FunctionsArgs;
use crate::ending::{DONE, Ending};
use crate::output::print_rows;

record! {
    /// A function that queries have beyond those of SQL.
    #[layer("functions", key(function))]
    pub struct FunctionLine {
        /// How it is called, each way.
        function: String,
        /// What it gives: unit, when it is null, type.
        gives: String,
        /// Its arguments, each with what it is.
        arguments: String,
        /// A query; behind `--`, where it has one value, what it answers.
        example: String,
    }
}

impl From<Documentation> for FunctionLine {
    fn from(documented: Documentation) -> Self {
        let ways = documented.alternative_syntax.unwrap_or_default();
        let ways = [documented.syntax_example].into_iter().chain(ways);
        let arguments = documented.arguments.unwrap_or_default().into_iter();
        let arguments = arguments.map(|(name, about)| format!("{name}: {about}"));
        Self {
            function: ways.collect::<Vec<_>>().join(" or "),
            gives: documented.description,
            arguments: arguments.collect::<Vec<_>>().join("; "),
            example: documented.sql_example.unwrap_or_default(),
        }
    }
}

/// Lists the functions on poses, geometries, graphs and versions.
///
/// # Errors
/// That the output is closed.
pub async fn functions(args: &FunctionsArgs) -> Ending {
    let tables = [diff_documentation(), lineage_documentation()];
    let documented = evermap_functions::documented().into_iter().chain(tables);
    let mut lines: Vec<FunctionLine> = documented.map(FunctionLine::from).collect();
    lines.sort_by(|a, b| a.function.cmp(&b.function));
    print_rows(args.format, lines).await?;
    DONE
}
