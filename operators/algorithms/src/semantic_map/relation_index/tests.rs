//! The index against asking each graph; sets of views against sets.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use proptest::prelude::*;

use super::*;
use crate::semantic_map::relocation::tests::graphs::graph;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn the_relation_index_is_asking_each_graph(graphs in prop::collection::vec(graph(), 0..20)) {
        let index = RelationIndex::new(graphs.iter());
        for relation in Relation::ALL {
            for (a, b) in (0..4).flat_map(|a| (0..4).map(move |b| (a, b))) {
                let views = (0_u32..).zip(&graphs).filter(|(_, graph)| graph.holds(a, relation, b));
                let expected: Vec<u32> = views.map(|(view, _)| view).collect();
                prop_assert_eq!(index.views(a, relation, b).to_vec(), expected);
            }
        }
    }

    #[test]
    fn sets_of_views_are_sets(views in 1_usize..300, members in prop::collection::btree_set(0_u32..320, 0..80)) {
        let mut set = ViewSet::none(views);
        members.iter().for_each(|view| set.insert(*view));
        let known = |view: &u32| (*view as usize) < views;
        let expected: Vec<u32> = members.iter().copied().filter(known).collect();
        prop_assert_eq!(set.count(), expected.len());
        prop_assert!((0..330).all(|view| set.contains(view) == expected.contains(&view)));
        prop_assert_eq!(set.to_vec(), expected);
    }

    #[test]
    fn sets_come_back_from_bytes(views in 0_usize..200, members in prop::collection::btree_set(0_u32..200, 0..80)) {
        let mut set = ViewSet::none(views);
        members.iter().for_each(|view| set.insert(*view));
        let bytes = set.to_bytes();
        prop_assert_eq!(bytes.len(), views.div_ceil(8));
        prop_assert_eq!(ViewSet::from_bytes(&bytes, views), Some(set));
        prop_assert_eq!(ViewSet::from_bytes(&bytes, views + 8), None);
    }
}

#[test]
fn a_view_that_there_is_not_is_none() {
    assert!(ViewSet::from_bytes(&[0b0100], 3).is_some());
    assert_eq!(ViewSet::from_bytes(&[0b1000], 3), None);
    assert_eq!(ViewSet::from_bytes(&[], 0), Some(ViewSet::none(0)));
}

#[test]
fn digests_tell_names_apart() {
    let digest = |names: &[&str]| names_digest(names.iter().copied());
    assert_eq!(digest(&["a", "bc"]), digest(&["a", "bc"]));
    let others: [&[&str]; 4] = [&["ab", "c"], &["bc", "a"], &["a", "bd"], &["abc"]];
    for other in others {
        assert_ne!(digest(&["a", "bc"]), digest(other), "{other:?}");
    }
}
