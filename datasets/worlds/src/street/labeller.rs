//! A labeller who errs as real ones do.
//!
//! Most of its mistakes hang together and many of them come back in the next shot, because what
//! misleads it is out there: things that look like something else, patches of wall or ground that
//! do. Others are the shot's own: boundaries a few pixels off, blobs, single pixels. How much of
//! each there is follows from one number, the severity, which is found so that the wanted share of
//! pixels is wrong on average over views along the street; single views are better or worse.

use super::classes::Class;
use super::course::Frenet;
use super::params::Street;
use super::sight::{PanoramaCamera, Scenery, Sight};
use crate::random::{lattice, noise2, noise3, scramble, smooth, stream};
use crate::render::{FAR, Lens, Scratch};
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
        let camera = PanoramaCamera::new(&small);
        let course = &scenery.land.course;
        let trials: Vec<(Sight, Vec<Class>)> = (0..TRIALS)
            .map(|k| {
                let s = (k as f64 + 0.5) / TRIALS as f64 * course.length_m;
                let [x, y] = course.point(Frenet::new(s, -1.5));
                let pose = Pose::from_yaw(x, y, course.yaw(s));
                let sight = scenery.look(&camera, &pose, &[], false, &mut Scratch::default());
                let exact = scenery.classes(&camera.lens, &sight, false);
                (sight, exact)
            })
            .collect();
        let (mut low, mut high) = (0.0, 8.0);
        for _ in 0..10 {
            self.severity = 0.5 * (low + high);
            let wrong: usize = trials
                .iter()
                .enumerate()
                .map(|(k, (sight, exact))| {
                    let noisy = self.noisy(&camera.lens, sight, exact, k as u64);
                    noisy.iter().zip(exact).filter(|(a, b)| a != b).count()
                })
                .sum();
            let pixels: usize = trials.iter().map(|(_, exact)| exact.len()).sum();
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

    /// The labels of one shot.
    pub fn noisy(&self, lens: &Lens, sight: &Sight, exact: &[Class], shot: u64) -> Vec<Class> {
        if self.severity == 0.0 {
            return exact.to_vec();
        }
        let scale = lens.width as f32 / 1024.0;
        let shot = scramble(self.seed ^ scramble(shot.wrapping_add(1)));
        let limits = Limits {
            patch: quantile(&self.space, PATCHES * self.severity),
            blob: quantile(&self.image, BLOBS * self.severity),
            thing: THINGS * self.severity,
            pixel: PIXELS * self.severity,
            shift: SHIFT_PX * self.severity.min(2.0) * scale,
        };
        let shifts = [1, 2].map(|axis| Field::new(lens, shot ^ axis, SHIFT_WAVE_PX * scale));
        let blobs = Field::new(lens, shot ^ 5, BLOB_PX * scale);
        let mut noisy = Vec::with_capacity(exact.len());
        for row in 0..lens.height {
            for column in 0..lens.width {
                let at = [column, row];
                let shift = shifts.each_ref().map(|field| field.at(at) - 0.5);
                let from = shifted(lens, at, shift.map(|part| 2.0 * limits.shift * part));
                let class = exact.get(from).copied().unwrap_or(Class::Other);
                let class = self.misled(lens, sight, from, class, &limits);
                let blob = blobs.at(at) > limits.blob;
                let coarse = at.map(|part| (part as f32 / (2.5 * BLOB_PX * scale)) as i64);
                noisy.push(if blob {
                    class.mistaken(lattice(shot ^ 6, coarse[0], coarse[1]))
                } else {
                    slip(class, at, shot, &limits)
                });
            }
        }
        noisy
    }

    /// What is out there misleads, from wherever it is seen.
    fn misled(
        &self,
        lens: &Lens,
        sight: &Sight,
        pixel: usize,
        class: Class,
        limits: &Limits,
    ) -> Class {
        let range = sight.hits.range_m[pixel];
        if let Some(surface) = sight.surface(sight.hits.face[pixel]) {
            let chance = |number: i64| lattice(self.seed, i64::from(surface.seed), number);
            if chance(1) < limits.thing {
                return class.mistaken(chance(2));
            }
        }
        let ray = sight.eye.turned(lens.ray(pixel));
        let point = if range < FAR {
            [0, 1, 2].map(|axis| sight.eye.at[axis] as f32 + range * ray[axis])
        } else {
            ray.map(|part| 14.0 * part)
        };
        if noise3(self.seed, point.map(|part| part / PATCH_M)) <= limits.patch {
            return class;
        }
        let coarse = point.map(|part| (part / (3.0 * PATCH_M)).floor() as i64);
        class.mistaken(lattice(
            self.seed ^ 3,
            coarse[0] ^ coarse[2] << 40,
            coarse[1],
        ))
    }
}

/// From which values of the noises on there are mistakes.
struct Limits {
    patch: f32,
    blob: f32,
    thing: f32,
    pixel: f32,
    shift: f32,
}

/// Smooth noise over an image, as [`noise2`] makes it, with the lattice's values at hand.
struct Field {
    wave_px: f32,
    columns: usize,
    values: Vec<f32>,
}

impl Field {
    fn new(lens: &Lens, seed: u64, wave_px: f32) -> Self {
        let columns = (lens.width as f32 / wave_px) as usize + 2;
        let rows = (lens.height as f32 / wave_px) as usize + 2;
        let value = |k: usize| lattice(seed, (k % columns) as i64, (k / columns) as i64);
        Self {
            wave_px,
            columns,
            values: (0..columns * rows).map(value).collect(),
        }
    }

    fn at(&self, pixel: [usize; 2]) -> f32 {
        let place = pixel.map(|part| part as f32 / self.wave_px);
        let [column, row] = place.map(|part| part as usize);
        let f = place.map(|part| smooth(part.fract()));
        let value = |k: usize| self.values.get(k).copied().unwrap_or(0.5);
        let first = row * self.columns + column;
        let mix = |a: f32, b: f32, f: f32| a + f * (b - a);
        let upper = mix(value(first), value(first + 1), f[0]);
        let next = first + self.columns;
        mix(upper, mix(value(next), value(next + 1), f[0]), f[1])
    }
}

/// The pixel whose label is written here.
fn shifted(lens: &Lens, [column, row]: [usize; 2], shift: [f32; 2]) -> usize {
    let column = (column as f32 + shift[0]).round() as i64;
    let row = (row as f32 + shift[1]).round() as i64;
    let column = column.rem_euclid(lens.width as i64) as usize;
    let row = row.clamp(0, lens.height as i64 - 1) as usize;
    row * lens.width + column
}

/// Single pixels that are wrong.
fn slip(class: Class, [column, row]: [usize; 2], shot: u64, limits: &Limits) -> Class {
    let chance = lattice(shot ^ 8, column as i64, row as i64);
    if chance < limits.pixel {
        return class.mistaken(chance / limits.pixel);
    }
    class
}

/// The value that a share of the values is above.
fn quantile(sorted: &[f32], above: f32) -> f32 {
    let rank = ((1.0 - above.clamp(0.0, 1.0)) * sorted.len() as f32) as usize;
    sorted.get(rank).copied().unwrap_or(f32::MAX)
}
