//! Names that a manifest gives, and that nothing has which is given: topics of roles, sites of surveyed places.

use std::collections::BTreeSet;

use evermap_datasets::Dataset;
use evermap_language::{listed, nearest};
use serde_json::Value;

use crate::program::Program;

/// The parameter of steps that says where places lie on earth that somebody surveyed, by site.
const ORIGINS: &str = "origins";

/// The sites whose place on earth a program is given.
pub(super) fn surveyed(program: &Program) -> BTreeSet<&str> {
    let given = program.given(ORIGINS).filter_map(Value::as_object);
    let sites = given.flat_map(|origins| origins.keys().map(String::as_str));
    sites.collect()
}

/// What a person is told of surveyed places that are given for sites which none of these is.
pub fn origins(program: &Program, sites: &BTreeSet<&str>) -> Option<String> {
    of_sites(&surveyed(program), sites)
}

/// What a person is told of topics that a manifest says something of and that none of these logs has.
pub fn topics(given: &Dataset) -> Vec<String> {
    let known = given.topics();
    let known: BTreeSet<&str> = known.iter().map(String::as_str).collect();
    let unknown = given.unknown_topics.iter();
    let warnings = unknown.map(|(key, topic)| {
        let names = BTreeSet::from([topic.as_str()]);
        told(key, &names, "topics", &known)
    });
    warnings.collect()
}

fn of_sites(surveyed: &BTreeSet<&str>, sites: &BTreeSet<&str>) -> Option<String> {
    let unknown: BTreeSet<&str> = surveyed.difference(sites).copied().collect();
    let is_told = !unknown.is_empty() && !sites.is_empty();
    is_told.then(|| told(ORIGINS, &unknown, "sites", sites))
}

/// That a key of a manifest names what no session has, which there are, and which one may be meant.
fn told(key: &str, unknown: &BTreeSet<&str>, what: &str, known: &BTreeSet<&str>) -> String {
    let names = listed(unknown.iter().copied());
    let there_are = listed(known.iter().copied());
    let near: BTreeSet<&str> = unknown
        .iter()
        .filter_map(|name| nearest(name, known.iter().copied()))
        .collect();
    let said = format!("`{key}` names {names}, which no session has: their {what} are {there_are}");
    match near.is_empty() {
        true => said,
        false => format!("{said}; did you mean {}?", listed(near)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_site_that_there_is_not_is_told_with_those_that_there_are_and_the_near_one() {
        let sites = BTreeSet::from(["lot", "street"]);
        assert_eq!(of_sites(&BTreeSet::from(["lot"]), &sites), None);
        assert_eq!(of_sites(&BTreeSet::from(["lott"]), &BTreeSet::new()), None);
        let said = of_sites(&BTreeSet::from(["lott", "street"]), &sites);
        let expected = "`origins` names `lott`, which no session has: their sites are `lot`, `street`; did you mean `lot`?";
        assert_eq!(said.as_deref(), Some(expected));
        let said = of_sites(&BTreeSet::from(["harbour"]), &sites);
        let expected =
            "`origins` names `harbour`, which no session has: their sites are `lot`, `street`";
        assert_eq!(said.as_deref(), Some(expected));
    }
}
