//! A labeller who errs as real ones do.
//!
//! Most of its mistakes hang together and many of them come back in the next shot, because what
//! misleads it is out there: things that look like something else, patches of wall or ground that
//! do. Some of that misleads at every visit, some only in the light of one. Others are the shot's
//! own: boundaries a few pixels off, blobs, single pixels. How much of each there is follows from
//! one number, the severity, which is found so that the wanted share of pixels is wrong on average
//! over views along the street; single views are better or worse.

use super::classes::Class;
use super::course::Frenet;
use super::params::Street;
use super::sight::{Scenery, Sight, panorama_camera};
use crate::random::{lattice, noise2, noise3, scramble, stream};
use crate::render::{FAR, Lens};
use evermap_algorithms::geometry::pose::Pose;
use rand::Rng;

/// At severity 1: share of the world's surface that is taken for something else in patches.
const PATCHES: f32 = 0.07;
/// Size of these patches, metres.
const PATCH_M: f32 = 2.2;
/// Share of the things that are taken for something else as a whole.
const THINGS: f32 = 0.05;
/// Share of an image in blobs of its own.
const BLOBS: f32 = 0.035;
/// Size of these blobs at a width of 1024, pixels.
const BLOB_PX: f32 = 20.0;
/// Share of single pixels.
const PIXELS: f32 = 0.012;
/// How far boundaries are shifted at a width of 1024, pixels, at most.
const SHIFT_PX: f32 = 9.0;
/// Distance over which that shift changes, pixels.
const SHIFT_WAVE_PX: f32 = 26.0;
/// Views that severity is found on, and their width, pixels.
const TRIALS: usize = 8;
const TRIAL_PX: u32 = 192;

/// A labeller of one world.
#[derive(Debug, Clone, PartialEq)]
pub struct Labeller {
    seed: u64,
    severity: f32,
    /// Share of what misleads that does so at every visit.
    repeated: f32,
    /// Sorted values of the noise in space and in the image: quantiles.
    space: Vec<f32>,
    image: Vec<f32>,
}

impl Labeller {
    /// A labeller who errs on `world.label_noise` of the pixels.
    pub fn new(world: &Street, scenery: &Scenery) -> Self {
        let mut rng = stream(world.seed, "labeller", 0);
        let mut sample = |noise: &dyn Fn([f32; 3]) -> f32| {
            let mut values: Vec<f32> = (0..4096)
                .map(|_| noise([0.0; 3].map(|_: f32| rng.random_range(-500.0..500.0))))
                .collect();
            values.sort_by(f32::total_cmp);
            values
        };
        let mut labeller = Self {
            seed: scramble(world.seed ^ 0x1abe1),
            severity: 0.0,
            repeated: world.repeated_mistakes as f32,
            space: sample(&|p| noise3(7, p)),
            image: sample(&|[x, y, _]| noise2(7, [x, y].map(f64::from))),
        };
        labeller.find_severity(world, scenery);
        labeller
    }

