//! Arguments of `sql`.

use std::path::{Path, PathBuf};

use clap::Args;
use evermap_schemas::Fault;

use crate::arguments::SessionArgs;
use crate::output::Format;
use crate::quantity;

/// Arguments of `sql`.
#[derive(Debug, Args)]
#[command(group(clap::ArgGroup::new("what").required(true).args(["map", "sessions", "manifest"]).multiple(true)))]
pub struct SqlArgs {
    /// Folder or URL of a map: its layers are tables, beside `layers`, `versions`, `runs` and `columns`; so are the logs
    /// behind it, by the names of their sessions: `monday."/odom"`. Given again, other maps are beside it by the names of
    /// their folders, or as they are named here: `other.lanes`.
    #[arg(long, value_name = "[NAME=]DIR")]
    pub map: Vec<String>,
    /// Version of the first map [default: the newest].
    #[arg(long, value_name = "N", requires = "map")]
    pub version: Option<u64>,
    /// Over sessions each topic is a table, beside `messages`, `channels`, `sessions`, `frames` and others; with a map, by
    /// the names of the sessions: `tuesday."/odom"`.
    #[command(flatten)]
    pub sessions: SessionArgs,
    /// How results are written [default: as `--out` ends, else table].
    #[arg(long)]
    pub format: Option<Format>,
    /// File for the result, instead of stdout: `.parquet`, `.csv`, `.json` and `.arrow` are written as they are called.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Memory for sorts, joins and decoded chunks.
    #[arg(long, value_name = "BYTES", default_value = super::MEMORY, value_parser = quantity::bytes)]
    pub memory: usize,
    /// The query, also after the sessions, or as `--query`; without one, a prompt, or queries from standard input.
    pub query: Option<String>,
    /// The query, where it would be taken for another session.
    #[arg(
        long = "query",
        short = 'q',
        value_name = "QUERY",
        conflicts_with = "query"
    )]
    pub named_query: Option<String>,
}

/// Arguments of `functions`.
#[derive(Debug, Args)]
pub struct FunctionsArgs {
    /// How the list is written.
    #[arg(long, default_value = "table")]
    pub format: Format,
}

impl SqlArgs {
    /// How results are written: as is said, else as the file ends, else for people.
    ///
    /// # Errors
    /// A user fault where the file ends otherwise than is said.
    pub fn written(&self) -> Result<Format, Fault> {
        let ending = self.out.as_deref().and_then(Format::of_ending);
        match (self.format, ending) {
            (Some(said), Some(ending)) if said != ending => {
                let file = self.out.as_deref().unwrap_or(Path::new(""));
                let (said, ending) = (said.name(), ending.name());
                let fault = format!(
                    "expected a file that ends in .{said}, found {}",
                    file.display()
                );
                Err(Fault::user(fault)
                    .next(format!("leave --format out, or say --format {ending}")))
            }
            (said, ending) => Ok(said.or(ending).unwrap_or(Format::Table)),
        }
    }

    /// The sessions and the query. The shell gives both in one row, as in `--sessions a.mcap b.mcap 'SELECT 1'`: a last
    /// session that reads like a query and is no file is the query.
    pub fn split(&self) -> (SessionArgs, Option<String>) {
        let mut sessions = self.sessions.clone();
        let mut query = self.query.clone().or_else(|| self.named_query.clone());
        let is_last_a_query = sessions.sessions.last().is_some_and(|last| is_query(last));
        if query.is_none()
            && is_last_a_query
            && (sessions.sessions.len() > 1 || sessions.manifest.is_some())
        {
            query = sessions.sessions.pop();
        }
        (sessions, query)
    }
}

fn is_query(text: &str) -> bool {
    const VERBS: [&str; 9] = [
        "select", "with", "show", "describe", "explain", "copy", "create", "set", "values",
    ];
    let first = text
        .trim_start_matches(['(', ' ', '\n', '\t'])
        .split_whitespace()
        .next()
        .unwrap_or_default();
    let is_verb =
        VERBS.contains(&first.to_lowercase().as_str()) || text.trim_start().starts_with("--");
    is_verb && text.trim().contains(char::is_whitespace) && !std::path::Path::new(text).exists()
}
