//! How much the overhead image is like the floor of the empty car park.

use std::io::Cursor;
use std::path::Path;

use evermap_algorithms::geometry::pose::Pose;
use evermap_tests::trajectories::{Trajectories, poses, truth_from_map};
use evermap_tests::{evermap, text};
use nalgebra::Vector3;
use serde_json::Value;

/// Correlation of grey values with the true floor.
#[derive(Debug)]
pub(crate) struct Likeness {
    /// Within 2 m of where the first drive passed, outside of bays.
    pub(crate) aisles: f64,
    /// In bays, whatever stood in them.
    pub(crate) bays: f64,
}

/// A picture with its grey values and whether they are known, north on top.
struct Picture {
    width: usize,
    height: usize,
    grey: Vec<u8>,
    known: Vec<bool>,
}

impl Picture {
    fn read(path: &Path) -> Self {
        let mut reader = png::Decoder::new(Cursor::new(std::fs::read(path).unwrap()));
        reader.set_transformations(png::Transformations::EXPAND | png::Transformations::STRIP_16);
        let mut reader = reader.read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        let frame = reader.next_frame(&mut bytes).unwrap();
        let samples = frame.color_type.samples();
        let pixels = bytes[..frame.buffer_size()].chunks_exact(samples);
        let known = |pixel: &[u8]| samples % 2 == 1 || pixel[samples - 1] > 0;
        Self {
            width: frame.width as usize,
            height: frame.height as usize,
            grey: pixels.clone().map(|pixel| pixel[0]).collect(),
            known: pixels.map(known).collect(),
        }
    }

    /// Grey value of the pixel around a place, `[column, row]`.
    fn at(&self, [column, row]: [f64; 2]) -> Option<u8> {
        let inside = |place: f64, size: usize| {
            let nearest = place.round();
            (nearest >= 0.0 && nearest < size as f64).then_some(nearest as usize)
        };
        let pixel = inside(row, self.height)? * self.width + inside(column, self.width)?;
        self.known[pixel].then(|| self.grey[pixel])
    }
}

/// Whether a place is in a convex outline, whose corners go either way round.
fn inside(corners: &[[f64; 2]], [x, y]: [f64; 2]) -> bool {
    let sides = corners.windows(2).map(|side| {
        let [from, to] = [side[0], side[1]];
        (to[0] - from[0]) * (y - from[1]) - (to[1] - from[1]) * (x - from[0])
    });
    let (mut left, mut right) = (true, true);
    for side in sides {
        left &= side >= 0.0;
        right &= side <= 0.0;
    }
    left || right
}

fn bays(world: &Path) -> Vec<Vec<[f64; 2]>> {
    let file = std::fs::read_to_string(world.join("truth/bays.geojson")).unwrap();
    let file: Value = serde_json::from_str(&file).unwrap();
    let ring = |bay: &Value| {
        let corners = bay["geometry"]["coordinates"][0].as_array().unwrap();
        let corner = |corner: &Value| [0, 1].map(|k| corner[k].as_f64().unwrap());
        corners.iter().map(corner).collect()
    };
    file["features"]
        .as_array()
        .unwrap()
        .iter()
        .map(ring)
        .collect()
}

fn correlation(pairs: &[[f64; 2]]) -> f64 {
    let count = pairs.len() as f64;
    let mean = [0, 1].map(|k| pairs.iter().map(|pair| pair[k]).sum::<f64>() / count);
    let product = |a: usize, b: usize| -> f64 {
        let of = |pair: &[f64; 2]| (pair[a] - mean[a]) * (pair[b] - mean[b]);
        pairs.iter().map(of).sum()
    };
    product(0, 1) / (product(0, 0) * product(1, 1)).sqrt()
}

/// The overhead image of a map's newest version beside the true floor.
pub(crate) fn likeness(name: &str, world: &Path, map: &Path, truths: &Trajectories) -> Likeness {
    let picture = map.with_extension("floor.png");
    let out = ["--format", "png", "--local", "--out", text(&picture)];
    evermap(&[&["export", "overhead_tiles", "--map", text(map)], &out[..]].concat()).expect(0);
    let placed = std::fs::read_to_string(picture.with_extension("pgw")).unwrap();
    let placed: Vec<f64> = placed.lines().map(|line| line.parse().unwrap()).collect();
    let found = Picture::read(&picture);
    let truth = Picture::read(&world.join("truth/overhead_20ppm.png"));
    let map_from_truth =
        truth_from_map(&poses(map, None, "poses", "map_from_vehicle"), truths).inverse();
    let bays = bays(world);
    let driven = truths["initial"].iter().map(|at| at.pose.translation.xy());
    let driven: Vec<_> = driven.collect();
    let (mut in_aisles, mut in_bays) = (Vec::new(), Vec::new());
    for row in (0..truth.height).step_by(2) {
        for column in (0..truth.width).step_by(2) {
            let place = [
                (column as f64 + 0.5) / 20.0,
                (truth.height as f64 - row as f64 - 0.5) / 20.0,
            ];
            let Some(grey) = shown(&found, &placed, &map_from_truth, place) else {
                continue;
            };
            let pair = [grey, f64::from(truth.grey[row * truth.width + column])];
            let near = |at: &nalgebra::Vector2<f64>| (at.x - place[0]).hypot(at.y - place[1]) < 2.0;
            if bays.iter().any(|bay| inside(bay, place)) {
                in_bays.push(pair);
            } else if driven.iter().any(near) {
                in_aisles.push(pair);
            }
        }
    }
    let likeness = Likeness {
        aisles: correlation(&in_aisles),
        bays: correlation(&in_bays),
    };
    eprintln!("floor after {name}: {likeness:.4?}");
    likeness
}

/// What the image shows of a place of the true map, metres.
fn shown(found: &Picture, placed: &[f64], map_from_truth: &Pose, [x, y]: [f64; 2]) -> Option<f64> {
    let spot = map_from_truth.transform(&Vector3::new(x, y, 0.0));
    let pixel = [
        (spot.x - placed[4]) / placed[0],
        (spot.y - placed[5]) / placed[3],
    ];
    found.at(pixel).map(f64::from)
}
