#![allow(clippy::unwrap_used)]
use super::*;
use crate::bits::written::Written;
use crate::gap::asked::{all_follow, followed, torn_ones_are_left_to_the_decoder};

/// A sequence parameter set of the main profile with 4 bits of `frame_num`, its order as decoded.
fn sequence(gaps_allowed: u32) -> Vec<u8> {
    let unit = Written::unit(&[0x67]).number(24, 77 << 16);
    let unit = unit.unsigned(&[0, 0, 2, 1]).flags(&[gaps_allowed]);
    unit.unsigned(&[3, 3]).flags(&[1, 1, 0, 0]).bytes()
}

/// A picture parameter set without weights.
fn set() -> Vec<u8> {
    let unit = Written::unit(&[0x68]).unsigned(&[0, 0]).flags(&[0, 0]);
    let unit = unit.unsigned(&[0, 0, 0]).flags(&[0, 0, 0]);
    unit.unsigned(&[0, 0, 0]).flags(&[0, 0, 0]).bytes()
}

fn key() -> Vec<u8> {
    let slice = Written::unit(&[0x65]).unsigned(&[0, 7, 0]).number(4, 0);
    let slice = slice.unsigned(&[0]).flags(&[0, 0]).bytes();
    [sequence(0), set(), slice].concat()
}

/// A slice that refers to pictures before it, up to its number.
fn slice(head: u8, first: u32, number: u32) -> Written {
    let slice = Written::unit(&[head]).unsigned(&[first, 5, 0]);
    slice.number(4, number)
}

/// A picture that later ones refer to.
fn reference(number: u32) -> Vec<u8> {
    slice(0x41, 0, number).flags(&[0, 0, 0]).bytes()
}

/// A picture that no other refers to.
fn aside(number: u32) -> Vec<u8> {
    slice(0x01, 0, number).flags(&[0, 0]).bytes()
}

#[test]
fn pictures_that_follow_each_other_do_round_after_round() {
    let mut frames = vec![key()];
    frames.extend((1..40).map(|number| reference(number % 16)));
    frames.extend([key(), reference(1)]);
    all_follow::<Pictures>(&frames);
    // Slices of one picture, in one message and in two.
    let second = slice(0x41, 8, 1).flags(&[0, 0, 0]).bytes();
    all_follow::<Pictures>(&[
        key(),
        [reference(1), second.clone()].concat(),
        second,
        reference(2),
    ]);
}

#[test]
fn a_reference_that_is_missing_is_told_up_to_the_next_key_frame() {
    let missing = || Err(MISSING.to_owned());
    let frames = [key(), reference(1), reference(3), reference(4), key()];
    let expected = [Ok(()), Ok(()), missing(), missing(), Ok(())];
    assert_eq!(followed::<Pictures>(&frames), expected);
    // From 15 to 1: 0 is missing.
    let mut frames = vec![key()];
    frames.extend((1..16).map(reference));
    frames.push(reference(1));
    assert_eq!(followed::<Pictures>(&frames).pop(), Some(missing()));
    assert_eq!(followed::<Pictures>(&[key(), reference(2)])[1], missing());
}

#[test]
fn a_picture_that_none_refers_to_may_be_missing() {
    all_follow::<Pictures>(&[key(), aside(1), aside(1), reference(1), reference(2)]);
    all_follow::<Pictures>(&[key(), reference(1), reference(2)]);
    let frames = [key(), aside(1), aside(2)];
    assert_eq!(followed::<Pictures>(&frames)[2], Err(MISSING.to_owned()));
}

#[test]
fn gaps_that_a_sequence_allows_are_none() {
    let key = [key(), sequence(1)].concat();
    all_follow::<Pictures>(&[key, reference(5), reference(9)]);
}

#[test]
fn a_reference_that_comes_twice_is_told() {
    let frames = [key(), reference(1), reference(1), reference(2)];
    let expected = [Ok(()), Ok(()), Err(AGAIN.to_owned()), Ok(())];
    assert_eq!(followed::<Pictures>(&frames), expected);
}

#[test]
fn numbers_begin_anew_behind_a_picture_that_says_so() {
    // Operations 3 1 0 (two numbers), then 5, then the end.
    let resets = slice(0x41, 0, 2).flags(&[0, 0, 1]);
    let resets = resets.unsigned(&[3, 1, 0, 5, 0]).bytes();
    let second = slice(0x41, 8, 2).flags(&[0, 0, 1]).unsigned(&[5, 0]);
    let picture = [resets, second.bytes()].concat();
    all_follow::<Pictures>(&[key(), reference(1), picture.clone(), reference(1)]);
    let frames = [key(), reference(1), picture, reference(3)];
    assert_eq!(followed::<Pictures>(&frames)[3], Err(MISSING.to_owned()));
    // Without, 1 does not follow 2.
    let frames = [key(), reference(1), reference(2), reference(1)];
    assert_eq!(followed::<Pictures>(&frames)[3], Err(MISSING.to_owned()));
}

#[test]
fn high_profiles_weights_and_orders_are_read_over() {
    // 4:4:4 in one, with a scaling list that ends at once (0 - 8), an order of 4 bits and 5 bits of `frame_num`.
    let high = Written::unit(&[0x67]).number(24, 244 << 16);
    let high = high.unsigned(&[0, 3]).flags(&[0]).unsigned(&[0, 0]);
    let high = high.flags(&[0, 1, 1]).unsigned(&[16]).flags(&[0; 11]);
    let high = high.unsigned(&[1, 0, 0, 1]).flags(&[0]);
    let high = high.unsigned(&[3, 3]).flags(&[0]).bytes();
    let (id, read) = Sequence::read(&high[3..]).unwrap();
    assert_eq!((id, read.number_bits, read.frames_only), (0, 5, false));
    assert!(read.has_chroma && matches!(read.order, Order::Lowest { bits: 4 }));

    // Weights, redundant pictures and the order of the bottom field.
    let set = Written::unit(&[0x68]).unsigned(&[1, 0]).flags(&[0, 1]);
    let set = set.unsigned(&[0, 1, 0]).flags(&[1, 0, 1]);
    let set = set.unsigned(&[0, 0, 0]).flags(&[0, 0, 1]).bytes();
    let mut pictures = Pictures::default();
    pictures.follow(&[high, set].concat()).unwrap();
    let slice = Written::unit(&[0x41]).unsigned(&[0, 5, 1]).number(5, 17);
    // A frame, its order, that of its bottom, not redundant.
    let slice = slice.flags(&[0]).number(4, 9).unsigned(&[2, 0]);
    // Two references, of which one is moved; weights of the first, and of the second's chroma.
    let slice = slice.flags(&[0, 1]).unsigned(&[0, 6, 3, 5, 5]);
    let slice = slice.flags(&[1]).unsigned(&[1, 2]).flags(&[0]);
    let slice = slice.flags(&[0, 1]).unsigned(&[1, 2, 3, 4]);
    let slice = slice.flags(&[1]).unsigned(&[5, 0]).bytes();
    let (head, _) = pictures.head(&slice[3..]).unwrap();
    let expected = Head {
        is_key: false,
        is_reference: true,
        is_first: true,
        is_field: false,
        is_redundant: false,
        number: 17,
        resets: true,
    };
    assert_eq!(head, expected);
}

#[test]
fn heads_that_are_torn_are_left_to_the_decoder() {
    let frames = [key(), reference(1), reference(3)];
    torn_ones_are_left_to_the_decoder::<Pictures>(&frames);
    // Nothing is known behind one.
    let torn = reference(1)[..5].to_vec();
    all_follow::<Pictures>(&[key(), torn, reference(9)]);
}
