//! The SQL prompt: history, several lines until a semicolon, a few commands that start with a backslash.

use std::borrow::Cow;
use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;

use arrow::datatypes::SchemaRef;
use datafusion::common::TableReference;
use datafusion::common::utils::quote_identifier;
use evermap_engine::error::OrFault;
use evermap_engine::run::runner::Unfinished;
use evermap_engine::sql::Term;
use evermap_schemas::{Fault, record};
use reedline::{
    FileBackedHistory, Prompt, PromptEditMode, PromptHistorySearch, Reedline, Signal,
    ValidationResult, Validator,
};
use rustix::termios::{OptionalActions, Termios, tcgetattr, tcsetattr};
use tokio::task::{JoinError, block_in_place, spawn_blocking};

use crate::commands::sql::{Tables, statements};
use crate::ending::{Failure, Lost, panicked, tell};
use crate::output::{Format, Sink, print_rows};
use crate::progress::line;
use crate::quantity::{of, of_seconds};
use crate::stopped::terminated;
use crate::threads;

const HELP: &str = "\\d          tables\n\\d NAME     columns of a table, with units and frames\n\\q          leave\n\
                    SELECT … ;  a query; it may take several lines, and ends with a semicolon";

record! {
    /// One table.
    #[layer("tables", key(table))]
    pub struct TableLine {
        /// Table, as a query names it.
        table: String,
        /// Columns.
        columns: u32,
        /// What one row is.
        rows_are: String,
    }
}

/// Lines that are remembered.
const REMEMBERED: usize = 10_000;

/// What a person typed.
#[derive(Debug, PartialEq, Eq)]
enum Input<'t> {
    Nothing,
    Tables,
    Columns(&'t str),
    Help,
    Quit,
    Query(&'t str),
}

impl<'t> Input<'t> {
    fn of(text: &'t str) -> Self {
        let text = text.trim();
        let Some(command) = text.strip_prefix('\\') else {
            return match text.trim_end_matches(';').trim() {
                "" => Self::Nothing,
                "exit" | "quit" => Self::Quit,
                _ => Self::Query(text),
            };
        };
        let mut words = command.trim_end_matches(';').split_whitespace();
        match (words.next(), words.next()) {
            (Some("q"), _) => Self::Quit,
            (Some("d"), None) => Self::Tables,
            (Some("d"), Some(name)) => Self::Columns(unquoted(name)),
            _ => Self::Help,
        }
    }
}

/// The name of a table without the quotes around it, where it has no schema.
fn unquoted(name: &str) -> &str {
    let within = name
        .strip_prefix('"')
        .and_then(|name| name.strip_suffix('"'));
    within.filter(|name| !name.contains('"')).unwrap_or(name)
}

/// A line is complete when it is a command or ends with a semicolon outside quotes.
struct Complete;

impl Validator for Complete {
    fn validate(&self, text: &str) -> ValidationResult {
        if is_complete(text) {
            ValidationResult::Complete
        } else {
            ValidationResult::Incomplete
        }
    }
}

fn is_complete(text: &str) -> bool {
    let text = text.trim();
    if text.starts_with('\\') || ["", "exit", "quit"].contains(&text) {
        return true;
    }
    !is_quoted_open(text) && text.ends_with(';')
}

/// Whether a quotation of a text does not end in it.
pub fn is_quoted_open(text: &str) -> bool {
    let mut quote = None;
    for letter in text.chars() {
        match quote {
            None if letter == '\'' || letter == '"' => quote = Some(letter),
            Some(open) if open == letter => quote = None,
            _ => {}
        }
    }
    quote.is_some()
}

struct Sign;

impl Prompt for Sign {
    fn render_prompt_left(&self) -> Cow<'_, str> {
        "evermap".into()
    }
    fn render_prompt_right(&self) -> Cow<'_, str> {
        "".into()
    }
    fn render_prompt_indicator(&self, _: PromptEditMode) -> Cow<'_, str> {
        "> ".into()
    }
    fn render_prompt_multiline_indicator(&self) -> Cow<'_, str> {
        "      -> ".into()
    }
    fn render_prompt_history_search_indicator(&self, search: PromptHistorySearch) -> Cow<'_, str> {
        format!("(search {}) ", search.term).into()
    }
}

