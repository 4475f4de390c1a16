//! The process that decodes, and what is said to it and by it.

use std::io;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use rustix::event::{PollFd, PollFlags, Timespec, poll};

use crate::Failure;
use crate::protocol::{Answer, Request, Word};

/// Names the program that decodes; `evermap-video` beside the program that runs, or of the path, where it is not set.
const PROGRAM_VARIABLE: &str = "EVERMAP_VIDEO";

const PROGRAM: &str = "evermap-video";

/// Signals by which a program ends that was wrong itself: illegal instructions, aborts, buses, arithmetic, segments.
const CRASHES: [i32; 5] = [4, 6, 7, 8, 11];

/// Far more than the largest picture takes that the standards allow.
const LONGEST_FRAME: Timespec = Timespec {
    tv_sec: 60,
    tv_nsec: 0,
};

/// A process with FFmpeg in it.
pub(crate) struct Worker {
    process: Child,
    requests: ChildStdin,
    answers: ChildStdout,
}

impl Worker {
    pub(crate) fn start() -> Result<Self, Failure> {
        let program = program();
        let mut process = Command::new(&program)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            // What interrupts the program is not meant for this one: it ends when nobody asks it any more.
            .process_group(0)
            .spawn()
            .map_err(|error| {
                let program = program.display();
                Failure::Process(format!(
                    "cannot start {program}, which decodes video: {error}; install {PROGRAM} beside evermap, or name it with {PROGRAM_VARIABLE}"
                ))
            })?;
        let ends = process.stdin.take().zip(process.stdout.take());
        let without = || Failure::Process(format!("{PROGRAM} has no pipes"));
        let (requests, answers) = ends.ok_or_else(without)?;
        Ok(Self {
            process,
            requests,
            answers,
        })
    }

    /// Sends a request and waits for its answer. Where this fails the process is of no use any more.
    pub(crate) fn ask(
        &mut self,
        request: Request,
        bytes: &[u8],
    ) -> Result<(Answer, Vec<u8>), Failure> {
        let sent = request.send(&mut self.requests, bytes);
        let answer = sent.and_then(|()| self.answer());
        answer.map_err(|error| self.ended(&error))
    }

    fn answer(&mut self) -> io::Result<(Answer, Vec<u8>)> {
        let mut waited = [PollFd::new(&self.answers, PollFlags::IN)];
        if poll(&mut waited, Some(&LONGEST_FRAME))? == 0 {
            return Err(io::ErrorKind::TimedOut.into());
        }
        let answer = Answer::receive(&mut self.answers)?;
        answer.ok_or_else(|| io::ErrorKind::UnexpectedEof.into())
    }

    /// Why no answer came.
    fn ended(&mut self, error: &io::Error) -> Failure {
        if error.kind() == io::ErrorKind::TimedOut {
            let seconds = LONGEST_FRAME.tv_sec;
            return Failure::Process(format!("{PROGRAM} gave no answer for {seconds} s"));
        }
        let _ = self.process.kill();
        match self.process.wait() {
            Ok(status)
                if status
                    .signal()
                    .is_some_and(|signal| CRASHES.contains(&signal)) =>
            {
                Failure::Frame(format!("does not decode: {PROGRAM} crashed ({status})"))
            }
            Ok(status) => Failure::Process(format!("{PROGRAM} ended ({status})")),
            Err(error) => Failure::Process(format!("{PROGRAM}: {error}")),
        }
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Where the program lies: as the environment says; beside the program that runs, or, for tests and examples, in the
/// folder above; in the path.
fn program() -> PathBuf {
    if let Some(named) = std::env::var_os(PROGRAM_VARIABLE) {
        return named.into();
    }
    let own = std::env::current_exe().unwrap_or_default();
    let folders = own.ancestors().skip(1).take(2);
    let mut beside = folders.map(|folder: &Path| folder.join(PROGRAM));
    let found = beside.find(|path| path.is_file());
    found.unwrap_or_else(|| PROGRAM.into())
}
