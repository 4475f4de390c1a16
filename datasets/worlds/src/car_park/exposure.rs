//! A session's camera settings and sensor noise.

use super::CarPark;
use crate::random::{normal, stream};
use crate::render::PIXELS;
use rand::Rng;

const TABLE: usize = 1 << 16;

/// Exposure, lens shading and noise of one session.
#[derive(Debug, Clone)]
pub struct Exposure {
    /// Grey value of darkness.
    pub black: f32,
    gain: f32,
    vignette: f32,
    read_noise: f32,
    shot_noise: f32,
    noise: Vec<f32>,
}

impl Exposure {
    /// The exposure of a session.
    pub fn of_session(world: &CarPark, session: usize) -> Self {
        let mut rng = stream(world.seed, "look", session as u64);
        Self {
            black: rng.random_range(4.0..9.0),
            gain: rng.random_range(1.05..1.35),
            vignette: rng.random_range(0.28..0.42),
            read_noise: rng.random_range(0.9..1.5),
            shot_noise: rng.random_range(0.006..0.011),
            noise: (0..TABLE + PIXELS)
                .map(|_| normal(&mut rng).clamp(-4.0, 4.0) as f32)
                .collect(),
        }
    }

    /// Brightness of the lens at an angle from its axis, radians.
    #[inline(always)]
    pub fn at(&self, theta: f32) -> f32 {
        let edge = theta * std::f32::consts::FRAC_2_PI;
        self.gain * (1.0 - self.vignette * edge * edge * edge * edge)
    }

    /// Standard deviation of the noise on a grey value.
    #[inline(always)]
    pub fn noise_at(&self, value: f32) -> f32 {
        self.read_noise + self.shot_noise * value
    }

    /// Standard normal numbers, chosen by `seed`.
    pub fn noise(&self, seed: u64) -> &[f32; PIXELS] {
        let numbers = self.noise[(seed as usize) % TABLE..].first_chunk();
        numbers.unwrap_or(&[0.0; PIXELS])
    }
}