/// `$XDG_STATE_HOME/evermap/sql_history`, or below `~/.local/state`.
fn history_file() -> Option<PathBuf> {
    let from = |name: &str| {
        std::env::var_os(name)
            .filter(|value| !value.is_empty())
            .map(PathBuf::from)
    };
    let state = from("XDG_STATE_HOME").or_else(|| Some(from("HOME")?.join(".local/state")))?;
    Some(state.join("evermap/sql_history"))
}

fn editor() -> Reedline {
    let editor = Reedline::create().with_validator(Box::new(Complete));
    let history =
        history_file().and_then(|file| FileBackedHistory::with_file(REMEMBERED, file).ok());
    match history {
        Some(history) => editor.with_history(Box::new(history)),
        None => editor,
    }
}

/// How the person has their terminal. It is so again when this is dropped, whatever an editor that still reads made of it.
struct Terminal(Option<Termios>);

impl Terminal {
    fn now() -> Self {
        Self(tcgetattr(std::io::stdin()).ok())
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        if let Some(settings) = &self.0 {
            // A terminal that is gone needs none.
            let _ = tcsetattr(std::io::stdin(), OptionalActions::Now, settings);
        }
    }
}

/// Reads and runs queries until the person leaves. A query's fault is shown, and the prompt goes on. Queries hold
/// `unfinished` as long as they have temporary files.
///
/// # Errors
/// When the terminal fails, or when the program is asked to end while it answers.
pub async fn run(
    tables: &Arc<Tables>,
    format: Format,
    unfinished: &Unfinished,
) -> Result<(), Failure> {
    let _terminal = Terminal::now();
    let mut editor = editor();
    line("\\d lists the tables, \\? helps, \\q leaves");
    loop {
        let (back, signal) = read_line(editor).await?;
        editor = back;
        match signal {
            Signal::Success(text) => match Input::of(&text) {
                Input::Quit => return Ok(()),
                _ => answer(tables, text, format, unfinished).await?,
            },
            Signal::CtrlD => return Ok(()),
            _ => {}
        }
    }
}

/// Reads a line on a thread that has nothing but the editor: it cannot be told to leave. So where the program is asked to
/// end meanwhile, the tables go without it, and what queries have put on the disk with them.
async fn read_line(mut editor: Reedline) -> Result<(Reedline, Signal), Failure> {
    let reading = spawn_blocking(move || {
        let read = editor.read_line(&Sign);
        (editor, read)
    });
    let (editor, read) = reading.await.map_err(|error| panicked(&error))?;
    let signal = read.map_err(|error| Fault::resource(format!("the terminal failed: {error}")))?;
    Ok((editor, signal))
}

/// What comes first while a query is answered.
enum First {
    Answered(Result<Result<(), Failure>, JoinError>),
    Interrupted,
    Terminated,
}

