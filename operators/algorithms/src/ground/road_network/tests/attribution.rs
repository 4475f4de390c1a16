//! Lanes name the drives, and the parts of them, that they were made from.

use super::*;

fn passage(drive: &str, first: usize, last: usize) -> Passage {
    Passage {
        drive: drive.into(),
        first,
        last,
    }
}

#[test]
fn each_arm_of_a_crossing_has_its_own_half_of_its_own_drive() {
    let across = along(&[[0.0, 0.0], [50.0, 0.0]], 0.5, 0.0);
    let up = along(&[[25.25, -20.0], [25.25, 20.0]], 0.5, 0.0);
    let found = network(&[across, up], &RoadNetworkParams::default());
    assert_eq!(found.lanes.len(), 4, "{found:#?}");
    for lane in &found.lanes {
        let [x, y, _] = lane.points[lane.points.len() / 2];
        // The crossing is at pose 50 of the first drive and at pose 40 of the second.
        let (drive, range) = match (x < 25.0, x > 25.5, y < 0.0) {
            (true, _, _) => ("drive_00000", 0..=51),
            (_, true, _) => ("drive_00000", 46..=99),
            (_, _, true) => ("drive_00001", 0..=44),
            _ => ("drive_00001", 36..=79),
        };
        let [passage] = lane.passages.as_slice() else {
            panic!("{lane:#?}");
        };
        assert_eq!(passage.drive, drive, "{lane:#?}");
        assert!(range.contains(&passage.first) && range.contains(&passage.last));
        assert!(passage.last - passage.first > 30, "{lane:#?}");
        // The outer end of the arm is an end of the drive.
        let ends = [*range.start(), *range.end()];
        let outer = ends[usize::from(ends[0] != 0)];
        assert!([passage.first, passage.last].contains(&outer), "{lane:#?}");
    }
}

#[test]
fn waiting_where_the_lane_ends_belongs_to_it() {
    let mut drive = along(&[[0.0, 0.0], [30.0, 0.0]], 0.5, 0.0);
    drive.extend(std::iter::repeat_n([30.0, 0.0, 0.0], 500));
    let last = drive.len() - 1;
    let found = network(&[drive], &RoadNetworkParams::default());
    assert_eq!(found.lanes[0].passages, [passage("drive_00000", 0, last)]);
}

#[test]
fn a_step_without_poses_between_has_the_poses_around_it() {
    let long = vec![[0.0; 3], [20.0, 0.0, 0.0]];
    for spacing_m in [0.0, 0.5] {
        let params = RoadNetworkParams {
            spacing_m: Some(spacing_m),
            headings: spacing_m > 0.0,
            ..RoadNetworkParams::default()
        };
        let found = network(std::slice::from_ref(&long), &params);
        assert_eq!(found.lanes[0].passages, [passage("drive_00000", 0, 1)]);
    }
}

#[test]
fn no_lane_goes_across_a_break() {
    let mut drive = along(&[[0.0, 0.0], [30.0, 0.0]], 0.5, 0.0);
    let second = drive.len();
    drive.extend(along(&[[30.0, 20.0], [60.0, 20.0]], 0.5, 0.0));
    for spacing_m in [0.0, 0.5] {
        let params = RoadNetworkParams {
            spacing_m: Some(spacing_m),
            headings: spacing_m > 0.0,
            ..RoadNetworkParams::default()
        };
        let lanes = |breaks: &[usize]| {
            let trace = Trace {
                key: "a",
                positions: &drive,
                breaks,
            };
            road_network(&[trace], &params).unwrap().lanes
        };
        assert_eq!(lanes(&[]).len(), 1);
        let found = lanes(&[second]);
        let spans = found.iter().map(|lane| lane.passages.clone());
        let last = drive.len() - 1;
        assert_eq!(
            spans.collect::<Vec<_>>(),
            [[passage("a", 0, second - 1)], [passage("a", second, last)]]
        );
    }
}

/// What holds whatever was driven: passages are in order and within the drive, none is missing.
pub(super) fn check(found: &RoadNetwork, drives: &[(&str, &[[f64; 3]])]) {
    for lane in &found.lanes {
        assert!(!lane.passages.is_empty(), "{lane:#?}");
        assert!(lane.passages.is_sorted_by(|a, b| a.drive < b.drive));
        for passage in &lane.passages {
            let (_, positions) = drives
                .iter()
                .find(|(key, _)| *key == passage.drive)
                .unwrap();
            assert!(passage.first <= passage.last, "{passage:?}");
            for at in [passage.first, passage.last] {
                assert!(positions[at].iter().all(|x| x.is_finite()), "{passage:?}");
            }
        }
        let passes = (lane.forward_passes + lane.reverse_passes) as usize;
        let poses = lane.passages.iter().map(|p| p.last - p.first + 1);
        assert!(passes == 0 || poses.sum::<usize>() >= 2, "{lane:#?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]
    #[test]
    fn every_lane_has_passages_and_poses_that_are_skipped_still_count(
        a in wandering(60), b in wandering(60), gaps in prop::collection::vec(0..60_usize, 0..8),
        thinned in any::<bool>(),
    ) {
        // The paper's way is exponential where two drives tremble together: keep that short.
        let most = if thinned { 60 } else { 8 };
        let (a, b) = (&a[..a.len().min(most)], &b[..b.len().min(most)]);
        let mut params = RoadNetworkParams::default();
        if !thinned {
            params.spacing_m = Some(0.0);
            params.headings = false;
        }
        let solve = |a: &[[f64; 3]]| {
            let drives = [("a", a), ("b", b)];
            let borrowed = drives.map(|(key, positions)| Trace { key, positions, breaks: &[] });
            let found = road_network(&borrowed, &params).unwrap();
            check(&found, &drives);
            found
        };
        let plain = solve(a);
        // Where each pose of `a` comes to lie once there are poses without a position among them.
        let (mut gapped, mut moved) = (Vec::new(), Vec::new());
        for (at, position) in a.iter().enumerate() {
            gapped.extend(gaps.iter().filter(|gap| **gap == at).map(|_| [f64::NAN, 0.0, 0.0]));
            moved.push(gapped.len());
            gapped.push(*position);
        }
        let mut expected = plain;
        let passages = expected.lanes.iter_mut().flat_map(|lane| &mut lane.passages);
        for passage in passages.filter(|passage| passage.drive == "a") {
            (passage.first, passage.last) = (moved[passage.first], moved[passage.last]);
        }
        prop_assert_eq!(solve(&gapped), expected);
    }
}
