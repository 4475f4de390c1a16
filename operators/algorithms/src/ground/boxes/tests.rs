//! Boxes by hand, spaces painted on made-up floors, and a floor that others made.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stderr
)]

use std::collections::BTreeSet;
use std::path::Path;

use super::GroundBox;
use super::lesson::{Lesson, reach_of};
use super::mosaic::{LONGEST_CELLS, MOST_BEYOND, Mosaic};
use super::picture;
use super::teaching::{Example, Hypothesis, Judgement, Taught, TeachingParams};
use crate::ground::channels::Pixels;
use crate::ground::tiles::TILE_CELLS;
use crate::solving::median::median;
use crate::solving::random::SplitMix64;
use evermap_test_data::shared;

/// Side of a cell of all floors here (m).
const CELL_M: f64 = 0.05;

/// A picture of a floor whose south-western corner lies at the origin.
struct Picture {
    columns: usize,
    rows: usize,
    /// Grey and alpha, row by row from the north.
    pixels: Vec<[u8; 2]>,
}

impl Picture {
    /// An image file, grey with or without alpha.
    fn read(path: &Path) -> Self {
        let file = std::io::BufReader::new(std::fs::File::open(path).unwrap());
        let mut decoder = png::Decoder::new(file);
        decoder.set_transformations(png::Transformations::EXPAND | png::Transformations::STRIP_16);
        let mut reader = decoder.read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut bytes).unwrap();
        let samples = info.color_type.samples();
        let alpha = |pixel: &[u8]| match samples.is_multiple_of(2) {
            true => pixel[samples - 1],
            false => 255,
        };
        Self {
            columns: info.width as usize,
            rows: info.height as usize,
            pixels: bytes
                .chunks_exact(samples)
                .map(|pixel| [pixel[0], alpha(pixel)])
                .collect(),
        }
    }

    /// As tiles; what is beyond its borders was not seen.
    fn mosaic(&self) -> Mosaic {
        let mut tiles = picture::Picture::new(CELL_M);
        for y in 0..self.rows.div_ceil(TILE_CELLS) {
            for x in 0..self.columns.div_ceil(TILE_CELLS) {
                let pixel = |at: usize| {
                    let column = x * TILE_CELLS + at % TILE_CELLS;
                    let north = y * TILE_CELLS + TILE_CELLS - 1 - at / TILE_CELLS;
                    if column < self.columns && north < self.rows {
                        self.pixels[(self.rows - 1 - north) * self.columns + column]
                    } else {
                        [0, 0]
                    }
                };
                let pixels = (0..TILE_CELLS * TILE_CELLS).map(pixel).collect();
                assert!(tiles.add([x as i64, y as i64], Pixels::Grey(pixels)));
            }
        }
        tiles.mosaic()
    }
}

/// The boxes of `truth/bays.geojson`.
fn bays(path: &Path) -> Vec<GroundBox> {
    let text = std::fs::read_to_string(path).unwrap();
    let all: serde_json::Value = serde_json::from_str(&text).unwrap();
    let bays = all["features"].as_array().unwrap().iter();
    bays.map(|bay| {
        let number = |name: &str| bay["properties"][name].as_f64().unwrap();
        GroundBox {
            centre: [number("cx"), number("cy")],
            yaw: number("entry_yaw"),
            length_m: number("length"),
            width_m: number("width"),
        }
    })
    .collect()
}

/// A row of spaces side by side: from where, towards where (degrees), how the spaces lie to it (degrees), how many.
fn row(
    from: [f64; 2],
    towards: f64,
    lie: f64,
    count: usize,
    [length_m, width_m]: [f64; 2],
) -> Vec<GroundBox> {
    let (towards, lie) = (towards.to_radians(), lie.to_radians());
    let pitch_m = width_m / lie.sin().abs();
    let space = |at: usize| {
        let along = (at as f64 + 0.5) * pitch_m;
        GroundBox {
            centre: [
                from[0] + along * towards.cos(),
                from[1] + along * towards.sin(),
            ],
            yaw: towards + lie,
            length_m,
            width_m,
        }
    };
    (0..count).map(space).collect()
}

