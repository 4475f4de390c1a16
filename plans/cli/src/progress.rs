//! How far long work has come, on stderr: a bar where a person looks, lines where a log is kept.

use std::io::{IsTerminal, Write};

use clap::ValueEnum;
use evermap_engine::run::Event;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::quantity::{of, of_seconds};

/// How progress is shown.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum Show {
    /// A bar on a terminal, lines elsewhere.
    #[default]
    Auto,
    /// One line for each piece of work.
    Plain,
    /// Nothing.
    None,
}

enum Form {
    Bar(ProgressBar),
    Lines,
    Silent,
}

/// Progress of one piece of long work.
pub struct Progress {
    form: Form,
    done: u64,
    total: u64,
    percent: u64,
    running: Vec<String>,
}

impl Progress {
    /// Progress towards a total that may be set later.
    pub fn new(show: Show, total: u64) -> Self {
        let form = match show {
            Show::None => Form::Silent,
            Show::Auto if std::io::stderr().is_terminal() => Form::Bar(bar(total)),
            Show::Auto | Show::Plain => Form::Lines,
        };
        Self {
            form,
            done: 0,
            total,
            percent: 0,
            running: Vec::new(),
        }
    }

    /// Sets the total.
    pub fn expect(&mut self, total: u64) {
        self.total = total;
        if let Form::Bar(bar) = &self.form {
            bar.set_length(total);
        }
    }

    /// Notes what happens in a run.
    pub fn note(&mut self, event: &Event<'_>) {
        match event {
            Event::Planned { units } => self.expect(*units as u64),
            Event::Started { label } => {
                self.running.push((*label).to_owned());
                self.message();
            }
            Event::Done {
                label,
                receipt,
                cached,
            } => {
                self.running.retain(|running| running != label);
                let how = if *cached {
                    "done before".to_owned()
                } else {
                    of_seconds(receipt.seconds)
                };
                self.step(&format!(
                    "{label}: {}, {how}",
                    of(receipt.artifact.rows, "row")
                ));
                self.message();
            }
        }
    }

    /// One step is done.
    pub fn step(&mut self, what: &str) {
        self.done += 1;
        match &self.form {
            Form::Bar(bar) => bar.set_position(self.done),
            Form::Lines => line(&format!("[{}/{}] {what}", self.done, self.total)),
            Form::Silent => {}
        }
    }

    /// So much is done of work in many small steps; lines are printed for every tenth of it.
    pub fn at(&mut self, done: u64, what: &str) {
        self.done = done;
        match &self.form {
            Form::Bar(bar) => {
                bar.set_position(done);
                bar.set_message(what.to_owned());
            }
            Form::Lines => {
                let percent = 100 * done / self.total.max(1);
                if percent / 10 > self.percent / 10 {
                    self.percent = percent;
                    line(&format!("{percent:3} % {what}"));
                }
            }
            Form::Silent => {}
        }
    }

    fn message(&self) {
        if let Form::Bar(bar) = &self.form {
            bar.set_message(self.running.join(", "));
        }
    }

    /// Takes the bar away.
    pub fn finish(self) {
        if let Form::Bar(bar) = self.form {
            bar.finish_and_clear();
        }
    }
}

fn bar(total: u64) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::stderr());
    let style = ProgressStyle::with_template("{elapsed_precise} {bar:30} {pos}/{len} {wide_msg}");
    bar.set_style(
        style
            .unwrap_or_else(|_| ProgressStyle::default_bar())
            .progress_chars("━╸ "),
    );
    bar.enable_steady_tick(std::time::Duration::from_millis(200));
    bar
}

/// A line on stderr; that nobody reads it is no reason to stop.
pub fn line(text: &str) {
    let _ = writeln!(std::io::stderr(), "{text}");
}
