#![allow(clippy::unwrap_used)]
use super::*;
use crate::bits::written::Written;
use crate::gap::asked::{all_follow, followed, torn_ones_are_left_to_the_decoder};

const SEQUENCE: [u8; 2] = [33 << 1, 1];
const SET: [u8; 2] = [34 << 1, 1];

/// The beginning of a sequence parameter set, up to its sets of references: 4 bits of places.
fn beginning() -> Written {
    let unit = Written::unit(&SEQUENCE).number(4, 0).number(3, 0);
    // Profile, tier and level.
    let unit = unit.flags(&[1]).number(32, 1 << 30).number(32, 7);
    let unit = unit.number(32, 7);
    let unit = unit.unsigned(&[0, 1, 64, 48]).flags(&[0]);
    let unit = unit.unsigned(&[0, 0, 0]).flags(&[1]);
    let unit = unit.unsigned(&[4, 0, 0]).unsigned(&[0, 3, 0, 3, 0, 0]);
    unit.flags(&[0, 0, 0, 0])
}

/// Two sets of references: the one before (used), and that and the second before (not used), by the first.
fn sequence() -> Vec<u8> {
    let unit = beginning().unsigned(&[2]);
    let unit = unit.unsigned(&[1, 0, 0]).flags(&[1]);
    // Moved by -1: -2 is kept and not used, -1 is used.
    let unit = unit.flags(&[1, 1]).unsigned(&[0]).flags(&[0, 1, 1]);
    // One picture far away, by an index: lowest bits 0.
    let unit = unit.flags(&[1]).unsigned(&[1]).number(4, 0).flags(&[1]);
    unit.flags(&[0, 0, 0, 0]).bytes()
}

fn set() -> Vec<u8> {
    let unit = Written::unit(&SET).unsigned(&[0, 0]).flags(&[0, 0]);
    unit.number(3, 0).bytes()
}

fn head(kind: u8) -> Written {
    Written::unit(&[kind << 1, 1]).flags(&[1])
}

/// A key frame that clears all before it.
fn key() -> Vec<u8> {
    let slice = head(19).flags(&[0]).unsigned(&[0, 2]).bytes();
    [sequence(), set(), slice].concat()
}

/// A key frame at a place, behind which pictures may come that are shown before it.
fn open(place: u32) -> Vec<u8> {
    let slice = head(21).flags(&[0]).unsigned(&[0, 2]).number(4, place);
    let slice = slice.flags(&[0, 0]).unsigned(&[0, 0, 0, 0]).bytes();
    [sequence(), set(), slice].concat()
}

/// A picture that refers to the one before it, by the first set of the sequence.
fn next(place: u32) -> Vec<u8> {
    named(1, place, 0).bytes()
}

/// A picture with a set of the sequence, and none far away.
fn named(kind: u8, place: u32, set: u32) -> Written {
    let slice = head(kind).unsigned(&[0, 1]).number(4, place);
    slice.flags(&[1]).number(1, set).unsigned(&[0, 0])
}

/// A picture with references of its own: how far before it, and whether each is used.
fn own(kind: u8, place: u32, before: &[(u32, u32)]) -> Vec<u8> {
    let slice = head(kind).unsigned(&[0, 1]).number(4, place);
    let slice = slice.flags(&[0, 0]).unsigned(&[before.len() as u32, 0]);
    let slice = before.iter().fold(slice, |slice, (step, used)| {
        slice.unsigned(&[step - 1]).flags(&[*used])
    });
    slice.unsigned(&[0, 0]).bytes()
}

fn missing() -> Result<(), String> {
    Err(MISSING.to_owned())
}

#[test]
fn a_sequence_is_read_with_its_sets_of_references() {
    let unit = sequence();
    let (id, read) = Sequence::read(&unit[3..]).unwrap();
    assert_eq!((id, read.order_bits, read.separate_planes), (0, 4, false));
    let sets = [vec![(-1, true)], vec![(-1, true), (-2, false)]];
    assert_eq!(read.references, sets.map(References));
}

