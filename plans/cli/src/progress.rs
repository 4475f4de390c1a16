//! How far long work has come, on stderr: a bar where a person looks, lines where a log is kept.

use std::collections::BTreeSet;
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

/// Progress of one piece of long work.
pub struct Progress {
    /// Counts; hidden where no person looks.
    bar: ProgressBar,
    /// Whether lines tell what the bar does not.
    lines: bool,
    percent: u64,
    running: BTreeSet<String>,
}

impl Progress {
    /// Progress towards a total that is not known yet.
    pub fn new(show: Show) -> Self {
        let looks = show == Show::Auto && std::io::stderr().is_terminal();
        Self {
            bar: if looks { bar() } else { ProgressBar::hidden() },
            lines: !looks && show != Show::None,
            percent: 0,
            running: BTreeSet::new(),
        }
    }

    /// Sets the total.
    pub fn expect(&mut self, total: u64) {
        self.bar.set_length(total);
    }

    /// Notes what happens in a run.
    pub fn note(&mut self, event: &Event<'_>) {
        match event {
            Event::Planned { units } => self.expect(*units as u64),
            Event::Started { label } => drop(self.running.insert((*label).to_owned())),
            Event::Done {
                label,
                receipt,
                cached,
            } => {
                self.running.remove(*label);
                self.bar.inc(1);
                if self.lines {
                    let how = match cached {
                        true => "done before".to_owned(),
                        false => of_seconds(receipt.seconds),
                    };
                    let (done, total) = (self.bar.position(), self.total());
                    let rows = of(receipt.artifact.rows, "row");
                    line(&format!("[{done}/{total}] {label}: {rows}, {how}"));
                }
            }
        }
        self.bar.set_message(self.first_running());
    }

    /// The first of what runs, or waits for its turn: as many as a person reads.
    fn first_running(&self) -> String {
        let first: Vec<&str> = self.running.iter().take(4).map(String::as_str).collect();
        first.join(", ")
    }

    /// So much is done of work in many small steps; lines are printed for every tenth of it.
    pub fn at(&mut self, done: u64, what: &str) {
        self.bar.set_position(done);
        self.bar.set_message(what.to_owned());
        let percent = 100 * done / self.total().max(1);
        if self.lines && percent / 10 > self.percent / 10 {
            self.percent = percent;
            line(&format!("{percent:3} % {what}"));
        }
    }

    fn total(&self) -> u64 {
        self.bar.length().unwrap_or_default()
    }

    /// Takes the bar away.
    pub fn finish(self) {
        self.bar.finish_and_clear();
    }
}

fn bar() -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(0), ProgressDrawTarget::stderr());
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
