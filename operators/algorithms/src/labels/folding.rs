//! The acts of any number of people, folded into what holds now.
//!
//! Acts are taken in the order of time, author, sequence and log; each label is what its latest act made it. So the result
//! depends neither on who is read first nor on how acts are spread over logs. What contradicts another's act is counted.

use std::collections::BTreeMap;

/// What was said of a label.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Act {
    /// Here is something.
    Drawn,
    /// A proposal is right.
    Accepted,
    /// A proposal is wrong: there is no such thing here.
    Rejected,
    /// It is somewhere else.
    Moved,
    /// It is no label any more.
    Removed,
}

impl Act {
    /// The act of this name, as logs spell it.
    pub fn named(name: &str) -> Option<Self> {
        Some(match name {
            "drawn" => Act::Drawn,
            "accepted" => Act::Accepted,
            "rejected" => Act::Rejected,
            "moved" => Act::Moved,
            "removed" => Act::Removed,
            _ => return None,
        })
    }

    /// Its name, as logs spell it.
    pub fn name(self) -> &'static str {
        match self {
            Act::Drawn => "drawn",
            Act::Accepted => "accepted",
            Act::Rejected => "rejected",
            Act::Moved => "moved",
            Act::Removed => "removed",
        }
    }
}

/// One act of annotation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Annotation<'a> {
    /// The label that it is about.
    pub label: &'a str,
    /// When, ns since the epoch.
    pub stamp: i64,
    /// Who.
    pub author: &'a str,
    /// Order of what an author said at one instant.
    pub sequence: u64,
    /// The log that it was read from.
    pub log: &'a str,
    /// What.
    pub act: Act,
    /// Whether it says where.
    pub places: bool,
}

/// A label that there is; acts are named by their index among those folded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Label {
    /// `Drawn`, `Accepted` or `Rejected`.
    pub standing: Act,
    /// The latest act that says where it is.
    pub place: usize,
    /// The latest act.
    pub last: usize,
}

/// What holds, and how much did not fit together.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct FoldedLabels<'a> {
    /// The labels that there are, by name.
    pub labels: BTreeMap<&'a str, Label>,
    /// Labels that were removed.
    pub removed: u64,
    /// Acts that contradict another person's, who drew, judged or removed the same label otherwise; the later one holds.
    pub conflicts: u64,
    /// Acts on labels that nobody had drawn; those that say where a label is make it.
    pub strays: u64,
}

/// One label on the way.
struct State<'a> {
    label: Label,
    removed: bool,
    author: &'a str,
}

/// Folds acts, in any order, into the labels that there are.
pub fn folded<'a>(acts: &[Annotation<'a>]) -> FoldedLabels<'a> {
    let mut order: Vec<usize> = (0..acts.len()).collect();
    let key = |at: &usize| {
        let Annotation {
            label,
            stamp,
            author,
            sequence,
            log,
            act,
            ..
        } = acts[*at];
        (stamp, author, sequence, log, label, act, *at)
    };
    order.sort_by_key(key);
    let mut folded = FoldedLabels::default();
    let mut states: BTreeMap<&str, State<'_>> = BTreeMap::new();
    for at in order {
        let said = acts[at];
        match states.get_mut(said.label) {
            Some(state) => {
                folded.conflicts += u64::from(state.contradicts(&said));
                state.take(at, &said);
            }
            None => {
                let late = matches!(said.act, Act::Moved | Act::Removed);
                folded.strays += u64::from(late || !said.places);
                if said.places && said.act != Act::Removed {
                    states.insert(said.label, State::begun(at, &said));
                }
            }
        }
    }
    for (name, state) in states {
        match state.removed {
            true => folded.removed += 1,
            false => {
                folded.labels.insert(name, state.label);
            }
        }
    }
    folded
}

impl<'a> State<'a> {
    fn begun(at: usize, said: &Annotation<'a>) -> Self {
        let label = Label {
            standing: Act::Drawn,
            place: at,
            last: at,
        };
        let mut state = Self {
            label,
            removed: false,
            author: said.author,
        };
        state.take(at, said);
        state
    }

    /// Whether the act does not fit what another person said last.
    fn contradicts(&self, said: &Annotation<'_>) -> bool {
        let clash = match said.act {
            Act::Drawn => !self.removed,
            Act::Accepted => self.removed || self.label.standing == Act::Rejected,
            Act::Rejected => self.removed || self.label.standing == Act::Accepted,
            Act::Moved => self.removed,
            Act::Removed => false,
        };
        clash && self.author != said.author
    }

