//! What the end-to-end tests share: where the data is, how the program is called.
//!
//! Data that others made (`../shared` beside the repository, or `EVERMAP_SHARED`) is never part of the project. A test
//! that needs it asks [`shared`] and, where it is absent, says so on standard error and passes.

#![allow(clippy::expect_used, clippy::panic, clippy::print_stderr)]

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// The repository.
pub fn repository() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("tests/ lies in the repository")
}

/// A path in the shared data; `None`, loudly, where it is not there.
pub fn shared(path: &str) -> Option<PathBuf> {
    let root = std::env::var_os("EVERMAP_SHARED")
        .map_or_else(|| repository().join("../shared"), PathBuf::from);
    let full = root.join(path);
    if full.exists() {
        return Some(full);
    }
    eprintln!("SKIPPED: {} is not there", full.display());
    None
}

/// A finished program.
pub struct Finished {
    /// Exit code; -1 where a signal ended it.
    pub code: i32,
    /// Standard output.
    pub stdout: String,
    /// Standard error.
    pub stderr: String,
}

impl From<Output> for Finished {
    fn from(output: Output) -> Self {
        Self {
            code: output.status.code().unwrap_or(-1),
            stdout: String::from_utf8_lossy(&output.stdout).into_owned(),
            stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    }
}

impl Finished {
    /// This, if it exited with `code`.
    ///
    /// # Panics
    /// With everything it said, if not.
    #[must_use]
    pub fn expect(self, code: i32) -> Self {
        assert_eq!(self.code, code, "stdout: {}\nstderr: {}", self.stdout, self.stderr);
        self
    }

    /// Standard output as JSON.
    ///
    /// # Panics
    /// Where it is none.
    pub fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.stdout).unwrap_or_else(|error| panic!("{error}: {}", self.stdout))
    }
}

/// The program under test, built beside the tests.
///
/// # Panics
/// Where it was not built.
pub fn program() -> PathBuf {
    let test = std::env::current_exe().expect("a test has a path");
    let folder = test.parent().and_then(Path::parent).expect("tests lie in target/PROFILE/deps");
    let program = folder.join("evermap");
    assert!(program.exists(), "{} is not built: run `cargo test --workspace`", program.display());
    program
}

/// `evermap` with these arguments, not yet started.
pub fn command(arguments: &[&str]) -> Command {
    let mut command = Command::new(program());
    command.args(arguments).current_dir(repository());
    command
}

/// Runs `evermap` to its end.
///
/// # Panics
/// When it does not start.
pub fn evermap(arguments: &[&str]) -> Finished {
    command(arguments).output().expect("evermap starts").into()
}

/// The text of a path.
///
/// # Panics
/// For a path that is no UTF-8.
pub fn text(path: &Path) -> &str {
    path.to_str().expect("test paths are UTF-8")
}
