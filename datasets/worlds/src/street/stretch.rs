//! What the street is like along its way: stretches between junctions, each with its own width,
//! sidewalks, markings, and kind of town on either side.

use super::course::{Course, Frenet};
use crate::random::{maybe, stream};
use rand::Rng;
use rand_chacha::ChaCha8Rng;

/// Depth of a side street, metres from the centre line.
pub const SIDE_STREET_M: f64 = 33.0;
/// Width of a parking lane, metres.
pub const PARKING_M: f64 = 2.1;

/// The kind of town beside the street.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quarter {
    /// Fronts without gaps.
    Terraces,
    /// Houses in gardens.
    Villas,
    /// Long high houses on lawns.
    Slabs,
    /// Halls behind paved yards.
    Shops,
    /// Trees and no houses.
    Park,
    /// Grass and hardly anything.
    Meadow,
}

const QUARTERS: [(Quarter, f64); 6] = [
    (Quarter::Terraces, 0.24),
    (Quarter::Villas, 0.26),
    (Quarter::Slabs, 0.15),
    (Quarter::Shops, 0.13),
    (Quarter::Park, 0.13),
    (Quarter::Meadow, 0.09),
];

/// One side of a stretch, from the carriageway outwards.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Side {
    /// What stands there.
    pub quarter: Quarter,
    /// Width of the parking lane, 0 without one, metres.
    pub parking_m: f64,
    /// Width of the green strip, metres.
    pub verge_m: f64,
    /// Width of the sidewalk, metres.
    pub walk_m: f64,
    /// Width of the paved yard behind it, metres.
    pub yard_m: f64,
    /// Distance between street trees, metres; 0 without.
    pub tree_step_m: f64,
    /// Which species these are.
    pub species: u8,
    /// Whether a lamp post stands every so often.
    pub lamps: bool,
}

/// The line in the middle of the carriageway.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CentreLine {
    /// Nothing.
    None,
    /// Dashes of 3 m every 9 m.
    Dashed,
    /// Without a gap.
    Solid,
}

/// A part of the street that looks the same along its length.
#[derive(Debug, Clone, PartialEq)]
pub struct Stretch {
    /// Where it begins along the centre line, metres.
    pub from: f64,
    /// Where it ends.
    pub to: f64,
    /// Half the width of the carriageway without parking lanes, metres.
    pub half_m: f64,
    /// The line in the middle.
    pub line: CentreLine,
    /// Lines along the edges.
    pub edges: bool,
    /// Left and right side.
    pub sides: [Side; 2],
    /// Middles of zebra crossings, metres along.
    pub zebras: Vec<f64>,
    /// Arrows and numbers on the right lane, metres along; and on the left.
    pub symbols: Vec<(f64, bool)>,
}

/// A side street, square to the street at the end of a stretch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Junction {
    /// Where, metres along.
    pub s: f64,
    /// To the left and to the right.
    pub arms: [bool; 2],
    /// Half the width of the side street, metres.
    pub half_m: f64,
    /// Zebra crossings over its mouths.
    pub zebra: bool,
}

/// All stretches and junctions, in order along the street.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Stretches without gaps.
    pub stretches: Vec<Stretch>,
    /// Side streets.
    pub junctions: Vec<Junction>,
}

impl Side {
    /// Distance from the edge of the carriageway to where private ground begins, metres.
    pub fn kerb_to_front(&self) -> f64 {
        self.parking_m + self.verge_m + self.walk_m
    }
}

impl Stretch {
    /// The side that a place is on.
    pub fn side(&self, place: Frenet) -> &Side {
        &self.sides[usize::from(place.d < 0.0)]
    }
}