/// A floor with spaces: grain and stains, worn white lines along both sides and across the closed end of each space, cars
/// on half of them smeared away from the lane as the projection does, arrows, and a crossing.
fn painted(spaces: &[GroundBox], [columns, rows]: [usize; 2], seed: u64) -> Picture {
    let mut random = SplitMix64(seed);
    let mut unit = move || random.unit();
    let stains: Vec<([f64; 2], f64, f64)> = (0..columns * rows / 8000)
        .map(|_| {
            let at = [
                unit() * columns as f64 * CELL_M,
                unit() * rows as f64 * CELL_M,
            ];
            (at, 0.3 + 3.0 * unit(), 30.0 * (unit() - 0.6))
        })
        .collect();
    let mut grey = vec![0.0; columns * rows];
    let point = |at: usize| {
        [
            (at % columns) as f64 + 0.5,
            (rows - 1 - at / columns) as f64 + 0.5,
        ]
        .map(|cells| cells * CELL_M)
    };
    for (at, grey) in grey.iter_mut().enumerate() {
        *grey = 90.0 + 24.0 * (unit() - 0.5);
        if unit() < 0.01 {
            *grey += 60.0;
        }
        let [x, y] = point(at);
        *grey += 10.0 * (0.2 * x).sin() * (0.17 * y).cos();
    }
    let mut over = |middle: [f64; 2], reach_m: f64, paint: &mut dyn FnMut([f64; 2], f64) -> f64| {
        let cells = |at: f64, count: usize| {
            let range = [(at - reach_m) / CELL_M, (at + reach_m) / CELL_M];
            let [first, last] = range.map(|at| at.clamp(0.0, count as f64) as usize);
            first..last
        };
        for y in cells(middle[1], rows) {
            for x in cells(middle[0], columns) {
                let at = (rows - 1 - y) * columns + x;
                grey[at] = paint(point(at), grey[at]);
            }
        }
    };
    for (middle, radius_m, change) in stains {
        over(middle, radius_m, &mut |[x, y], grey| {
            let far = (x - middle[0]).hypot(y - middle[1]) / radius_m;
            grey + change * (1.0 - far).max(0.0)
        });
    }
    for space in spaces {
        let (long, wide) = (0.5 * space.length_m, 0.5 * space.width_m);
        let wear = 0.4 + 0.6 * unit();
        over(space.centre, long + wide, &mut |at, grey| {
            let [ahead, left] = space.inside(at);
            let side = (left.abs() - wide).abs() < 0.06 && ahead.abs() < long;
            let end = (ahead - long).abs() < 0.06 && left.abs() < wide;
            if side || end {
                grey + wear * 90.0
            } else {
                grey
            }
        });
        if unit() < 0.5 {
            let dark = unit() < 0.5;
            over(space.centre, long + 2.0 * wide, &mut |at, grey| {
                let [ahead, left] = space.inside(at);
                let is_car =
                    left.abs() < 0.4 * wide * 2.0 && ahead > -0.8 * long && ahead < 1.3 * long;
                match (is_car, dark) {
                    (true, true) => 35.0 + 0.1 * grey + 10.0 * (3.0 * left).sin(),
                    (true, false) => 150.0 + 0.2 * grey + 15.0 * (4.0 * left).sin(),
                    _ => grey,
                }
            });
        }
    }
    // A crossing and arrows, which are no spaces.
    for stripe in 0..8 {
        let middle = [2.0, 3.0 + f64::from(stripe)];
        over(middle, 2.0, &mut |[x, y], grey| {
            let is_on = (x - middle[0]).abs() < 1.5 && (y - middle[1]).abs() < 0.25;
            if is_on { grey + 80.0 } else { grey }
        });
    }
    Picture {
        columns,
        rows,
        pixels: grey
            .iter()
            .map(|grey| [grey.clamp(0.0, 255.0) as u8, 255])
            .collect(),
    }
}

/// How a person picks what to answer.
#[derive(Clone, Copy, PartialEq)]
enum Picks {
    /// The questions, in their order.
    Questions,
    /// Hypotheses at random.
    Anything,
}

