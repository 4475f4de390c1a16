//! Spaces in bird's-eye views of real car parks, learnt from one half of each folder and looked for in the other.
//!
//! ```text
//! cargo run --release -p evermap-tests --example parking_views -- ../shared/data/parking_bev [--interleaved]
//! ```
//! Halves are the first and the last views by name, or every second one with `--interleaved`.
//!
//! The views (of that folder) show 10 m around a vehicle, so of most spaces the entrance alone; their truth is
//! the corners of entrances. A box reaches from half a metre before an entrance to a metre and a half behind it. Each view
//! is a tile of one overhead image, and the rest is what `box_models` and `box_hypotheses` do.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)]

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use evermap_algorithms::ground::boxes::GroundBox;
use evermap_algorithms::ground::boxes::mosaic::Mosaic;
use evermap_algorithms::ground::boxes::picture::Picture;
use evermap_algorithms::ground::boxes::teaching::{
    Example, Hypothesis, Judgement, Taught, TeachingParams,
};
use evermap_algorithms::ground::channels::Pixels;
use evermap_algorithms::ground::tiles::TILE_CELLS;
use evermap_vision::{Rgb, decode_colour};

/// Pixels of the views to a metre: 600 are 10 m.
const PIXELS_PER_M: f64 = 60.0;
/// Pixels to a side of a cell of the overhead image, which is 0.05 m.
const PIXELS_PER_CELL: usize = 3;
const CELL_M: f64 = PIXELS_PER_CELL as f64 / PIXELS_PER_M;
/// A box before an entrance and behind it (m).
const REACH_M: [f64; 2] = [0.5, 1.5];
/// Corners that are as far apart as this are those of one entrance (m).
const ENTRANCE_M: std::ops::Range<f64> = 1.8..4.0;
/// The vehicle in the middle of a view is black, as is what its cameras do not see.
const BLACK: usize = 3;

/// Views in a row of the overhead image.
const ROW: i64 = 8;

/// A view, and the corners of each entrance (px).
struct View {
    image: Rgb,
    entrances: Vec<[[f64; 2]; 2]>,
    /// Where the vehicle stands (px): spaces are entered from there.
    vehicle: [f64; 2],
}

fn image(path: &Path) -> Rgb {
    let mut rgb = Rgb::default();
    decode_colour(&fs::read(path).unwrap(), &mut rgb).unwrap();
    rgb
}

/// Views with boxes about corners (class 0) and about two corners of an entrance (class 1).
fn square_views(folder: &Path) -> Vec<View> {
    let lines = fs::read_to_string(folder.join("train_annotations.txt")).unwrap();
    let mut lines: Vec<&str> = lines.lines().collect();
    lines.sort_unstable();
    let view = |line: &&str| {
        let mut words = line.split_whitespace();
        let image = image(&folder.join("train").join(words.next().unwrap()));
        let boxes: Vec<Vec<f64>> = words
            .map(|word| word.split(',').map(|it| it.parse().unwrap()).collect())
            .collect();
        let of_class = |class: f64| boxes.iter().filter(move |it| it[4] == class);
        let corners: Vec<[f64; 2]> = of_class(0.0)
            .map(|it| [0.5 * (it[0] + it[2]), 0.5 * (it[1] + it[3])])
            .collect();
        let within = |it: &&Vec<f64>| {
            let is_in = |[x, y]: &&[f64; 2]| it[0] < *x && *x < it[2] && it[1] < *y && *y < it[3];
            let both: Vec<[f64; 2]> = corners.iter().filter(is_in).copied().collect();
            <[[f64; 2]; 2]>::try_from(both).ok()
        };
        let entrances = of_class(1.0).filter_map(|it| within(&it)).collect();
        View {
            image,
            entrances,
            vehicle: [300.0, 300.0],
        }
    };
    lines.iter().map(view).collect()
}

