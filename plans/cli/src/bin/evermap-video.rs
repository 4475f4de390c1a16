//! The binary `evermap-video`: decodes frames of video for `evermap`, which starts it where it meets them.

use std::io::{ErrorKind, IsTerminal, Write};
use std::process::ExitCode;

/// What a person is told who starts it.
const BY_HAND: &str =
    "evermap-video decodes video for evermap, which starts it itself where a log has video";

fn main() -> ExitCode {
    let (requests, answers) = (std::io::stdin(), std::io::stdout());
    if std::env::args_os().len() > 1 || requests.is_terminal() {
        return refused(BY_HAND);
    }
    match evermap_ffmpeg::serve(requests.lock(), answers.lock()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if error.kind() == ErrorKind::InvalidData => refused(&format!(
            "expected requests of evermap, found something else: {BY_HAND}"
        )),
        // Whoever asked has gone.
        Err(_) => ExitCode::FAILURE,
    }
}

fn refused(why: &str) -> ExitCode {
    // That nobody reads it changes nothing.
    let _ = writeln!(std::io::stderr(), "{why}");
    ExitCode::from(2)
}
