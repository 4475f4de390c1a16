//! How a command ends, and what the shell sees of it.
//!
//! | exit | when |
//! |---|---|
//! | 0 | done |
//! | 1 | failed; nothing was changed, or what was done is kept for the next try |
//! | 2 | the command line makes no sense (clap says so) |
//! | 3 | done, but something was skipped or lost; each reason is counted on stderr |

use std::collections::BTreeMap;
use std::io::{ErrorKind, Write};

use arrow::error::ArrowError;
use evermap_engine::prepare::Refusal;
use evermap_schemas::{Fault, Kind};

use crate::printable::printable;

/// Why a command failed.
#[derive(Debug)]
pub enum Failure {
    /// One fault.
    Fault(Fault),
    /// The faults of a plan, with carets, ready to print.
    Plan(String),
    /// Results that are not what they should be, already printed: a failed test of a plan.
    Said,
    /// Whoever read our output has closed it: `evermap … | head`.
    Closed,
}

/// What was skipped or lost, by reason; empty where nothing was.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Lost(pub BTreeMap<String, u64>);

/// Reasons that a person is told of losses.
const MOST_REASONS: usize = 100;

/// How a command ends.
pub type Ending = Result<Lost, Failure>;

/// An ending without loss.
pub const DONE: Ending = Ok(Lost(BTreeMap::new()));

impl From<Fault> for Failure {
    fn from(fault: Fault) -> Self {
        Self::Fault(fault)
    }
}

impl From<Refusal> for Failure {
    fn from(refusal: Refusal) -> Self {
        match refusal {
            Refusal::Plan(faults) => Self::Plan(faults.pretty()),
            Refusal::Fault(fault) => Self::Fault(fault),
        }
    }
}

impl From<std::io::Error> for Failure {
    fn from(error: std::io::Error) -> Self {
        if error.kind() == ErrorKind::BrokenPipe {
            return Self::Closed;
        }
        Self::Fault(match error.downcast::<Fault>() {
            Ok(fault) => fault,
            Err(error) => {
                let fault = Fault::resource(format!("cannot write the result: {error}"));
                match error.kind() {
                    ErrorKind::FileTooLarge => {
                        fault.next("raise the limit of file sizes (ulimit -f)")
                    }
                    _ => fault,
                }
            }
        })
    }
}

impl From<ArrowError> for Failure {
    fn from(error: ArrowError) -> Self {
        match error {
            ArrowError::IoError(_, error) => error.into(),
            other => Self::Fault(other.into()),
        }
    }
}

/// A command, or a query of a prompt, that panicked.
pub fn panicked(error: &tokio::task::JoinError) -> Failure {
    Fault::new(Kind::Bug, format!("the command panicked: {error}"))
        .next("please report it")
        .into()
}

/// Tells the person, on `stderr`, how it ended; the exit code.
pub fn tell(ending: &Ending, stderr: &mut dyn Write) -> u8 {
    let (code, text) = match ending {
        Ok(lost) if lost.0.is_empty() => (0, String::new()),
        Ok(lost) => (3, format!("finished with loss: {}", lost.counted())),
        Err(Failure::Fault(fault)) => (1, format!("error: {fault}\n")),
        Err(Failure::Plan(faults)) => (1, format!("{faults}error: the plan is refused\n")),
        Err(Failure::Said) => (1, String::new()),
        Err(Failure::Closed) => (0, String::new()),
    };
    // Nobody is left to be told when stderr is gone.
    let _ = stderr.write_all(printable(&text).as_bytes());
    code
}

impl Lost {
    /// How many, and a line for each reason; of many reasons, for the first.
    pub fn counted(&self) -> String {
        let sum = |count: u64, more: &u64| count.saturating_add(*more);
        let total = self.0.values().fold(0, sum);
        let lines = self.0.iter().take(MOST_REASONS);
        let lines = lines.map(|(reason, count)| format!("  {count:>8}  {reason}\n"));
        let lines: String = lines.collect();
        let others = self.0.values().skip(MOST_REASONS);
        let others = match others.len() {
            0 => String::new(),
            more => format!("  {:>8}  for {more} more reasons\n", others.fold(0, sum)),
        };
        format!("{total} skipped or lost\n{lines}{others}")
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn told(ending: Ending) -> (u8, String) {
        let mut text = Vec::new();
        let code = tell(&ending, &mut text);
        (code, String::from_utf8(text).unwrap())
    }

    #[test]
    fn endings_have_their_codes() {
        assert_eq!(told(DONE), (0, String::new()));
        assert_eq!(told(Err(Failure::Closed)).0, 0);
        let (code, text) = told(Err(Fault::user("no map").next("make one").into()));
        assert_eq!(
            (code, text.as_str()),
            (1, "error: user: no map; make one\n")
        );
        let lost = Lost(BTreeMap::from([
            ("dark frames".to_owned(), 3),
            ("torn logs".to_owned(), 1),
        ]));
        let (code, text) = told(Ok(lost));
        assert_eq!(code, 3);
        assert_eq!(text.lines().count(), 3, "a line for each reason");
        assert!(
            text.contains("4 skipped or lost") && text.contains("3  dark frames"),
            "{text}"
        );
    }

    #[test]
    fn of_many_reasons_the_first_are_told_and_all_are_counted() {
        let reasons = (0..1_000).map(|number| (format!("topic {number:03}"), 2));
        let (code, text) = told(Ok(Lost(reasons.collect())));
        assert_eq!((code, text.lines().count()), (3, MOST_REASONS + 2));
        assert!(text.starts_with("finished with loss: 2000 skipped or lost\n"));
        let last = "\n         2  topic 099\n      1800  for 900 more reasons\n";
        assert!(text.ends_with(last), "{text}");
    }

    #[test]
    fn a_closed_pipe_is_no_failure_however_it_is_reported() {
        let broken = || std::io::Error::from(std::io::ErrorKind::BrokenPipe);
        assert!(matches!(Failure::from(broken()), Failure::Closed));
        assert!(matches!(
            Failure::from(ArrowError::IoError(String::new(), broken())),
            Failure::Closed
        ));
    }
}
