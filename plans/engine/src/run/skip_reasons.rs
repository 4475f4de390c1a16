//! What the operators of a run skipped, as a person is told of it.
//!
//! Steps that read the same images, or the same rows, skip the same of them, in the same words. Which ones they were is not
//! kept, only how many, so a reason is told once, with the names of its steps and the largest of their counts: at least
//! so many were lost. What each unit skipped is in its receipt, and in the layer `runs`.

use std::collections::BTreeMap;

use crate::map::receipt::Extent;
use crate::program::LIFT;
use crate::run::pending::UnitId;

/// Steps that are named of those that tell the same.
const NAMED: usize = 3;

/// What units skipped, by reason.
#[derive(Debug, Default)]
pub struct SkipReasons<'r> {
    reasons: BTreeMap<&'r str, Skipped<'r>>,
}

/// What was skipped for one reason.
#[derive(Debug, Default)]
struct Skipped<'r> {
    /// The steps that did, in the order in which they were added.
    steps: Vec<&'r str>,
    /// The largest count of a unit, by what units cover.
    most: BTreeMap<&'r Extent, u64>,
}

impl<'r> SkipReasons<'r> {
    /// Adds what a unit skipped, by reason.
    pub fn add(&mut self, id: &'r UnitId, skipped: &'r BTreeMap<String, u64>) {
        for (reason, count) in skipped {
            let of_reason = self.reasons.entry(reason.as_str()).or_default();
            of_reason.add(id, *count);
        }
    }

    /// A line for each reason, with its count.
    pub fn lines(&self) -> BTreeMap<String, u64> {
        let lines = self.reasons.iter();
        let lines = lines.map(|(reason, skipped)| (skipped.line(reason), skipped.count()));
        lines.collect()
    }
}

impl<'r> Skipped<'r> {
    fn add(&mut self, id: &'r UnitId, count: u64) {
        let step = id.stage.trim_end_matches(LIFT);
        if !self.steps.contains(&step) {
            self.steps.push(step);
        }
        let most = self.most.entry(&id.extent).or_default();
        *most = count.max(*most);
    }

    fn line(&self, reason: &str) -> String {
        match self.steps.as_slice() {
            [] | [_] => reason.to_owned(),
            steps => format!(
                "{reason} (told by {}; the largest of their counts)",
                named(steps)
            ),
        }
    }

    /// How many at least: units of several sessions, or sites, skip different things. What is said of a site, or the map, may
    /// be what is said of its sessions, or sites.
    fn count(&self) -> u64 {
        let mut of_map = 0_u64;
        let mut of_sites: BTreeMap<&str, [u64; 2]> = BTreeMap::new();
        for (extent, most) in &self.most {
            let Some(site) = &extent.site else {
                of_map = of_map.max(*most);
                continue;
            };
            let [of_sessions, of_site] = of_sites.entry(site.as_str()).or_default();
            match extent.session {
                Some(_) => *of_sessions = of_sessions.saturating_add(*most),
                None => *of_site = *most,
            }
        }
        let of_sites = of_sites.into_values();
        let of_sites = of_sites.map(|[of_sessions, of_site]| of_sessions.max(of_site));
        of_sites.fold(0, u64::saturating_add).max(of_map)
    }
}

/// The names of two steps or more, of which there may be many.
fn named(steps: &[&str]) -> String {
    match steps.split_at(steps.len().min(NAMED)) {
        ([before @ .., last], []) => format!("{} and {last}", before.join(", ")),
        (first, others) => format!("{} and {} more", first.join(", "), others.len()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DARK: &str = "image of camera `front` is dark";

    /// What is told of units: the stage of each, its session and site (empty where it covers more), why it skipped
    /// something, and how often.
    fn told(units: &[(&str, &str, &str, &str, u64)]) -> BTreeMap<String, u64> {
        let covered = |name: &str| (!name.is_empty()).then(|| name.to_owned());
        let units = units.iter().map(|(stage, session, site, reason, count)| {
            let extent = Extent {
                session: covered(session),
                site: covered(site),
            };
            let stage = (*stage).to_owned();
            let skipped = BTreeMap::from([((*reason).to_owned(), *count)]);
            (UnitId { stage, extent }, skipped)
        });
        let units: Vec<_> = units.collect();
        let mut told = SkipReasons::default();
        for (id, skipped) in &units {
            told.add(id, skipped);
        }
        told.lines()
    }

    fn lines<const N: usize>(lines: [(String, u64); N]) -> BTreeMap<String, u64> {
        BTreeMap::from(lines)
    }

    #[test]
    fn what_several_steps_skip_is_told_once_with_their_names_and_the_largest_count() {
        let found = told(&[
            ("features", "a", "lot", DARK, 3),
            ("overhead_tiles#lift", "a", "lot", DARK, 3),
            ("body_masks", "a", "lot", DARK, 1),
            ("features", "a", "lot", "no corners", 2),
        ]);
        let several =
            "(told by features, overhead_tiles and body_masks; the largest of their counts)";
        let expected = [(format!("{DARK} {several}"), 3), ("no corners".into(), 2)];
        assert_eq!(found, lines(expected));
        let steps = ["a", "b", "c", "d", "e"].map(|step| (step, "a", "lot", DARK, 1));
        let several = "(told by a, b, c and 2 more; the largest of their counts)";
        assert_eq!(told(&steps), lines([(format!("{DARK} {several}"), 1)]));
        let several = "(told by a and b; the largest of their counts)";
        assert_eq!(told(&steps[..2]), lines([(format!("{DARK} {several}"), 1)]));
    }

    #[test]
    fn what_one_step_skips_of_several_sessions_is_added_and_both_stages_of_a_fold_are_one_step() {
        let found = told(&[
            ("tiles#lift", "a", "lot", DARK, 3),
            ("tiles#lift", "b", "lot", DARK, 4),
            ("tiles#lift", "c", "yard", DARK, 5),
            ("tiles", "", "lot", DARK, 1),
        ]);
        assert_eq!(found, lines([(DARK.into(), 12)]));
    }

    #[test]
    fn sessions_and_sites_are_counted_by_the_step_that_skips_most_there() {
        let sessions = [
            ("x", "a", "lot", DARK, 3),
            ("y", "a", "lot", DARK, 1),
            ("x", "b", "lot", DARK, 2),
            ("y", "b", "lot", DARK, 4),
            ("x", "c", "yard", DARK, 5),
        ];
        let count = |more: &[(&str, &str, &str, &str, u64)]| {
            let found = told(&[&sessions[..], more].concat());
            found.into_values().collect::<Vec<_>>()
        };
        assert_eq!(count(&[]), [12]);
        // Of a site it is the same that is told, unless it is more.
        assert_eq!(count(&[("z", "", "lot", DARK, 6)]), [12]);
        assert_eq!(count(&[("z", "", "lot", DARK, 9)]), [14]);
        assert_eq!(count(&[("z", "", "", DARK, 12)]), [12]);
        assert_eq!(count(&[("z", "", "", DARK, 20)]), [20]);
    }

    #[test]
    fn counts_stay_at_the_most_that_there_is() {
        let found = told(&[
            ("x", "a", "lot", DARK, u64::MAX),
            ("x", "b", "lot", DARK, 1),
            ("x", "c", "yard", DARK, 1),
        ]);
        assert_eq!(found, lines([(DARK.into(), u64::MAX)]));
    }
}