/// Answers one input; Ctrl-C stops a query and comes back to the prompt, also while the query is being planned.
///
/// # Errors
/// When the program is asked to end.
async fn answer(
    tables: &Arc<Tables>,
    text: String,
    format: Format,
    unfinished: &Unfinished,
) -> Result<(), Failure> {
    let term = Term::default();
    // They are dropped in this order: what a query has put on the disk is gone before it counts as finished.
    let held = (Arc::clone(tables), unfinished.clone());
    let answered = async move {
        let held = held;
        respond(&held.0, Input::of(&text), format).await
    };
    let mut asked = tokio::spawn(term.of(answered));
    let first = block_in_place(|| -> Result<_, Fault> {
        Ok(threads::listening()?.block_on(async {
            tokio::select! {
                ended = &mut asked => First::Answered(ended),
                _ = tokio::signal::ctrl_c() => First::Interrupted,
                () = terminated() => First::Terminated,
            }
        }))
    });
    let stop = || {
        term.end();
        asked.abort();
    };
    let ending = match first {
        Ok(First::Answered(ended)) => ended.unwrap_or_else(|error| Err(panicked(&error))),
        Ok(First::Interrupted) => {
            stop();
            line("stopped");
            return Ok(());
        }
        Ok(First::Terminated) => {
            stop();
            return Err(Fault::user("stopped").into());
        }
        Err(fault) => Err(fault.into()),
    };
    // The ledger is told when the prompt ends; here only what failed.
    tell(&ending.map(|()| Lost::default()), &mut std::io::stderr());
    Ok(())
}

/// Answers a line that begins with a backslash; whether more lines are wanted.
///
/// # Errors
/// As that of a query.
pub async fn command(tables: &Tables, line: &str) -> Result<bool, Failure> {
    let input = Input::of(line);
    let goes_on = input != Input::Quit;
    respond(tables, input, Format::Table).await?;
    Ok(goes_on)
}

async fn respond(tables: &Tables, input: Input<'_>, format: Format) -> Result<(), Failure> {
    match input {
        Input::Nothing | Input::Quit => Ok(()),
        Input::Help => Ok(writeln!(std::io::stdout(), "{HELP}")?),
        Input::Tables => list(tables).await,
        Input::Columns(name) => print_rows(Format::Table, tables.columns(name).await?).await,
        Input::Query(text) => {
            for statement in statements(text)? {
                let begun = std::time::Instant::now();
                let mut sink = Sink::stdout();
                let rows = tables.run(statement, format, &mut sink).await?;
                sink.finish()?;
                line(&format!(
                    "{}, {}",
                    of(rows, "row"),
                    of_seconds(begun.elapsed().as_secs_f64())
                ));
            }
            Ok(())
        }
    }
}

async fn list(tables: &Tables) -> Result<(), Failure> {
    let mut lines = Vec::new();
    for name in tables.names() {
        let schema = schema(tables, &name).await?;
        let declared = tables.declaration(&name);
        lines.push(TableLine {
            table: quote_identifier(&name).into_owned(),
            columns: schema.fields().len() as u32,
            rows_are: declared.map_or(String::new(), |layer| layer.doc.to_owned()),
        });
    }
    print_rows(Format::Table, lines).await
}

async fn schema(tables: &Tables, name: &str) -> Result<SchemaRef, Failure> {
    let reference = TableReference::bare(name);
    let table = tables.context.table_provider(reference).await.or_fault()?;
    Ok(table.schema())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_query_ends_with_a_semicolon_outside_quotes() {
        for complete in [
            "SELECT 1;",
            "SELECT ';' ;",
            "\\d",
            "\\d poses",
            "",
            "quit",
            "SELECT\n1\n;",
        ] {
            assert!(is_complete(complete), "{complete}");
        }
        for open in ["SELECT 1", "SELECT ';", "SELECT \"a;", "SELECT ';'"] {
            assert!(!is_complete(open), "{open}");
        }
    }

    #[test]
    fn commands_are_told_from_queries() {
        assert_eq!(Input::of("\\d;"), Input::Tables);
        assert_eq!(Input::of("\\d \"/odom\""), Input::Columns("/odom"));
        let of_session = Input::of("\\d monday.\"/odom\"");
        assert_eq!(of_session, Input::Columns("monday.\"/odom\""));
        assert_eq!(Input::of(" \\q "), Input::Quit);
        assert_eq!(Input::of("quit;"), Input::Quit);
        assert_eq!(Input::of("\\x"), Input::Help);
        assert_eq!(Input::of(" ; "), Input::Nothing);
        assert_eq!(Input::of("SELECT 1;"), Input::Query("SELECT 1;"));
    }
}