/// A person who knows the truth, and what came of asking.
struct Oracle<'a> {
    truth: &'a [GroundBox],
    examples: Vec<Example>,
    answers: usize,
}

impl Oracle<'_> {
    /// Draws the box that is farthest from all that is known.
    fn draw(&mut self) {
        let away = |one: &&GroundBox| {
            let known = self.examples.iter().filter(|example| example.is_one());
            let away = known.map(|known| {
                let [x, y] = [0, 1].map(|axis| known.place.centre[axis] - one.centre[axis]);
                x.hypot(y)
            });
            away.fold(f64::INFINITY, f64::min)
        };
        let place = *self
            .truth
            .iter()
            .max_by(|a, b| away(a).total_cmp(&away(b)))
            .unwrap();
        self.examples.push(Example {
            place,
            judgement: Judgement::Drawn,
        });
    }

    /// Accepts what lies on a box, moves what lies beside one onto it, rejects the rest.
    fn answer(&mut self, found: &[Hypothesis], picks: Picks, count: usize) {
        let mut random = SplitMix64(self.answers as u64);
        let mut picked: Vec<(u64, &Hypothesis)> = match picks {
            Picks::Questions => found
                .iter()
                .filter_map(|one| Some((one.question?.number as u64, one)))
                .collect(),
            Picks::Anything => found.iter().map(|one| (random.next(), one)).collect(),
        };
        picked.sort_by_key(|(order, _)| *order);
        for (_, one) in picked.into_iter().take(count) {
            let overlap = |bay: &&GroundBox| bay.overlap(&one.place);
            let nearest = self
                .truth
                .iter()
                .max_by(|a, b| overlap(a).total_cmp(&overlap(b)));
            let bay = nearest.unwrap();
            let (place, judgement) = match bay.overlap(&one.place) {
                0.8.. => (one.place, Judgement::Accepted),
                0.5.. => (*bay, Judgement::Drawn),
                _ => (one.place, Judgement::Rejected),
            };
            self.examples.push(Example { place, judgement });
            self.answers += 1;
        }
    }
}

/// What is held for one of the kind, by a person or by what was learnt, against the truth.
struct Judged {
    precision: f64,
    recall: f64,
    /// Median distance of what was learnt (m).
    median_m: f64,
    /// Within which nine of ten of these lie (m).
    most_m: f64,
    /// Median of the angles by which it is turned, whichever end is called its front (degrees).
    median_degrees: f64,
}

impl Judged {
    /// What is asked of a round.
    fn is_good(&self) -> bool {
        self.precision >= 0.97 && self.recall >= 0.95
    }
}

/// The angle between two boxes, whichever ends are called their fronts (degrees).
fn angle_degrees(one: &GroundBox, other: &GroundBox) -> f64 {
    let turn = (one.yaw - other.yaw).to_degrees().rem_euclid(180.0);
    turn.min(180.0 - turn)
}

fn judged(found: &[Hypothesis], truth: &[GroundBox], examples: &[Example]) -> Judged {
    let known = examples
        .iter()
        .filter(|one| one.is_one())
        .map(|one| one.place);
    let likely = found
        .iter()
        .filter(|one| one.probability > 0.5)
        .map(|one| one.place);
    let held: Vec<GroundBox> = known.chain(likely.clone()).collect();
    let is_right = |one: &&GroundBox| truth.iter().any(|bay| bay.overlap(one) >= 0.7);
    let is_found = |bay: &&GroundBox| held.iter().any(|one| bay.overlap(one) >= 0.7);
    let off = likely.filter_map(|one| {
        let bay = truth.iter().find(|bay| bay.overlap(&one) >= 0.7)?;
        let [x, y] = [0, 1].map(|axis| one.centre[axis] - bay.centre[axis]);
        Some((x.hypot(y), angle_degrees(&one, bay)))
    });
    let (mut off_m, turned): (Vec<f64>, Vec<f64>) = off.unzip();
    off_m.sort_by(f64::total_cmp);
    let most_m = off_m.get(off_m.len() * 9 / 10).copied();
    Judged {
        precision: held.iter().filter(is_right).count() as f64 / held.len().max(1) as f64,
        recall: truth.iter().filter(is_found).count() as f64 / truth.len() as f64,
        most_m: most_m.unwrap_or(0.0),
        median_m: median(off_m).unwrap_or(0.0),
        median_degrees: median(turned).unwrap_or(0.0),
    }
}

