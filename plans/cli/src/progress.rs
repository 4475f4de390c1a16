//! How far long work has come, on stderr: a bar where a person looks, lines where a log is kept.

use std::collections::BTreeMap;
use std::io::{IsTerminal, Write};
use std::time::{Duration, Instant};

use clap::ValueEnum;
use evermap_engine::run::Event;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::printable::printable;
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
    /// Units that run, or wait for their turn.
    running: BTreeMap<String, Option<Course>>,
}

/// How a unit has come on since it was first told.
struct Course {
    begun: Instant,
    /// The first share that was told, and when.
    from: Option<(Instant, f64)>,
    share: Option<f64>,
    /// When a line told it last.
    told: Instant,
}

/// Logs are told this often how far a long unit has come.
const TOLD_EVERY: Duration = Duration::from_secs(10);

impl Course {
    /// That it is at work, of which nothing is known yet.
    fn begin() -> Self {
        let now = Instant::now();
        Self {
            begun: now,
            from: None,
            share: None,
            told: now,
        }
    }

    /// That a share is done, now; `None` where nobody knows.
    fn advance(&mut self, share: Option<f64>) {
        self.share = share;
        if let (None, Some(share)) = (self.from, share) {
            self.from = Some((Instant::now(), share));
        }
    }

    /// So much is left, if it goes on as it has; `None` as long as nobody can tell.
    fn left(&self) -> Option<f64> {
        let ((begun, from), share) = (self.from?, self.share?);
        let done = share - from;
        (done > 0.0).then(|| begun.elapsed().as_secs_f64() * (1.0 - share) / done)
    }

    /// The share that is done; where nothing is yet, or nobody knows, how long it has been at work.
    fn text(&self) -> String {
        let percent = self.share.map_or(0.0, |share| (100.0 * share).floor());
        match self.left().map(of_seconds) {
            Some(left) => format!("{percent} %, {left} left"),
            None if percent > 0.0 => format!("{percent} %"),
            None => format!("{} so far", of_seconds(self.begun.elapsed().as_secs_f64())),
        }
    }

    /// Whether a line is to tell it again: less and less often where it could only say how long it has been at work.
    fn is_due(&self) -> bool {
        let pause = match self.left() {
            Some(_) => TOLD_EVERY,
            None => TOLD_EVERY.max(self.told.duration_since(self.begun)),
        };
        self.told.elapsed() >= pause
    }
}

impl Progress {
    /// Progress towards a total that is not known yet.
    pub fn new(show: Show) -> Self {
        let looks = show == Show::Auto && std::io::stderr().is_terminal();
        Self {
            bar: if looks { bar() } else { ProgressBar::hidden() },
            lines: !looks && show != Show::None,
            percent: 0,
            running: BTreeMap::new(),
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
            Event::Started { label } => drop(self.running.insert((*label).to_owned(), None)),
            Event::Advanced { label, share } => self.advance(label, *share),
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

    fn advance(&mut self, label: &str, share: Option<f64>) {
        let Some(unit) = self.running.get_mut(label) else {
            return;
        };
        let course = unit.get_or_insert_with(Course::begin);
        course.advance(share);
        if self.lines && course.is_due() {
            course.told = Instant::now();
            line(&format!("{label}: {}", course.text()));
        }
    }

    /// The first of what runs, or waits for its turn: as many as a person reads, those first that are at work.
    fn first_running(&self) -> String {
        let told = |(label, unit): (&String, &Option<Course>)| match unit {
            Some(course) => format!("{label} {}", course.text()),
            None => label.clone(),
        };
        let (on, others): (Vec<_>, Vec<_>) =
            self.running.iter().partition(|(_, unit)| unit.is_some());
        let first: Vec<String> = on.into_iter().chain(others).take(4).map(told).collect();
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
    let _ = writeln!(std::io::stderr(), "{}", printable(text));
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn what_is_left_follows_from_what_was_done() {
        let mut course = Course::begin();
        course.advance(Some(0.2));
        assert_eq!((course.left(), course.text().as_str()), (None, "20 %"));
        course.from = Some((ago(30), 0.2));
        course.advance(Some(0.5));
        let left = course.left().unwrap();
        assert!((49.0..51.0).contains(&left), "{left}");
        assert!(course.text().starts_with("50 %, 50."), "{}", course.text());
    }

    fn ago(seconds: u64) -> Instant {
        Instant::now()
            .checked_sub(Duration::from_secs(seconds))
            .unwrap()
    }

    /// A key of which all rows are worked on at once is done at the end, and nobody knows when that is.
    #[test]
    fn what_has_done_nothing_yet_says_how_long_it_has_been_at_work() {
        for share in [None, Some(0.0)] {
            let mut course = Course::begin();
            course.begun = ago(75);
            course.advance(share);
            let text = course.text();
            assert!(text.ends_with(" so far") && !text.contains('%'), "{text}");
            // Told after 10, 20, 40 and 80 s.
            course.told = ago(35);
            assert!(!course.is_due());
            course.told = ago(65);
            assert!(course.is_due());
        }
    }

    #[test]
    fn units_that_come_on_are_named_first() {
        let mut progress = Progress::new(Show::None);
        for label in ["a", "b", "c", "d", "e"] {
            progress.note(&Event::Started { label });
        }
        progress.note(&Event::Advanced {
            label: "e",
            share: Some(0.25),
        });
        progress.note(&Event::Advanced {
            label: "other",
            share: Some(0.5),
        });
        assert_eq!(progress.first_running(), "e 25 %, a, b, c");
    }
}