#[test]
fn pictures_that_follow_each_other_do_round_after_round() {
    let mut frames = vec![key()];
    frames.extend((1..40).map(|place| next(place % 16)));
    frames.extend([key(), next(1)]);
    all_follow::<Pictures>(&frames);
}

#[test]
fn a_picture_that_another_needs_is_told_up_to_the_next_key_frame() {
    let frames = [key(), next(1), next(3), next(4), key(), next(1)];
    let expected = [Ok(()), Ok(()), missing(), missing(), Ok(()), Ok(())];
    assert_eq!(followed::<Pictures>(&frames), expected);
    // What is named and not used may be missing, what is not named is forgotten.
    all_follow::<Pictures>(&[key(), own(1, 2, &[(1, 0), (1, 1)])]);
    let frames = [key(), next(1), next(2), own(1, 3, &[(3, 1)])];
    assert_eq!(followed::<Pictures>(&frames)[3], missing());
    let kept = named(1, 2, 1).bytes();
    all_follow::<Pictures>(&[key(), next(1), kept, own(1, 3, &[(1, 1), (2, 1)])]);
}

#[test]
fn a_picture_that_none_refers_to_may_be_missing_and_moves_no_place() {
    all_follow::<Pictures>(&[key(), own(0, 5, &[(5, 1)]), next(1), next(2)]);
    all_follow::<Pictures>(&[key(), next(1), next(2)]);
    // 12 is the place before 0 by the lowest bits, and behind 5.
    let later = own(1, 12, &[(12, 1)]);
    all_follow::<Pictures>(&[key(), own(1, 5, &[(5, 1)]), later.clone()]);
    let frames = [key(), own(0, 5, &[(5, 1)]), later];
    assert_eq!(followed::<Pictures>(&frames)[2], missing());
}

#[test]
fn a_place_that_comes_twice_is_told() {
    let frames = [key(), next(1), next(1), next(2)];
    let expected = [Ok(()), Ok(()), Err(AGAIN.to_owned()), Ok(())];
    assert_eq!(followed::<Pictures>(&frames), expected);
}

#[test]
fn pictures_far_away_are_found_by_their_lowest_bits_or_exactly() {
    let far = |place: u32| {
        let slice = head(1).unsigned(&[0, 1]).number(4, place);
        slice.flags(&[1]).number(1, 0)
    };
    // By the only index, which has no bits.
    let by_index = |place: u32| far(place).unsigned(&[1, 0]).flags(&[0]).bytes();
    all_follow::<Pictures>(&[key(), by_index(1)]);
    assert_eq!(followed::<Pictures>(&[open(5), by_index(6)])[1], missing());
    // By lowest bits of its own, and how many rounds before.
    let exact = |rounds: u32| {
        let slice = far(1).unsigned(&[0, 1]).number(4, 0);
        slice.flags(&[1, 1]).unsigned(&[rounds]).bytes()
    };
    all_follow::<Pictures>(&[key(), exact(0)]);
    assert_eq!(followed::<Pictures>(&[key(), exact(1)])[1], missing());
}

#[test]
fn pictures_before_the_first_key_frame_are_left_out_and_later_ones_are_not() {
    let leading = own(9, 3, &[(2, 1)]);
    all_follow::<Pictures>(&[open(5), leading.clone(), own(1, 6, &[(1, 1)])]);
    // The key frame forgets the picture that the leading one needs.
    let frames = [key(), next(1), open(5), leading];
    assert_eq!(followed::<Pictures>(&frames)[3], missing());
}

#[test]
fn other_layers_and_later_slices_are_not_looked_at() {
    // Its second byte begins with the layer.
    let other = [&[0, 0, 1, 2, 9][..], &next(9)[5..]].concat();
    let later = Written::unit(&[2, 1]).flags(&[0]).number(16, 3).bytes();
    all_follow::<Pictures>(&[key(), other, later, next(1)]);
}

#[test]
fn heads_that_are_torn_are_left_to_the_decoder() {
    let frames = [key(), open(3), next(1), own(1, 3, &[(1, 1), (2, 1)])];
    torn_ones_are_left_to_the_decoder::<Pictures>(&frames);
    let torn = next(1)[..6].to_vec();
    all_follow::<Pictures>(&[key(), torn, next(9)]);
}
