//! Gradients beside what they are by definition, one cell and one direction after the other.

use super::*;
use crate::solving::random::SplitMix64;

const COLUMNS: usize = 34;
const ROWS: usize = 27;
/// Contrast is levelled over more than the whole image.
const CELL_M: f64 = 0.05;

/// Anything in colour or in grey, of which a corner was not seen.
fn anything(channels: Channels) -> Overhead {
    let mut random = SplitMix64(7);
    let mut image = Overhead::unseen(channels, [COLUMNS, ROWS], CELL_M);
    for channel in &mut image.channels {
        channel.fill_with(|| (255.0 * random.unit()) as u8);
    }
    let seen = image.covered.iter_mut().enumerate();
    seen.for_each(|(at, seen)| *seen = at % COLUMNS > 8 || at / COLUMNS > 6);
    image
}

/// The cells within so many of one, as far as there are any.
fn around([column, row]: [usize; 2], radius: usize) -> Vec<[usize; 2]> {
    let range = |at: usize, count: usize| at.saturating_sub(radius)..(at + radius + 1).min(count);
    let rows = range(row, ROWS);
    let near = rows.flat_map(|row| range(column, COLUMNS).map(move |column| [column, row]));
    near.collect()
}

/// What a cell shows of one contrast.
fn contrast(image: &Overhead, which: usize, [column, row]: [usize; 2]) -> f64 {
    let colour = image.channels.iter();
    let colour: Vec<f64> = colour
        .map(|values| f64::from(values[row * COLUMNS + column]))
        .collect();
    match (colour.as_slice(), which) {
        ([red, green, blue], 0) => 0.299 * red + 0.587 * green + 0.114 * blue,
        ([red, green, _], 1) => (red - green) / 2.0_f64.sqrt(),
        ([red, green, blue], 2) => (red + green - 2.0 * blue) / 6.0_f64.sqrt(),
        (grey, _) => grey[0],
    }
}

fn smooth(image: &Overhead, which: usize, at: [usize; 2]) -> f64 {
    let seen = around(at, 1).into_iter();
    let seen = seen.filter(|[column, row]| image.covered[row * COLUMNS + column]);
    let values = seen.map(|near| contrast(image, which, near));
    let values: Vec<f64> = values.collect();
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// The strongest line of a cell, of all contrasts and of many directions, and its direction in half turns.
fn line(image: &Overhead, at: [usize; 2]) -> [f64; 2] {
    let near = around(at, 2);
    let is_seen = |[column, row]: &[usize; 2]| image.covered[row * COLUMNS + column];
    if near.len() < 25 || !near.iter().all(is_seen) {
        return [0.0; 2];
    }
    let mut strongest = [0.0; 2];
    for which in 0..image.channels.len() {
        // Two cells to the east and to the north, or the other way.
        let value = |east: isize, north: isize| {
            let column = at[0].wrapping_add_signed(2 * east);
            smooth(
                image,
                which,
                [column, at[1].wrapping_add_signed(-2 * north)],
            )
        };
        let middle = value(0, 0);
        let twice_east = value(1, 0) - 2.0 * middle + value(-1, 0);
        let twice_north = value(0, 1) - 2.0 * middle + value(0, -1);
        let slope = |east: isize| 0.5 * (value(east, 1) - value(east, -1));
        let both = 0.5 * (slope(1) - slope(-1));
        for step in 0..1024 {
            let half_turns = f64::from(step) / 1024.0;
            let (sin, cos) = (std::f64::consts::PI * half_turns).sin_cos();
            let bend = cos * cos * twice_east + 2.0 * cos * sin * both + sin * sin * twice_north;
            if 0.5 * bend.abs() > strongest[0] {
                strongest = [0.5 * bend.abs(), half_turns];
            }
        }
    }
    strongest
}

#[test]
fn gradients_are_the_strongest_lines_of_grey_and_of_opponent_colours() {
    for channels in [Channels::Grey, Channels::Colour] {
        let image = anything(channels);
        let cells = (0..COLUMNS * ROWS).map(|at| [at % COLUMNS, at / COLUMNS]);
        let lines: Vec<[f64; 2]> = cells.map(|at| line(&image, at)).collect();
        let seen = image.covered.iter().filter(|seen| **seen).count();
        let sum: f64 = lines.iter().map(|[strength, _]| strength).sum();
        let level = sum / seen as f64 + f64::from(NOISE);
        let mut differ = 0;
        for (at, ([strength, half_turns], found)) in lines.iter().zip(image.gradients()).enumerate()
        {
            assert_eq!(is_seen(&found), image.covered[at]);
            if !image.covered[at] {
                continue;
            }
            let expected = (strength / level).min(f64::from(MOST)) / f64::from(STEP);
            let off = (f64::from(found[0]) - expected).abs();
            assert!(
                off < 0.6,
                "{at}: {found:?}, expected a strength of {expected}"
            );
            let turned = f64::from(found[1]) / DIRECTIONS as f64 - half_turns;
            let is_off = (turned - turned.round()).abs() * DIRECTIONS as f64 > 1.5;
            differ += usize::from(is_off && *strength > 0.0);
        }
        // Where a spot is as strong in all directions, or two contrasts are as strong, either is right.
        assert!(differ < 9, "{differ} directions of {seen}");
    }
}

#[test]
fn a_line_counts_more_than_a_border_of_the_same_contrast() {
    let strongest = |is_bright: &dyn Fn(usize) -> bool| {
        let mut image = Overhead::unseen(Channels::Grey, [COLUMNS, ROWS], CELL_M);
        image.covered.fill(true);
        for (at, value) in image.channels[0].iter_mut().enumerate() {
            *value = if is_bright(at % COLUMNS) { 180 } else { 90 };
        }
        let mut raw = vec![Line::default(); COLUMNS * ROWS];
        let counts = image.seen();
        let smooth = image.smoothed(&image.contrasts()[0], &counts);
        image.strengthen(&mut raw, &smooth, &counts);
        let middle = raw[ROWS / 2 * COLUMNS..][..COLUMNS].iter();
        middle.map(|line| line.strength).fold(0.0, f32::max)
    };
    let line = strongest(&|column| (16..18).contains(&column));
    let border = strongest(&|column| column >= 16);
    assert!(
        2.0 * line >= 2.9 * border && border > 20.0,
        "{line} {border}"
    );
}
