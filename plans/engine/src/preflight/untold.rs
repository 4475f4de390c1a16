//! Sessions that do not say what their vehicle is like, beside others that do.
//!
//! A step that does without makes something else of them than of the others: without a calibration, a panorama is a plain
//! image. Only what a vehicle is like is told: what is recorded differs from drive to drive, as it pleases.

use std::collections::{BTreeMap, BTreeSet};

use evermap_datasets::Dataset;
use evermap_language::Input;

use crate::preflight::players::Players;
use crate::preflight::{Lacks, Needs, Roles, few, is_lasting, step_of};

/// Sessions that lack a role, and the first step that does without it.
struct Untold {
    step: String,
    sessions: Vec<String>,
}

impl Needs {
    /// What a person is told of sessions given that do not say what their vehicle is like, where others do and a step that
    /// works on them would use it: a note a role. Nothing of those that are idle, which are told with all that they lack.
    pub fn untold(
        &self,
        given: &Dataset,
        players: &Players,
        idle: &[(String, Lacks)],
    ) -> Vec<String> {
        let idle: BTreeSet<&str> = idle.iter().map(|(name, _)| name.as_str()).collect();
        let names = given.sessions.iter().map(|session| &*session.name);
        self.untold_by(names.filter(|name| !idle.contains(name)), players)
    }

    fn untold_by<'n>(
        &self,
        names: impl Iterator<Item = &'n str>,
        players: &Players,
    ) -> Vec<String> {
        let all = players.all();
        let mut untold = BTreeMap::<String, Untold>::new();
        for name in names {
            let without = players.named(name).map(|one| self.does_without(&one.plays));
            for (role, step) in without.into_iter().flatten() {
                if all.contains(&role) {
                    let sessions = Vec::new();
                    let of_role = untold.entry(role).or_insert(Untold { step, sessions });
                    of_role.sessions.push(name.to_owned());
                }
            }
        }
        let notes = untold.into_iter();
        notes.map(|(role, untold)| untold.in_words(&role)).collect()
    }

    /// What a session does not say of its vehicle, and a step that works on the session would use.
    fn does_without(&self, plays: &Roles) -> Lacks {
        let recorded = plays.iter().filter(|role| !is_lasting(role));
        let recorded: Roles = recorded.cloned().collect();
        let is_told = |role: &str| !is_lasting(role) || plays.contains(role);
        let (mut missing, mut of_it) = (BTreeMap::new(), BTreeSet::new());
        let mut without = Lacks::new();
        for need in &self.steps {
            let lacks = need.lacks(plays, &missing);
            if lacks.is_none() && need.reads_of(&recorded, &of_it) {
                of_it.insert(need.step.as_str());
                for role in need.optional.iter().filter_map(source_of) {
                    if !is_told(role) {
                        let step = || step_of(&need.step);
                        without.entry(role.to_owned()).or_insert_with(step);
                    }
                }
            }
            missing.insert(need.step.as_str(), lacks);
        }
        without
    }
}

impl Untold {
    fn in_words(self, role: &str) -> String {
        let is_one = self.sessions.len() == 1;
        let (step, names) = (self.step, few(self.sessions));
        let who = match is_one {
            true => format!("session {names} has"),
            false => format!("sessions {names} have"),
        };
        format!("{who} no {role}, which other sessions have: step {step} does without it")
    }
}

/// The table of logs that an input is.
fn source_of(input: &Input) -> Option<&str> {
    match input {
        Input::Source(name) => Some(name),
        Input::Step(_) | Input::Previous(_) | Input::New(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::preflight::Need;
    use crate::preflight::players::Player;

    fn source(name: &str) -> Input {
        Input::Source(name.to_owned())
    }

    fn roles(names: &[&str]) -> Roles {
        names.iter().map(ToString::to_string).collect()
    }

    /// Labels become views, which would know cameras and poses; what people say is kept.
    fn relocate() -> Needs {
        let views = [
            (Input::Step("labels".to_owned()), false),
            (source("calibration"), true),
            (source("odometry"), true),
        ];
        let labels = [(source("label_frames"), false)];
        let said = [(source("annotations"), false)];
        Needs {
            steps: vec![
                Need::of("labels", labels.into_iter(), false, true),
                Need::of("views", views.into_iter(), false, true),
                Need::of("said", said.into_iter(), false, true),
            ],
            whole: Lacks::new(),
        }
    }

    fn told(sessions: &[(&str, &[&str])]) -> Vec<String> {
        let players = sessions.iter().map(|(name, plays)| {
            let (site, plays) = ("s".to_owned(), roles(plays));
            (name.to_string(), Player { site, plays })
        });
        let names = sessions.iter().map(|(name, _)| *name);
        relocate().untold_by(names, &Players(players.collect()))
    }

    #[test]
    fn a_session_that_does_not_say_what_its_vehicle_is_like_is_told_beside_others() {
        let whole = &["label_frames", "calibration", "odometry"][..];
        let bare = &["label_frames"][..];
        let said =
            "session b has no calibration, which other sessions have: step views does without it";
        assert_eq!(told(&[("a", whole), ("b", bare)]), [said]);
        // Alone, it is told by what no session has; odometry is as it pleases.
        assert!(told(&[("b", bare)]).is_empty());
        assert!(told(&[("a", whole), ("b", &whole[..2])]).is_empty());
        // No step works on it that would use a calibration.
        assert!(told(&[("a", whole), ("b", &["annotations"][..])]).is_empty());
        assert!(told(&[("a", whole), ("b", &["odometry"][..])]).is_empty());
    }

    #[test]
    fn of_many_sessions_few_are_named() {
        let bare: &[&str] = &["label_frames"];
        let names: Vec<String> = (10..500).map(|number| format!("s{number}")).collect();
        let mut sessions: Vec<_> = names.iter().map(|name| (name.as_str(), bare)).collect();
        sessions.push(("t", &["label_frames", "calibration"][..]));
        let notes = told(&sessions);
        assert_eq!(notes.len(), 1);
        let said =
            "sessions s10, s11, s12, s13, s14, s15, s16, s17, 482 more have no calibration, which";
        assert!(notes[0].contains(said), "{notes:?}");
    }
}