/// Answers of a round.
const ANSWERED: usize = 5;

/// Eight boxes are drawn in all, two at a time, and questions answered each time: what is held after each round.
fn rounds(name: &str, picture: &Picture, truth: &[GroundBox], picks: Picks) -> Vec<Judged> {
    let mosaic = picture.mosaic();
    let mut oracle = Oracle {
        truth,
        examples: Vec::new(),
        answers: 0,
    };
    let mut round = |round: usize| {
        if round < 4 {
            oracle.draw();
            oracle.draw();
        }
        let begun = std::time::Instant::now();
        let params = TeachingParams::default();
        let taught = Taught::learn(&mosaic, &oracle.examples, &params);
        let found = taught.unwrap().unwrap().find(&mosaic, &oracle.examples);
        let took = begun.elapsed();
        let judged = judged(&found, truth, &oracle.examples);
        eprintln!(
            "{name}, round {round}, {} answers: precision {:.3}, recall {:.3}, median {:.3} m, nine of ten {:.3} m, {:.2}°; {took:?}",
            oracle.answers,
            judged.precision,
            judged.recall,
            judged.median_m,
            judged.most_m,
            judged.median_degrees
        );
        if round < 4 {
            oracle.answer(&found, picks, ANSWERED);
        }
        judged
    };
    (0..5).map(&mut round).collect()
}

/// Sides of a space (m).
const SPACE_M: [f64; 2] = [5.0, 2.4];

/// Rows at an angle to the lane, and one across it.
fn angled() -> (Picture, Vec<GroundBox>) {
    let rows = [
        row([8.0, 22.0], 0.0, 60.0, 20, SPACE_M),
        row([8.0, 6.0], 0.0, -60.0, 20, SPACE_M),
        row([70.0, 5.0], 80.0, -90.0, 10, SPACE_M),
    ];
    let spaces = rows.concat();
    (painted(&spaces, [1800, 700], 2), spaces)
}

/// Spaces along a kerb, and others across the lane from it.
fn kerb() -> (Picture, Vec<GroundBox>) {
    let along = (0..12).map(|at| GroundBox {
        centre: [8.0 + 6.0 * f64::from(at), 4.0],
        yaw: 0.0,
        length_m: 6.0,
        width_m: 2.2,
    });
    let across = row([8.0, 16.0], 0.0, 90.0, 20, SPACE_M);
    let spaces: Vec<GroundBox> = along.chain(across).collect();
    (painted(&spaces, [1700, 500], 4), spaces)
}

/// A park of 164 spaces, as `evermap simulate car_park --set west_bays=17 --set east_bays=18` has them: along both walls, and
/// two rows back to back between two aisles.
fn park() -> (Picture, Vec<GroundBox>) {
    let rows = [(2.5, -90.0), (13.5, 90.0), (18.5, -90.0), (29.5, 90.0)];
    let rows = rows.map(|(y, lie)| row([7.0, y], 0.0, lie, 41, SPACE_M));
    let spaces = rows.concat();
    (painted(&spaces, [2260, 640], 6), spaces)
}

/// The floor of the stranger's empty park.
fn strangers() -> (Picture, Vec<GroundBox>) {
    let world = shared("worlds/carpark_small/truth").unwrap();
    let picture = Picture::read(&world.join("overhead_20ppm.png"));
    (picture, bays(&world.join("bays.geojson")))
}

/// How long each round takes is told on standard error.
#[test]
fn spaces_of_a_park_of_164_are_found() {
    let (picture, truth) = park();
    assert_eq!(truth.len(), 164);
    let rounds = rounds("park of 164", &picture, &truth, Picks::Questions);
    let last = rounds.last().unwrap();
    assert!(last.is_good() && rounds[2].median_m < 0.1);
}