/// Views of what lies to the right of a vehicle, with the corners of entrances from front to rear.
fn strip_views(folder: &Path) -> Vec<View> {
    let files = fs::read_dir(folder.join("xml")).unwrap();
    let mut files: Vec<_> = files.map(|file| file.unwrap().path()).collect();
    files.sort();
    let view = |file: &PathBuf| {
        let text = fs::read_to_string(file).unwrap();
        let numbers = |tag: &str| -> Vec<f64> {
            let begin = format!("<{tag}>");
            let from = text.split(&begin).skip(1);
            from.map(|it| it.split('<').next().unwrap().parse().unwrap())
                .collect()
        };
        let mut corners: Vec<[f64; 2]> = numbers("x")
            .into_iter()
            .zip(numbers("y"))
            .map(|(x, y)| [x, y])
            .collect();
        corners.sort_by(|a, b| a[1].total_cmp(&b[1]));
        let name = file.with_extension("jpg");
        let image = image(&folder.join("images").join(name.file_name().unwrap()));
        View {
            image,
            entrances: corners.windows(2).map(|it| [it[0], it[1]]).collect(),
            vehicle: [0.0, 300.0],
        }
    };
    files.iter().map(view).collect()
}

/// Views side by side in one overhead image, with nothing between them: a tile is wider than a view.
struct Floor {
    mosaic: Mosaic,
    truth: Vec<GroundBox>,
}

impl Floor {
    fn of(views: &[View]) -> Self {
        let mut picture = Picture::new(CELL_M);
        let mut truth = Vec::new();
        for (number, view) in views.iter().enumerate() {
            let tile = [number as i64 % ROW, number as i64 / ROW];
            assert!(picture.add(tile, pixels(&view.image)));
            let side_m = CELL_M * TILE_CELLS as f64;
            let west_m = tile[0] as f64 * side_m;
            let north_m = (tile[1] + 1) as f64 * side_m;
            let to_map = |[x, y]: [f64; 2]| [west_m + x / PIXELS_PER_M, north_m - y / PIXELS_PER_M];
            let entrances = view.entrances.iter().map(|corners| corners.map(to_map));
            truth.extend(entrances.filter_map(|corners| entrance(corners, to_map(view.vehicle))));
        }
        Self {
            mosaic: picture.mosaic(),
            truth,
        }
    }

    /// What a person says who sees all of it: each entrance is drawn; what was found beside them, asked about or likely, is
    /// rejected, until nothing is found there any more, or four times.
    fn taught(&self) -> Taught {
        let truth = self.truth.iter();
        let mut examples: Vec<Example> = truth
            .map(|place| Example {
                place: *place,
                judgement: Judgement::Drawn,
            })
            .collect();
        let learn = |examples: &[Example]| {
            let taught = Taught::learn(&self.mosaic, examples, &TeachingParams::default());
            taught.unwrap().unwrap()
        };
        let mut taught = learn(&examples);
        for _ in 0..4 {
            let found = taught.find(&self.mosaic, &examples);
            let is_told = |one: &&Hypothesis| one.question.is_some() || one.probability > 0.5;
            let wrong = found.iter().filter(is_told);
            let wrong: Vec<GroundBox> = wrong.map(|one| one.place).collect();
            examples.extend(wrong.into_iter().map(|place| Example {
                place,
                judgement: Judgement::Rejected,
            }));
            taught = learn(&examples);
        }
        taught
    }

    /// Precision and recall of boxes, at an overlap of 0.7.
    fn judge(&self, found: &[GroundBox]) -> [f64; 2] {
        let share = |ones: &[GroundBox], of: &[GroundBox]| {
            let right = ones
                .iter()
                .filter(|one| of.iter().any(|other| other.overlap(one) >= 0.7));
            right.count() as f64 / ones.len().max(1) as f64
        };
        [share(found, &self.truth), share(&self.truth, found)]
    }
}