impl Plan {
    /// The plan of a seed for a street of this length.
    pub fn new(seed: u64, course: &Course) -> Self {
        let mut rng = stream(seed, "stretches", 0);
        let cuts = cuts(course.length_m, &mut rng);
        let mut quarters = [pick(&mut rng), pick(&mut rng)];
        let mut plan = Self {
            stretches: Vec::new(),
            junctions: Vec::new(),
        };
        for ends in cuts.windows(2) {
            for quarter in &mut quarters {
                if rng.random_bool(0.6) {
                    *quarter = pick(&mut rng);
                }
            }
            let stretch = stretch(ends[0], ends[1], quarters, &mut rng);
            let bend = course.station(stretch.to).curvature.abs();
            if rng.random_bool(0.75) && bend < 0.02 {
                plan.junctions.push(junction(stretch.to, &mut rng));
            }
            plan.stretches.push(stretch);
        }
        plan
    }
}

/// Ends of the stretches, from 0 to the street's length.
fn cuts(length_m: f64, rng: &mut ChaCha8Rng) -> Vec<f64> {
    let mut cuts = vec![0.0];
    let mut at = 0.0;
    loop {
        at += rng.random_range(32.0..95.0);
        if at > length_m - 30.0 {
            cuts.push(length_m);
            return cuts;
        }
        cuts.push(at);
    }
}

fn pick(rng: &mut ChaCha8Rng) -> Quarter {
    let mut rest = rng.random_range(0.0..1.0);
    for (quarter, share) in QUARTERS {
        rest -= share;
        if rest < 0.0 {
            return quarter;
        }
    }
    Quarter::Villas
}

fn stretch(from: f64, to: f64, quarters: [Quarter; 2], rng: &mut ChaCha8Rng) -> Stretch {
    let sides = quarters.map(|quarter| side(quarter, rng));
    let line = match rng.random_range(0..10) {
        0..4 => CentreLine::None,
        4..8 => CentreLine::Dashed,
        _ => CentreLine::Solid,
    };
    let middle = rng.random_range(0.25..0.75);
    let zebras = if rng.random_bool(0.3) {
        vec![from + middle * (to - from)]
    } else {
        Vec::new()
    };
    let mut symbols = Vec::new();
    for left in [false, true] {
        if rng.random_bool(0.5) {
            let at = from + rng.random_range(0.1..0.9) * (to - from);
            symbols.push((at, left));
        }
    }
    Stretch {
        from,
        to,
        half_m: rng.random_range(2.8..3.9),
        line,
        edges: rng.random_bool(0.35),
        sides,
        zebras,
        symbols,
    }
}

fn side(quarter: Quarter, rng: &mut ChaCha8Rng) -> Side {
    let (walk, verge, parking, trees) = match quarter {
        Quarter::Terraces => (1.0, 0.15, 0.7, 0.25),
        Quarter::Villas => (0.8, 0.3, 0.5, 0.35),
        Quarter::Slabs => (0.9, 0.5, 0.7, 0.5),
        Quarter::Shops => (0.95, 0.3, 0.2, 0.2),
        Quarter::Park => (0.7, 0.5, 0.3, 0.5),
        Quarter::Meadow => (0.35, 0.6, 0.15, 0.4),
    };
    Side {
        quarter,
        walk_m: maybe(rng, walk, 1.4..3.4),
        verge_m: maybe(rng, verge, 0.9..2.4),
        parking_m: maybe(rng, parking, PARKING_M..PARKING_M + 1e-9),
        tree_step_m: maybe(rng, trees, 7.0..15.0),
        yard_m: match quarter {
            Quarter::Shops => maybe(rng, 1.0, 7.0..12.0),
            Quarter::Terraces => maybe(rng, 0.3, 1.0..3.0),
            _ => 0.0,
        },
        species: rng.random_range(0..5),
        lamps: rng.random_bool(0.75),
    }
}

fn junction(s: f64, rng: &mut ChaCha8Rng) -> Junction {
    let arms = match rng.random_range(0..5) {
        0 | 1 => [true, false],
        2 | 3 => [false, true],
        _ => [true, true],
    };
    Junction {
        s,
        arms,
        half_m: rng.random_range(2.4..3.4),
        zebra: rng.random_bool(0.4),
    }
}
