//! `import evermap`: maps and logs as Arrow, and runs, from Python.
//!
//! The same tables, functions and commands as the command line's; nothing is decided here. Python's lock is released while
//! something is computed, and Ctrl-C ends it.

// What pyo3's macros write is not ours to change.
#![allow(unsafe_code, missing_docs)]

mod rows;

use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use evermap::commands::sql::Tables;
use evermap::ending::{Failure, Lost};
use evermap_engine::quoted;
use evermap_engine::sql::{Limits, STACK_BYTES, Term};
use evermap_schemas::Fault;
use pyo3::create_exception;
use pyo3::exceptions::PyException;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use tokio::runtime::Runtime;

use crate::rows::Rows;

create_exception!(
    evermap,
    EvermapError,
    PyException,
    "What went wrong, where, and what to do next."
);

/// Python asks this often whether somebody pressed Ctrl-C.
const LOOK: Duration = Duration::from_millis(100);

/// A map at one of its versions: the newest, unless one is named.
#[pyclass(frozen, module = "evermap")]
struct Map {
    tables: Arc<Tables>,
    version: u64,
    layers: Vec<String>,
}

#[pymethods]
impl Map {
    #[new]
    #[pyo3(signature = (address, version = None))]
    fn new(py: Python<'_>, address: PathBuf, version: Option<u64>) -> PyResult<Self> {
        let address = text(address)?;
        let open = async move { Tables::of_map(&address, version, Limits::default()).await };
        let tables = wait(py, open)?;
        let map = tables.map();
        let published = map.map(|map| &map.version);
        Ok(Self {
            version: published.map_or(0, |version| version.version),
            layers: published.map_or_else(Vec::new, |version| {
                let names = version.published().map(|(name, _)| name.clone());
                names.collect()
            }),
            tables: Arc::new(tables),
        })
    }

    /// Its number.
    #[getter]
    fn version(&self) -> u64 {
        self.version
    }

    /// Names of its layers.
    #[getter]
    fn layers(&self) -> Vec<String> {
        self.layers.clone()
    }

    /// All rows of a layer.
    fn layer(&self, py: Python<'_>, name: &str) -> PyResult<Rows> {
        let query = format!("SELECT * FROM {}", quoted::name(name));
        self.sql(py, query)
    }

    /// The answer to a query, with the tables and functions of `evermap sql --map`.
    fn sql(&self, py: Python<'_>, query: String) -> PyResult<Rows> {
        answer(py, &self.tables, query)
    }
}

/// Logs as tables: topics, roles, messages, as `evermap sql --sessions` has them.
#[pyclass(frozen, module = "evermap")]
struct Log {
    tables: Arc<Tables>,
}

#[pymethods]
impl Log {
    #[new]
    #[pyo3(signature = (*sessions, manifest = None, site = None))]
    fn new(
        py: Python<'_>,
        sessions: Vec<PathBuf>,
        manifest: Option<PathBuf>,
        site: Option<String>,
    ) -> PyResult<Self> {
        let sessions = evermap::arguments::SessionArgs {
            sessions: sessions.into_iter().map(text).collect::<Result<_, _>>()?,
            manifest: manifest.map(text).transpose()?,
            site,
        };
        let open = async move { Tables::of_logs(&sessions, Limits::default()).await };
        let tables = Arc::new(wait(py, open)?);
        Ok(Self { tables })
    }

    /// The answer to a query.
    fn sql(&self, py: Python<'_>, query: String) -> PyResult<Rows> {
        answer(py, &self.tables, query)
    }

    /// What could not be read so far, by reason.
    #[getter]
    fn lost<'p>(&self, py: Python<'p>) -> PyResult<Bound<'p, PyDict>> {
        let tables = Arc::clone(&self.tables);
        let lost = wait(py, async move { Ok::<_, Failure>(tables.lost().await) })?;
        counts(py, lost)
    }
}

