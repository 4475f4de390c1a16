//! An interpreter that has loaded a function, and what is said to it and by it.

use std::collections::BTreeMap;
use std::io::{self, BufReader, Read, Write};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use arrow::ipc::reader::StreamReader;
use arrow::ipc::writer::StreamWriter;
use evermap_schemas::Fault;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::{CallResult, Environment, Function, INTERPRETER, Table};

/// What the interpreter runs.
const PROGRAM: &str = include_str!("worker.py");

/// The longest header that is read (bytes).
const LONGEST_HEADER: u32 = 1 << 20;

/// A process that has loaded one function.
pub(crate) struct Worker {
    process: Child,
    requests: Option<ChildStdin>,
    answers: BufReader<ChildStdout>,
    /// The number of the last request.
    number: u64,
    /// What people call the function.
    label: String,
    /// Its digest.
    pub(crate) loaded: blake3::Hash,
    /// Where the function runs.
    pub(crate) environment: Environment,
}

/// An answer, with the number of its request.
#[derive(Deserialize)]
struct NumberedAnswer {
    number: u64,
    #[serde(flatten)]
    answer: Answer,
}

/// What a worker answers.
#[derive(Deserialize)]
#[serde(rename_all = "lowercase")]
enum Answer {
    Environment(Environment),
    Skipped(BTreeMap<String, u64>),
    Error(String),
}

impl Worker {
    /// Starts the interpreter and has it load a function, of this digest.
    pub(crate) fn start(function: &Function, loaded: blake3::Hash) -> Result<Self, Fault> {
        let interpreter = std::env::var_os(INTERPRETER).unwrap_or_else(|| "python3".into());
        let mut process = Command::new(&interpreter)
            // The last is for the program, which names it to people.
            .args(["-B", "-c", PROGRAM, INTERPRETER])
            // Packages that are installed are in the digest of the environment, other folders are not.
            .env_remove("PYTHONPATH")
            // The order of sets of text is else another one in every process.
            .env("PYTHONHASHSEED", "0")
            .env("PYTHONUTF8", "1")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(said_to_people())
            .spawn()
            .map_err(|error| {
                let interpreter = interpreter.display();
                Fault::resource(format!("cannot start {interpreter}: {error}")).next(format!(
                    "install Python, or name an interpreter with {INTERPRETER}"
                ))
            })?;
        let ends = process.stdin.take().zip(process.stdout.take());
        let (requests, answers) = ends.ok_or_else(|| Fault::bug("a process without pipes"))?;
        let mut worker = Self {
            process,
            requests: Some(requests),
            answers: BufReader::new(answers),
            number: 0,
            label: function.label(),
            loaded,
            environment: Environment(String::new()),
        };
        let request = serde_json::to_value(function)
            .map_err(|error| Fault::bug(format!("a function does not serialise: {error}")))?;
        match worker.ask(request, &[])? {
            Answer::Environment(environment) => worker.environment = environment,
            _ => return Err(worker.confused()),
        }
        Ok(worker)
    }

    /// Calls the function. Where this fails the worker is not to be used again.
    pub(crate) fn call(
        &mut self,
        function: &Function,
        tables: &[Table],
    ) -> Result<CallResult, Fault> {
        let streams = tables.iter().map(stream).collect::<Result<Vec<_>, _>>()?;
        match self.ask(json!({"tables": function.ports}), &streams)? {
            Answer::Skipped(skipped) => Ok(CallResult {
                rows: self.table().map_err(|error| self.broken(&error))?,
                skipped,
            }),
            _ => Err(self.confused()),
        }
    }

    /// Sends a message and reads the header of the answer.
    fn ask(&mut self, mut header: Value, tables: &[Vec<u8>]) -> Result<Answer, Fault> {
        self.number += 1;
        header["number"] = self.number.into();
        let NumberedAnswer { number, answer } = self
            .send(&header, tables)
            .and_then(|()| self.header())
            .map_err(|error| self.ended(&error))?;
        match answer {
            _ if number != self.number => Err(Fault::user(format!(
                "expected the answer to request {}, found one to request {number}",
                self.number
            ))
            .at(&self.label)
            .next("have the function write to no pipe that it did not open")),
            Answer::Error(message) => Err(Fault::user(message).at(&self.label)),
            answer => Ok(answer),
        }
    }

    fn send(&mut self, header: &Value, tables: &[Vec<u8>]) -> io::Result<()> {
        let pipe = self.requests.as_mut().ok_or(io::ErrorKind::BrokenPipe)?;
        let line = header.to_string();
        let length = u32::try_from(line.len()).map_err(io::Error::other)?;
        pipe.write_all(&length.to_le_bytes())?;
        pipe.write_all(line.as_bytes())?;
        for table in tables {
            pipe.write_all(&(table.len() as u64).to_le_bytes())?;
            pipe.write_all(table)?;
        }
        pipe.flush()
    }

    fn header(&mut self) -> io::Result<NumberedAnswer> {
        let mut length = [0; 4];
        self.answers.read_exact(&mut length)?;
        let length = u32::from_le_bytes(length);
        if length > LONGEST_HEADER {
            let message =
                format!("expected a header of at most {LONGEST_HEADER} bytes, found {length}");
            return Err(io::Error::other(message));
        }
        let mut line = vec![0; length as usize];
        self.answers.read_exact(&mut line)?;
        serde_json::from_slice(&line).map_err(io::Error::other)
    }

    /// Reads the table of an answer. Its length is believed no further than bytes come.
    fn table(&mut self) -> Result<Table, arrow::error::ArrowError> {
        let mut length = [0; 8];
        self.answers.read_exact(&mut length)?;
        let mut stream = (&mut self.answers).take(u64::from_le_bytes(length));
        let reader = StreamReader::try_new(&mut stream, None)?;
        let schema = reader.schema();
        let batches = reader.collect::<Result<Vec<_>, _>>()?;
        io::copy(&mut stream, &mut io::sink())?;
        Ok(Table { schema, batches })
    }

    /// That the interpreter said nothing more, with how it ended.
    fn ended(&mut self, error: &io::Error) -> Fault {
        self.requests = None;
        let end = match self.process.wait() {
            Ok(status) => status.to_string(),
            Err(error) => error.to_string(),
        };
        // That a pipe is closed says no more than that.
        let why = match error.kind() {
            io::ErrorKind::UnexpectedEof | io::ErrorKind::BrokenPipe => String::new(),
            _ => format!(": {error}"),
        };
        Fault::user(format!(
            "the interpreter ended without an answer ({end}){why}"
        ))
        .at(&self.label)
    }

    fn broken(&self, error: &arrow::error::ArrowError) -> Fault {
        Fault::user(format!("the rows that came back do not read: {error}")).at(&self.label)
    }

    fn confused(&self) -> Fault {
        Fault::bug("the interpreter answered something else").at(&self.label)
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.requests = None;
        // It may be at work still; nobody waits for what it makes.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Where what the function prints goes. Tests print nothing: their mistakes are meant.
fn said_to_people() -> Stdio {
    match cfg!(test) {
        true => Stdio::null(),
        false => Stdio::inherit(),
    }
}

/// A table as an Arrow stream.
fn stream(table: &Table) -> Result<Vec<u8>, Fault> {
    let mut writer = StreamWriter::try_new(Vec::new(), &table.schema)?;
    table
        .batches
        .iter()
        .try_for_each(|batch| writer.write(batch))?;
    Ok(writer.into_inner()?)
}