#[test]
fn spaces_of_made_up_floors_are_found() {
    for (name, (picture, truth)) in [("angled", angled()), ("kerb", kerb())] {
        let rounds = rounds(name, &picture, &truth, Picks::Questions);
        let last = rounds.last().unwrap();
        assert!(last.is_good());
        // Halfway: later there is next to nothing left that nobody has spoken of.
        assert!(rounds[2].median_m < 0.1 && rounds[2].median_degrees < 2.0);
    }
}

#[test]
fn spaces_of_a_strangers_floor_are_found() {
    let (picture, truth) = strangers();
    let rounds = rounds("carpark_small", &picture, &truth, Picks::Questions);
    let last = rounds.last().unwrap();
    assert!(last.is_good() && rounds[2].median_m < 0.1 && rounds[2].median_degrees < 2.0);
}

/// After how many answers what is held is good, and stays so; a round more than there were where it never is, which is the
/// least that it can be.
fn answers_needed(rounds: &[Judged]) -> usize {
    let last_bad = rounds.iter().rposition(|one| !one.is_good());
    ANSWERED * last_bad.map_or(0, |round| round + 1)
}

#[test]
fn questions_need_a_third_fewer_answers_than_boxes_at_random() {
    let floors = [
        ("angled", angled()),
        ("kerb", kerb()),
        ("carpark_small", strangers()),
    ];
    let needed = |picks| -> usize {
        let floors = floors
            .iter()
            .map(|(name, (picture, truth))| answers_needed(&rounds(name, picture, truth, picks)));
        floors.sum()
    };
    let [few, many] = [Picks::Questions, Picks::Anything].map(needed);
    assert!(3 * few <= 2 * many, "{few} answers, {many} at random");
}

#[test]
fn parts_of_a_floor_teach_no_random_box_twice() {
    let spaces = row([8.0, 6.0], 0.0, 90.0, 60, SPACE_M);
    let mosaic = painted(&spaces, [3200, 300], 3).mosaic();
    assert_eq!(mosaic.parts().len(), 2);
    let examples = [0, 58].map(|at| Example {
        place: spaces[at],
        judgement: Judgement::Drawn,
    });
    let lesson = Lesson::new(&mosaic, &examples, &TeachingParams::default());
    let samples: Vec<Vec<u32>> = lesson
        .samples
        .iter()
        .map(|sample| sample.iter().map(|value| value.to_bits()).collect())
        .collect();
    let distinct: BTreeSet<&Vec<u32>> = samples.iter().collect();
    assert_eq!(distinct.len(), samples.len());
}

#[test]
fn what_is_learnt_is_the_same_of_the_tiles_that_are_read_alone() {
    let mut random = SplitMix64(11);
    let mut cell = |_| [0, 1].map(|_| (255.0 * random.unit()) as u8);
    let tiles: Vec<([i64; 2], Vec<[u8; 2]>)> = (-3..17)
        .map(|x| {
            let cells = (0..TILE_CELLS * TILE_CELLS).map(&mut cell);
            ([x, 2], cells.collect())
        })
        .collect();
    let tile_m = CELL_M * TILE_CELLS as f64;
    // On both sides of a border of parts, and in the middle of the second one.
    let examples = [
        (4.9, Judgement::Drawn),
        (5.1, Judgement::Rejected),
        (8.5, Judgement::Drawn),
    ];
    let examples = examples.map(|(tiles_east, judgement)| Example {
        place: GroundBox {
            centre: [tiles_east * tile_m, 2.5 * tile_m],
            yaw: 0.4,
            length_m: 5.0,
            width_m: 2.4,
        },
        judgement,
    });
    let mut counted = Mosaic::new(CELL_M);
    tiles.iter().for_each(|(tile, _)| counted.count_from(*tile));
    for (examples, expected) in [
        (&examples[..], -3..14),
        (&examples[..1], -3..6),
        (&examples[1..], 4..14),
        (&examples[..0], 0..0),
    ] {
        let (mut whole, mut some) = (counted.clone(), counted.clone());
        let is_read = Taught::reads(&counted, examples);
        let mut read = Vec::new();
        for (tile, cells) in &tiles {
            assert!(whole.add(*tile, cells.clone()));
            if is_read(*tile) {
                assert!(some.add(*tile, cells.clone()));
                read.push(tile[0]);
            }
        }
        assert_eq!(read, expected.collect::<Vec<i64>>());
        let learnt = |mosaic: &Mosaic| {
            let learnt = Taught::learn(mosaic, examples, &TeachingParams::default());
            learnt.unwrap()
        };
        assert_eq!(learnt(&some), learnt(&whole));
    }
}