    fn take(&mut self, at: usize, said: &Annotation<'a>) {
        self.label.last = at;
        self.author = said.author;
        self.removed = said.act == Act::Removed;
        if said.places && !self.removed {
            self.label.place = at;
        }
        if !matches!(said.act, Act::Moved | Act::Removed) {
            self.label.standing = said.act;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn said<'a>(stamp: i64, author: &'a str, label: &'a str, act: Act) -> Annotation<'a> {
        Annotation {
            label,
            stamp,
            author,
            sequence: 0,
            log: "a",
            act,
            places: matches!(act, Act::Drawn | Act::Moved),
        }
    }

    #[test]
    fn a_label_is_what_its_latest_acts_made_it() {
        let acts = [
            said(1, "ada", "one", Act::Drawn),
            said(2, "ada", "two", Act::Drawn),
            said(3, "bob", "one", Act::Moved),
            said(4, "ada", "two", Act::Removed),
            said(5, "ada", "one", Act::Accepted),
        ];
        let found = folded(&acts);
        let one = Label {
            standing: Act::Accepted,
            place: 2,
            last: 4,
        };
        assert_eq!(found.labels, BTreeMap::from([("one", one)]));
        assert_eq!((found.removed, found.conflicts, found.strays), (1, 0, 0));
    }

    #[test]
    fn what_another_said_otherwise_is_a_conflict_and_a_change_of_mind_is_none() {
        let cases = [
            (Act::Drawn, Act::Drawn, 1),
            (Act::Accepted, Act::Rejected, 1),
            (Act::Rejected, Act::Accepted, 1),
            (Act::Removed, Act::Moved, 1),
            (Act::Removed, Act::Drawn, 0),
            (Act::Removed, Act::Removed, 0),
            (Act::Moved, Act::Moved, 0),
        ];
        for (one, other, conflicts) in cases {
            let by = |second| {
                let acts = [
                    said(1, "ada", "x", Act::Drawn),
                    said(2, "ada", "x", one),
                    said(3, second, "x", other),
                ];
                folded(&acts).conflicts
            };
            assert_eq!((by("bob"), by("ada")), (conflicts, 0), "{one:?}, {other:?}");
        }
    }

    #[test]
    fn acts_on_what_nobody_drew_are_counted_and_no_place_is_lost() {
        let acts = [
            said(1, "ada", "x", Act::Removed),
            said(2, "ada", "y", Act::Moved),
            said(3, "ada", "z", Act::Accepted),
        ];
        let found = folded(&acts);
        assert_eq!(found.strays, 3);
        assert_eq!(found.labels.keys().collect::<Vec<_>>(), [&"y"]);
    }

    fn acts() -> impl Strategy<Value = Vec<Annotation<'static>>> {
        let names = || proptest::sample::select(vec!["a", "b", "c"]);
        let act = proptest::sample::select(vec![
            Act::Drawn,
            Act::Accepted,
            Act::Rejected,
            Act::Moved,
            Act::Removed,
        ]);
        let one = (
            names(),
            0..4_i64,
            names(),
            0..2_u64,
            names(),
            act,
            any::<bool>(),
        );
        let one = one.prop_map(
            |(label, stamp, author, sequence, log, act, places)| Annotation {
                label,
                stamp,
                author,
                sequence,
                log,
                act,
                places: places || act == Act::Drawn,
            },
        );
        proptest::collection::vec(one, 0..12)
    }

    fn order_of(said: &Annotation<'static>) -> impl Ord + use<> {
        (
            said.label,
            said.stamp,
            said.author,
            said.sequence,
            said.log,
            said.act,
        )
    }

    proptest! {
        /// Folded in another order, the same acts say the same, up to acts that are equal in all but their place.
        #[test]
        fn the_order_of_reading_says_nothing(acts in acts()) {
            let mut distinct = acts;
            distinct.sort_by_key(order_of);
            distinct.dedup_by_key(|said| order_of(said));
            let reversed: Vec<_> = distinct.iter().rev().copied().collect();
            let (one, other) = (folded(&distinct), folded(&reversed));
            let named = |folded: &FoldedLabels<'static>, acts: &[Annotation<'static>]| -> Vec<_> {
                let labels = folded.labels.iter();
                labels.map(|(name, label)| (*name, label.standing, acts[label.place], acts[label.last])).collect()
            };
            prop_assert_eq!(named(&one, &distinct), named(&other, &reversed));
            prop_assert_eq!((one.removed, one.conflicts, one.strays), (other.removed, other.conflicts, other.strays));
        }
    }
}