    fn find_severity(&mut self, world: &Street, scenery: &Scenery) {
        let small = Street {
            width_px: TRIAL_PX,
            height_px: (TRIAL_PX * world.height_px / world.width_px).max(16),
            ..world.clone()
        };
        let (lens, _) = panorama_camera(&small);
        let course = &scenery.land.course;
        let trials = (0..TRIALS).map(|k| {
            let s = (k as f64 + 0.5) / TRIALS as f64 * course.length_m;
            let [x, y] = course.point(Frenet::new(s, -1.5));
            let sight = scenery.look(&lens, &Pose::from_yaw(x, y, course.yaw(s)), &[]);
            let exact = scenery.classes(&sight, &sight.hits);
            (sight, exact)
        });
        let trials: Vec<(Sight<'_>, Vec<Class>)> = trials.collect();
        let (mut low, mut high) = (0.0, 8.0);
        for _ in 0..10 {
            self.severity = 0.5 * (low + high);
            let (mut wrong, mut pixels) = (0, 0);
            for (k, (sight, exact)) in trials.iter().enumerate() {
                let noisy = self.noisy(sight, exact, [0, k]);
                wrong += noisy.iter().zip(exact).filter(|(a, b)| a != b).count();
                pixels += exact.len();
            }
            if (wrong as f64) < world.label_noise * pixels as f64 {
                low = self.severity;
            } else {
                high = self.severity;
            }
        }
        if world.label_noise == 0.0 {
            self.severity = 0.0;
        }
    }

    /// The labels of one shot: of which visit, and its number there.
    pub fn noisy(
        &self,
        sight: &Sight<'_>,
        exact: &[Class],
        [visit, index]: [usize; 2],
    ) -> Vec<Class> {
        if self.severity == 0.0 {
            return exact.to_vec();
        }
        let width = sight.lens.width;
        let scale = width as f32 / 1024.0;
        let shot = (visit as u64) << 40 | index as u64;
        let shot = scramble(self.seed ^ scramble(shot.wrapping_add(1)));
        let limits = Limits {
            misleads: self.misleads(visit),
            blob: quantile(&self.image, BLOBS * self.severity),
            pixel: PIXELS * self.severity,
            shift: SHIFT_PX * self.severity.min(2.0) * scale,
        };
        let noise = |purpose: u64, at: [usize; 2], wave_px: f32| {
            let place = at.map(|part| f64::from(part as f32 / (wave_px * scale)));
            noise2(shot ^ purpose, place)
        };
        let label = |pixel: usize| {
            let at = [pixel % width, pixel / width];
            let shift = [1, 2].map(|axis| noise(axis, at, SHIFT_WAVE_PX) - 0.5);
            let from = shifted(sight.lens, at, shift.map(|part| 2.0 * limits.shift * part));
            let misleads = limits.misleads.iter();
            let mut mistaken =
                misleads.filter_map(|misleads| misleads.class(sight, from, exact[from]));
            let class = mistaken.next().unwrap_or(exact[from]);
            if noise(5, at, BLOB_PX) > limits.blob {
                let coarse = at.map(|part| (part as f32 / (2.5 * BLOB_PX * scale)) as i64);
                return class.mistaken(lattice(shot ^ 6, coarse[0], coarse[1]));
            }
            // Single pixels.
            match lattice(shot ^ 8, at[0] as i64, at[1] as i64) {
                chance if chance < limits.pixel => class.mistaken(chance / limits.pixel),
                _ => class,
            }
        };
        (0..exact.len()).map(label).collect()
    }

    /// What misleads at every visit, and what does at this one.
    fn misleads(&self, visit: usize) -> [Misleading; 2] {
        let of = |seed: u64, share: f32| Misleading {
            seed,
            patch: quantile(&self.space, PATCHES * self.severity * share),
            thing: THINGS * self.severity * share,
        };
        let own = scramble(self.seed ^ scramble(visit as u64 ^ 0x5eed));
        [of(self.seed, self.repeated), of(own, 1.0 - self.repeated)]
    }
}

/// What is out there and misleads, from wherever it is seen.
struct Misleading {
    seed: u64,
    /// From which value of the noise in space on a patch misleads.
    patch: f32,
    /// Share of the things that mislead as a whole.
    thing: f32,
}

impl Misleading {
    /// What a pixel is taken for; `None` for what it is.
    fn class(&self, sight: &Sight<'_>, pixel: usize, class: Class) -> Option<Class> {
        let hit = sight.hit(&sight.hits, pixel);
        if let Some(surface) = sight.surface(hit.face) {
            let chance = |number| lattice(self.seed, i64::from(surface.thing.seed), number);
            if chance(1) < self.thing {
                return Some(class.mistaken(chance(2)));
            }
        }
        let point = if hit.range_m < FAR {
            [0, 1, 2].map(|axis| sight.eye.at[axis] as f32 + hit.range_m * hit.ray[axis])
        } else {
            hit.ray.map(|part| 14.0 * part)
        };
        if noise3(self.seed, point.map(|part| part / PATCH_M)) <= self.patch {
            return None;
        }
        let [x, y, z] = point.map(|part| (part / (3.0 * PATCH_M)).floor() as i64);
        Some(class.mistaken(lattice(self.seed ^ 3, x ^ z << 40, y)))
    }
}

/// From which values of the noises on there are mistakes.
struct Limits {
    misleads: [Misleading; 2],
    blob: f32,
    pixel: f32,
    shift: f32,
}

/// The pixel whose label is written here.
fn shifted(lens: &Lens, [column, row]: [usize; 2], shift: [f32; 2]) -> usize {
    let column = (column as f32 + shift[0]).round() as i64;
    let row = (row as f32 + shift[1]).round() as i64;
    let column = column.rem_euclid(lens.width as i64) as usize;
    let row = row.clamp(0, lens.height as i64 - 1) as usize;
    row * lens.width + column
}

/// The value that a share of the values is above.
fn quantile(sorted: &[f32], above: f32) -> f32 {
    let rank = ((1.0 - above.clamp(0.0, 1.0)) * sorted.len() as f32) as usize;
    sorted.get(rank).copied().unwrap_or(f32::MAX)
}