#[test]
fn what_is_looked_at_at_a_time_is_bounded_whatever_cells_claim_to_measure() {
    let mut mosaic = Mosaic::new(1e-6);
    for tile in [[0, 0], [15, 15], [16, 0], [0, -9], [i64::from(i32::MAX), 7]] {
        assert!(mosaic.add(tile, vec![[0; 2]; TILE_CELLS * TILE_CELLS]));
    }
    // Parts are counted from the southernmost tile: rows -1 to 6 are one.
    let part = mosaic.part([0.0, -1e-6]);
    let near = mosaic.gradients(part, 140.0);
    assert_eq!([near.columns, near.rows], [TILE_CELLS, 10 * TILE_CELLS]);
    // Far beyond all numbers of tiles it is empty.
    let nowhere = mosaic.gradients(mosaic.part([-1e300, 1e300]), f64::INFINITY);
    assert_eq!([nowhere.columns, nowhere.rows], [0; 2]);
    // The largest box is described whole all the same.
    let longest_m = LONGEST_CELLS * CELL_M;
    let reach_m = 2.0 * reach_of(&[[longest_m; 2]]);
    assert!(reach_m <= MOST_BEYOND as f64 * CELL_M * TILE_CELLS as f64);
}

#[test]
fn nothing_is_learnt_where_nothing_was_seen() {
    let params = TeachingParams::default();
    let mosaic = Mosaic::new(CELL_M);
    let place = GroundBox {
        centre: [1e9, -1e9],
        yaw: 0.0,
        length_m: 5.0,
        width_m: 2.4,
    };
    let said =
        [Judgement::Drawn, Judgement::Rejected].map(|judgement| Example { place, judgement });
    assert_eq!(Taught::learn(&mosaic, &said, &params), Ok(None));
    assert_eq!(Taught::learn(&mosaic, &[], &params), Ok(None));
}

#[test]
fn boxes_overlap_as_squares_of_a_grid_do() {
    let square = |x: f64, yaw: f64| GroundBox {
        centre: [x, 0.0],
        yaw,
        length_m: 2.0,
        width_m: 2.0,
    };
    let one = square(0.0, 0.3);
    assert!((one.overlap(&one.turned()) - 1.0).abs() < 1e-12);
    assert!((square(0.0, 0.0).overlap(&square(1.0, 0.0)) - 1.0 / 3.0).abs() < 1e-12);
    assert_eq!(square(0.0, 0.0).overlap(&square(2.0, 0.0)), 0.0);
    // A square and the same turned by an eighth share a regular octagon.
    let octagon = 8.0 * (2.0_f64.sqrt() - 1.0);
    let expected = octagon / (8.0 - octagon);
    let turned = square(0.0, std::f64::consts::FRAC_PI_4);
    assert!((square(0.0, 0.0).overlap(&turned) - expected).abs() < 1e-12);
    // Of the smaller one, all or a half is covered, whichever is asked.
    let small = |x: f64| GroundBox {
        length_m: 1.0,
        width_m: 1.0,
        ..square(x, 0.0)
    };
    for (x, part) in [(0.0, 1.0), (0.5, 1.0), (1.0, 0.5), (1.5, 0.0), (9.0, 0.0)] {
        let covers = [
            square(0.0, 0.0).cover(&small(x)),
            small(x).cover(&square(0.0, 0.0)),
        ];
        assert!(
            covers.iter().all(|cover| (cover - part).abs() < 1e-12),
            "{x}: {covers:?}"
        );
    }
}