/// A view in cells, in the north-west corner of a tile.
fn pixels(image: &Rgb) -> Pixels {
    let cell = |at: usize| {
        let [column, row] = [at % TILE_CELLS, at / TILE_CELLS].map(|it| it * PIXELS_PER_CELL);
        let inside = column + PIXELS_PER_CELL <= image.width as usize
            && row + PIXELS_PER_CELL <= image.height as usize;
        if !inside {
            return [0; 4];
        }
        let mean = |channel: usize| {
            let rows = (row..row + PIXELS_PER_CELL).flat_map(|row| {
                let from = 3 * (row * image.width as usize + column);
                &image.data[from..from + 3 * PIXELS_PER_CELL]
            });
            let values = rows.skip(channel).step_by(3);
            let sum: usize = values.map(|value| usize::from(*value)).sum();
            (sum / (PIXELS_PER_CELL * PIXELS_PER_CELL)) as u8
        };
        let colour = [0, 1, 2].map(mean);
        let luma = [299, 587, 114].iter().zip(colour);
        let luma: usize = luma.map(|(part, value)| part * usize::from(value)).sum();
        let [red, green, blue] = colour;
        let is_seen = luma / 1000 > BLACK;
        [red, green, blue, if is_seen { 255 } else { 0 }]
    };
    Pixels::Colour((0..TILE_CELLS * TILE_CELLS).map(cell).collect())
}

/// The box about an entrance, entered from where the vehicle is; `None` where the corners are of no one entrance.
fn entrance([a, b]: [[f64; 2]; 2], vehicle: [f64; 2]) -> Option<GroundBox> {
    let along = [b[0] - a[0], b[1] - a[1]];
    let width_m = along[0].hypot(along[1]);
    let middle = [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])];
    let [mut x, mut y] = [-along[1] / width_m, along[0] / width_m];
    if x * (middle[0] - vehicle[0]) + y * (middle[1] - vehicle[1]) < 0.0 {
        [x, y] = [-x, -y];
    }
    let [before, behind] = REACH_M;
    let ahead = 0.5 * (behind - before);
    ENTRANCE_M.contains(&width_m).then_some(GroundBox {
        centre: [middle[0] + ahead * x, middle[1] + ahead * y],
        yaw: y.atan2(x),
        length_m: before + behind,
        width_m,
    })
}

/// Learns from one half and prints what it finds in the other, at a probability of a half and where precision and recall
/// have the highest harmonic mean, which no user can know.
fn learn_and_look(name: &str, learnt: &Floor, other: &Floor) {
    let begun = Instant::now();
    let mut found = learnt.taught().find(&other.mosaic, &[]);
    found.sort_by(|a, b| b.mean.total_cmp(&a.mean));
    let took_s = begun.elapsed().as_secs_f64();
    let places =
        |found: &[Hypothesis]| -> Vec<GroundBox> { found.iter().map(|one| one.place).collect() };
    let likely = found.partition_point(|one| one.probability > 0.5);
    let [precision, recall] = other.judge(&places(&found[..likely]));
    let best = (1..=found.len()).map(|count| other.judge(&places(&found[..count])));
    let mean =
        |[precision, recall]: &[f64; 2]| 2.0 * precision * recall / (precision + recall).max(1e-9);
    let best = best
        .max_by(|a, b| mean(a).total_cmp(&mean(b)))
        .unwrap_or_default();
    println!(
        "| {name} | {} | {} | {precision:.2} / {recall:.2} | {:.2} / {:.2} | {took_s:.0} |",
        learnt.truth.len(),
        other.truth.len(),
        best[0],
        best[1]
    );
}

fn main() {
    let mut arguments = std::env::args().skip(1);
    let folder = PathBuf::from(arguments.next().expect("expected the folder of views"));
    let interleaved = arguments.next().is_some_and(|it| it == "--interleaved");
    println!(
        "| views | entrances learnt | looked for | precision / recall | at the best threshold | s |"
    );
    println!("|---|---|---|---|---|---|");
    let folders = [
        ("square", square_views(&folder.join("ps2.0_demo/demo"))),
        ("strip", strip_views(&folder.join("rectangular_gq_R"))),
    ];
    for (name, views) in folders {
        let middle = views.len() / 2;
        let is_first = |at: usize| {
            if interleaved {
                at.is_multiple_of(2)
            } else {
                at < middle
            }
        };
        let (first, second): (Vec<_>, Vec<_>) = views
            .into_iter()
            .enumerate()
            .partition(|(at, _)| is_first(*at));
        let floors = [first, second]
            .map(|half| Floor::of(&half.into_iter().map(|(_, view)| view).collect::<Vec<_>>()));
        learn_and_look(name, &floors[0], &floors[1]);
        learn_and_look(name, &floors[1], &floors[0]);
    }
}