/// Runs a plan, shipped or a file, on sessions, and publishes a version. Returns what was lost or skipped, by reason.
#[pyfunction]
#[pyo3(signature = (plan, map, sessions = Vec::new(), site = None, settings = None, manifest = None))]
fn run<'p>(
    py: Python<'p>,
    plan: PathBuf,
    map: PathBuf,
    sessions: Vec<PathBuf>,
    site: Option<String>,
    settings: Option<Bound<'p, PyDict>>,
    manifest: Option<PathBuf>,
) -> PyResult<Bound<'p, PyDict>> {
    let mut line: Vec<OsString> = ["evermap".into(), "run".into(), plan.into()].into();
    let mut add = |name: &str, value: OsString| line.extend([name.into(), value]);
    add("--map", map.into());
    add("--progress", "none".into());
    sessions
        .into_iter()
        .for_each(|path| add("--sessions", path.into()));
    if let Some(site) = site {
        add("--site", site.into());
    }
    if let Some(manifest) = manifest {
        add("--manifest", manifest.into());
    }
    for (name, value) in settings.iter().flatten() {
        add("--set", format!("{}={}", name.str()?, value.str()?).into());
    }
    counts(py, wait(py, evermap::command(line))?)
}

fn answer(py: Python<'_>, tables: &Arc<Tables>, query: String) -> PyResult<Rows> {
    let tables = Arc::clone(tables);
    let rows = wait(py, async move { tables.ask(&query).await })?;
    Ok(Rows::from(rows))
}

fn counts(py: Python<'_>, lost: Lost) -> PyResult<Bound<'_, PyDict>> {
    let counts = PyDict::new(py);
    for (reason, count) in lost.0 {
        counts.set_item(reason, count)?;
    }
    Ok(counts)
}

/// Waits for work without Python's lock, until it is done or somebody presses Ctrl-C.
fn wait<T, E>(
    py: Python<'_>,
    work: impl Future<Output = Result<T, E>> + Send + 'static,
) -> PyResult<T>
where
    T: Send + 'static,
    E: Into<Failure> + Send + 'static,
{
    let runtime = runtime()?;
    let term = Term::default();
    let mut task = runtime.spawn(term.of(work));
    loop {
        let ended = async { tokio::time::timeout(LOOK, &mut task).await };
        match py.detach(|| runtime.block_on(ended)) {
            Ok(Ok(done)) => return done.map_err(|failure| raised(failure.into())),
            Ok(Err(panic)) => return Err(EvermapError::new_err(format!("bug: {panic}"))),
            Err(_) => py.check_signals().inspect_err(|_| {
                term.end();
                task.abort();
            })?,
        }
    }
}

fn raised(failure: Failure) -> PyErr {
    EvermapError::new_err(match failure {
        Failure::Fault(fault) => fault.to_string(),
        Failure::Plan(faults) => faults,
        Failure::Said | Failure::Closed => "stopped".to_owned(),
    })
}

/// The threads of all maps and logs of a process.
fn runtime() -> PyResult<&'static Runtime> {
    static RUNTIME: OnceLock<Result<Runtime, String>> = OnceLock::new();
    let made = RUNTIME.get_or_init(|| {
        let mut threads = tokio::runtime::Builder::new_multi_thread();
        let threads = threads.thread_stack_size(STACK_BYTES).enable_all();
        threads.build().map_err(|error| error.to_string())
    });
    let failed = |error: &String| EvermapError::new_err(format!("cannot start threads: {error}"));
    made.as_ref().map_err(failed)
}

/// A path or URL as text.
fn text(path: PathBuf) -> PyResult<String> {
    let path = path.into_os_string().into_string();
    path.map_err(|path| {
        let fault = Fault::user(format!(
            "expected a path in UTF-8, found {}",
            path.display()
        ));
        raised(fault.into())
    })
}

#[pymodule]
fn _evermap(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Map>()?;
    module.add_class::<Log>()?;
    module.add_class::<Rows>()?;
    module.add_function(wrap_pyfunction!(run, module)?)?;
    module.add("EvermapError", module.py().get_type::<EvermapError>())
}
