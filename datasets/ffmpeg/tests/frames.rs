//! What is encoded comes back, from any key frame on, and what is broken is told.
#![allow(clippy::unwrap_used, clippy::panic)]

use evermap_ffmpeg::{Encoder, Samples, Stream, Style};
use evermap_video::Codec;

const SIZE: [u32; 2] = [64, 48];
const KEY_EVERY: u32 = 5;

/// A square that moves over a slope.
fn picture(time: u32) -> Vec<u8> {
    let mut rgb = Vec::new();
    for y in 0..SIZE[1] {
        for x in 0..SIZE[0] {
            let inside = (8..24).contains(&y) && (time..time + 16).contains(&x);
            rgb.extend(if inside {
                [200, 60, 40]
            } else {
                [2 * x as u8, 3 * y as u8, 90]
            });
        }
    }
    rgb
}

fn stream(codec: Codec, frames: u32) -> Vec<Vec<u8>> {
    styled(codec, frames, Style::usual(KEY_EVERY, 10))
}

/// In the order in which they decode.
fn styled(codec: Codec, frames: u32, style: Style) -> Vec<Vec<u8>> {
    let mut encoder = Encoder::new(codec, SIZE, style).unwrap();
    let pictures = (0..frames).map(picture);
    let mut encoded: Vec<Vec<u8>> = pictures
        .filter_map(|picture| encoder.encode(&picture).unwrap())
        .collect();
    encoded.extend(encoder.finish().unwrap());
    assert_eq!(encoded.len(), frames as usize);
    encoded
}

/// The files of frames that are decoded one after the other.
fn decoded(codec: Codec, frames: &[Vec<u8>]) -> Result<Vec<Vec<u8>>, String> {
    let mut stream = Stream::new(codec)?;
    let mut files = Vec::new();
    for (index, frame) in frames.iter().enumerate() {
        for picture in stream.push(index as i64, frame)? {
            assert_eq!(picture.index, index as i64);
            files.push(picture.file()?);
        }
    }
    for picture in stream.drain()? {
        files.push(picture.file()?);
    }
    Ok(files)
}

#[test]
fn what_is_encoded_comes_back() {
    for codec in [Codec::H264, Codec::H265] {
        let frames = stream(codec, 12);
        let begins: Vec<usize> = (0..12).filter(|at| codec.begins(&frames[*at])).collect();
        assert_eq!(begins, [0, 5, 10], "{codec:?}");
        let files = decoded(codec, &frames).unwrap();
        assert_eq!(files.len(), 12, "{codec:?}");
        for (time, file) in files.iter().enumerate() {
            let pixels = file.strip_prefix(b"P6\n64 48\n255\n").unwrap();
            let expected = picture(time as u32);
            let apart = pixels
                .iter()
                .zip(&expected)
                .map(|(a, b)| u64::from(a.abs_diff(*b)));
            let mean = apart.sum::<u64>() as f64 / expected.len() as f64;
            assert!(
                mean < 4.0,
                "{codec:?}, frame {time}: {mean} grey levels apart"
            );
        }
        assert_eq!(
            decoded(codec, &frames[5..]).unwrap(),
            files[5..],
            "{codec:?}"
        );
    }
}

#[test]
fn broken_frames_are_told_or_decode() {
    for codec in [Codec::H264, Codec::H265] {
        let frames = stream(codec, 3);
        for length in (0..frames[0].len()).step_by(7) {
            let cut = [frames[0][..length].to_vec(), frames[1].clone()];
            decoded(codec, &cut).ok();
            let mut forged = frames.clone();
            forged[0][length] ^= 0x55;
            decoded(codec, &forged).ok();
        }
        let cut = frames[0][..frames[0].len() / 2].to_vec();
        assert!(decoded(codec, &[cut]).is_err(), "{codec:?}: half a frame");
    }
}

/// Which frames do not decode, where some do not come.
fn refused(codec: Codec, frames: &[Vec<u8>], come: impl Fn(usize) -> bool) -> Vec<usize> {
    let mut stream = Stream::new(codec).unwrap();
    let all = frames.iter().enumerate().filter(|(at, _)| come(*at));
    let pushed = all.map(|(at, frame)| (at, stream.push(at as i64, frame)));
    let refused = pushed.filter_map(|(at, pictures)| Some((at, pictures.err()?)));
    refused
        .map(|(at, reason)| {
            assert_eq!(reason, "refers to one that did not come", "{codec:?}, {at}");
            at
        })
        .collect()
}

#[test]
fn frames_behind_one_that_did_not_come_are_refused_up_to_the_next_key_frame() {
    for codec in [Codec::H264, Codec::H265] {
        let frames = stream(codec, 12);
        assert!(refused(codec, &frames, |_| true).is_empty());
        assert_eq!(refused(codec, &frames, |at| at != 2), [3, 4], "{codec:?}");
        assert!(refused(codec, &frames, |at| at != 4).is_empty());
        assert_eq!(refused(codec, &frames, |at| at != 5), [6, 7, 8, 9]);
        // The same message twice.
        let twice = [&frames[..3], &frames[2..]].concat();
        assert!(refused(codec, &twice, |_| true).is_empty(), "{codec:?}");
        let again = [&frames[..3], &frames[1..]].concat();
        assert!(decoded(codec, &again).is_err(), "{codec:?}");
    }
}

#[test]
fn frames_that_refer_to_later_ones_follow_each_other_too() {
    for codec in [Codec::H264, Codec::H265] {
        let style = Style {
            b_frames: 3,
            ..Style::usual(KEY_EVERY * 4, 10)
        };
        let frames = styled(codec, 50, style);
        assert!(refused(codec, &frames, |_| true).is_empty(), "{codec:?}");
        // The first that refers to a key frame is what others of its group refer to.
        let missing = refused(codec, &frames, |at| at != 1);
        assert!(missing.contains(&2), "{codec:?}: {missing:?}");
    }
}

#[test]
fn samples_of_more_than_8_bits_are_told() {
    for codec in [Codec::H264, Codec::H265] {
        let style = Style {
            samples: Samples::Ten,
            ..Style::usual(KEY_EVERY, 10)
        };
        let reason = decoded(codec, &styled(codec, 3, style)).unwrap_err();
        assert!(
            reason.contains("8 bits, found YUV420P10"),
            "{codec:?}: {reason}"
        );
    }
}
