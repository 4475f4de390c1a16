//! Places that were built from one drawing.

use super::world::{Imaging, World};
use super::*;

/// A drive of `keyframes` through one room, in the map of a room of the same drawing.
fn drive(room: &World, mapped: &World, keyframes: usize) -> Case {
    let imaging = Imaging {
        clutter: 10,
        ..Imaging::default()
    };
    let mut case = Case::new(41, mapped.clone(), imaging, 1.0, 0.0);
    let mut random = SplitMix64(42);
    let truth = case.truth.iter().take(keyframes);
    case.features = truth
        .map(|pose| room.features(pose, &imaging, &mut random))
        .collect();
    case.truth.truncate(keyframes);
    case.odometry.truncate(keyframes);
    case
}

/// Keyframes localised, and those held back for each of two doubts.
fn outcome(case: &Case, evidence_places: usize) -> [usize; 3] {
    let params = LocalisationParams {
        evidence_places,
        ..LocalisationParams::default()
    };
    let localiser = Localiser::new(&case.world.rig, &case.map, params);
    let told = case.told(&mut SplitMix64(43));
    let found = localiser.localise(&world::drive(&case.odometry, &case.features), &told);
    let doubted = |doubt: Doubt| {
        let fixes = found.iter().filter_map(|found| found.fix.as_ref());
        fixes.filter(|fix| fix.doubt == Some(doubt)).count()
    };
    let known = found.iter().filter(|found| found.state != State::Lost);
    [
        known.count(),
        doubted(Doubt::AnotherPlace),
        doubted(Doubt::Undecided),
    ]
}

#[test]
fn another_place_of_the_same_drawing_is_held_back() {
    let (here, elsewhere) = (World::drawn(51), World::drawn(52));
    let home = drive(&here, &here, 110);
    assert_eq!(outcome(&home, 7), [110, 0, 0]);
    let abroad = drive(&elsewhere, &here, 110);
    let [mistaken, ..] = outcome(&abroad, 0);
    assert!(mistaken > 55, "{mistaken}");
    let [localised, ..] = outcome(&abroad, 7);
    assert_eq!(localised, 0);
}

#[test]
fn a_short_stretch_does_not_tell() {
    let here = World::drawn(51);
    let [localised, held_back, undecided] = outcome(&drive(&here, &here, 20), 7);
    assert_eq!([localised, held_back, undecided], [0, 0, 20]);
    let [localised, ..] = outcome(&drive(&here, &here, 20), 3);
    assert_eq!(localised, 20);
}
