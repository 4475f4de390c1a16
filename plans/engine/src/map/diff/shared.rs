//! Files of a layer that two versions share. Rows of theirs are the same, so they are not read, unless they may match rows
//! of other files.

use std::collections::{BTreeMap, BTreeSet};

use crate::map::receipt::Artifact;

/// What of a layer two versions do not share.
#[derive(Debug)]
pub struct Unshared {
    /// The files to compare, of either version.
    pub sides: [Vec<Artifact>; 2],
    /// Rows of all others.
    pub same: u64,
}

/// What a file is of, its session or its site.
type Of = fn(&Artifact) -> Option<&str>;

impl Unshared {
    /// Of the files of either version, whose rows are matched by the columns of a key, or as a whole where it has none.
    ///
    /// A file that both versions have, as often, is left out where its rows match no others: the key has the session, or
    /// else the site, that it is of, and no file that only one version has is of the same. Rows that are matched as a whole
    /// may be left out of both sides in any case: as many as before are added, and removed.
    pub fn of(sides: [&[Artifact]; 2], key: &[&str]) -> Self {
        let all = || sides.into_iter().flatten();
        // Units whose rows are equal name one file, which has the rows of each.
        let times: [BTreeMap<&str, usize>; 2] = sides.map(|side| {
            let mut times = BTreeMap::new();
            for artifact in side {
                *times.entry(content(artifact)).or_insert(0) += 1;
            }
            times
        });
        let in_both = |artifact: &Artifact| {
            let [before, after] = times.each_ref().map(|times| times.get(content(artifact)));
            before == after
        };
        let of = told_apart_by(sides, key);
        let changed = all().filter(|artifact| !in_both(artifact));
        let changed: BTreeSet<Option<&str>> = changed.map(|artifact| place(of, artifact)).collect();
        let may_match = |artifact: &Artifact| {
            let place = place(of, artifact);
            !key.is_empty() && changed.contains(&place)
        };
        let read = all().filter(|artifact| !in_both(artifact) || may_match(artifact));
        let read: BTreeSet<&str> = read.map(content).collect();
        let is_read = |artifact: &&Artifact| read.contains(content(artifact));
        // As often as before they are there after.
        let [before, _] = sides;
        let unread = before.iter().filter(|artifact| !is_read(artifact));
        Self {
            sides: sides.map(|side| side.iter().filter(is_read).cloned().collect()),
            same: unread.map(|artifact| artifact.rows).sum(),
        }
    }
}

fn content(artifact: &Artifact) -> &str {
    &artifact.content
}

fn session(artifact: &Artifact) -> Option<&str> {
    artifact.extent.session.as_deref()
}

fn site(artifact: &Artifact) -> Option<&str> {
    artifact.extent.site.as_deref()
}

/// What a file is of, as far as that is asked.
fn place(of: Option<Of>, artifact: &Artifact) -> Option<&str> {
    of.and_then(|of| of(artifact))
}

/// By what files are told apart whose rows have no key in common: a column of the key that each file has one value of.
fn told_apart_by(sides: [&[Artifact]; 2], key: &[&str]) -> Option<Of> {
    let known = |of: Of| {
        let mut all = sides.into_iter().flatten();
        all.all(|artifact| of(artifact).is_some())
    };
    let columns = [("session", session as Of), ("site", site as Of)];
    let mut columns = columns.into_iter();
    let found = columns.find(|(column, of)| key.contains(column) && known(*of));
    found.map(|(_, of)| of)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map::receipt::Extent;

    /// A file of ten rows, of all sessions of the lot or of the one behind the `@` of its name.
    fn file(name: &str) -> Artifact {
        let session = name.split_once('@').map(|(_, session)| session.to_owned());
        Artifact {
            content: name.to_owned(),
            rows: 10,
            bytes: 100,
            extent: Extent {
                session,
                site: Some("lot".to_owned()),
            },
        }
    }

    /// The files that are read, and the rows of the others.
    fn read(sides: [&[&str]; 2], key: &[&str]) -> ([Vec<String>; 2], u64) {
        let files = |side: &[&str]| side.iter().map(|name| file(name)).collect();
        let [before, after]: [Vec<Artifact>; 2] = sides.map(files);
        let unshared = Unshared::of([&before, &after], key);
        let names = |side: Vec<Artifact>| side.into_iter().map(|artifact| artifact.content);
        (
            unshared.sides.map(|side| names(side).collect()),
            unshared.same,
        )
    }

    fn expected(before: &[&str], after: &[&str], same: u64) -> ([Vec<String>; 2], u64) {
        let names = |side: &[&str]| side.iter().map(|name| (*name).to_owned()).collect();
        ([names(before), names(after)], same)
    }

    const KEY: &[&str] = &["site", "session", "stamp"];

    #[test]
    fn sessions_that_stayed_are_not_read_where_the_key_has_the_session() {
        let sides: [&[&str]; 2] = [&["1@a", "2@b", "3@c"], &["1@a", "4@b", "5@d"]];
        let changed = expected(&["2@b", "3@c"], &["4@b", "5@d"], 10);
        assert_eq!(read(sides, KEY), changed);
        // Rows of several sessions of a site may have one key of another kind.
        let all = expected(sides[0], sides[1], 0);
        assert_eq!(read(sides, &["site", "label"]), all);
        assert_eq!(read(sides, &["name"]), all);
        // Nothing matches but what is the same.
        assert_eq!(read(sides, &[]), changed);
    }

    #[test]
    fn a_file_that_is_not_of_one_session_is_read_where_any_has_changed() {
        let sides: [&[&str]; 2] = [&["1", "2@a"], &["1", "3@a"]];
        assert_eq!(read(sides, KEY), expected(sides[0], sides[1], 0));
        let stayed: [&[&str]; 2] = [&["1", "2@a"], &["2@a", "1"]];
        assert_eq!(read(stayed, KEY), expected(&[], &[], 20));
        assert_eq!(read(stayed, &["name"]), expected(&[], &[], 20));
    }

    #[test]
    fn a_file_that_is_named_more_often_has_rows_that_are_new() {
        let more: [&[&str]; 2] = [&["1", "2@a"], &["2@a", "1", "1"]];
        for key in [KEY, &["name"]] {
            assert_eq!(read(more, key), expected(more[0], more[1], 0));
        }
        assert_eq!(read(more, &[]), expected(&["1"], &["1", "1"], 10));
        let stayed: [&[&str]; 2] = [&["1", "1", "2"], &["1", "3", "1"]];
        assert_eq!(read(stayed, &[]), expected(&["2"], &["3"], 20));
    }
}
