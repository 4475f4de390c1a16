//! What the ground is at a place.

use super::classes::Class;
use super::course::{Course, Frenet};
use super::stretch::{CentreLine, Junction, Plan, SIDE_STREET_M, Side, Stretch};

/// Width of painted lines, metres.
const LINE_M: f64 = 0.14;
/// Half the length of a zebra crossing along the street, metres.
const ZEBRA_M: f64 = 1.7;
/// Stripes and gaps of zebra crossings, metres.
const STRIPE_M: f64 = 0.5;
/// Sidewalk along side streets, metres.
const SIDE_WALK_M: f64 = 1.6;

/// A point of the ground.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GroundPoint {
    /// What it is.
    pub class: Class,
    /// Where along and across the street it is, for its texture.
    pub place: Frenet,
}

/// Streets and what lies between.
#[derive(Debug, Clone, PartialEq)]
pub struct Land {
    /// The centre line.
    pub course: Course,
    /// What the street is like along it.
    pub plan: Plan,
}

/// Junctions reach no farther along the street, metres; less than the least distance between two of them.
const JUNCTION_M: f64 = 9.0;

impl Land {
    /// The stretch at a distance along the street, metres.
    pub fn stretch(&self, s: f64) -> &Stretch {
        let (s, stretches) = (s.rem_euclid(self.course.length_m), &self.plan.stretches);
        let index = stretches.partition_point(|stretch| stretch.to <= s);
        &stretches[index % stretches.len()]
    }

    /// The junction near a place along the street, and how far after it (negative: before it) that is, metres.
    fn junction(&self, s: f64) -> Option<(&Junction, f64)> {
        let length = self.course.length_m;
        let from = (s - JUNCTION_M).rem_euclid(length);
        let junctions = &self.plan.junctions;
        let after = junctions.partition_point(|junction| junction.s < from);
        let next = junctions.get(after).or(junctions.first())?;
        let ahead = (s - next.s + 0.5 * length).rem_euclid(length) - 0.5 * length;
        (ahead.abs() < JUNCTION_M).then_some((next, ahead))
    }

    /// The ground at a point, metres.
    pub fn at(&self, point: [f64; 2]) -> GroundPoint {
        match self.course.frenet(point) {
            Some(place) => GroundPoint {
                class: self.class(place),
                place,
            },
            None => GroundPoint {
                class: Class::Other,
                place: Frenet::new(0.0, 1e3),
            },
        }
    }

    /// The class of the ground at a place.
    fn class(&self, place: Frenet) -> Class {
        let stretch = self.stretch(place.s);
        let side = stretch.side(place);
        let out = place.d.abs() - stretch.half_m;
        if out <= side.parking_m {
            return road(self.painted(stretch, place, out));
        }
        let aside = self.side_street(place, out - side.parking_m);
        aside.unwrap_or_else(|| beside(side, out))
    }

    /// Whether a place is on the roadway of a side street; with `margin` metres around it.
    pub fn in_side_street(&self, place: Frenet, margin: f64) -> bool {
        self.junction(place.s).is_some_and(|(junction, ahead)| {
            junction.arms[usize::from(place.d < 0.0)]
                && place.d.abs() < SIDE_STREET_M + margin
                && ahead.abs() < junction.half_m + margin
        })
    }

    /// The ground at a place `out` metres beyond the kerb, if it belongs to a side street.
    fn side_street(&self, place: Frenet, out: f64) -> Option<Class> {
        let (junction, ahead) = self.junction(place.s)?;
        let aside = ahead.abs();
        let reached = junction.arms[usize::from(place.d < 0.0)] && place.d.abs() < SIDE_STREET_M;
        if !reached || aside > junction.half_m + SIDE_WALK_M {
            return None;
        }
        if aside > junction.half_m {
            return Some(Class::Sidewalk);
        }
        Some(road(if junction.zebra {
            (1.0..3.6).contains(&out) && striped(aside)
        } else {
            // On the right half, as one comes out of the side street.
            (0.6..1.1).contains(&out) && ahead * place.d < 0.0
        }))
    }

    /// Whether the carriageway is painted at a place `out` metres beyond its edge.
    fn painted(&self, stretch: &Stretch, place: Frenet, out: f64) -> bool {
        let parking = stretch.side(place).parking_m > 0.0;
        let near_junction = self
            .junction(place.s)
            .is_some_and(|(junction, ahead)| ahead.abs() < junction.half_m + 2.0);
        let on_zebra = |zebra: &f64| self.course.apart(place.s, *zebra) < ZEBRA_M;
        if stretch.zebras.iter().any(on_zebra) {
            striped(place.d)
        } else if near_junction {
            false
        } else if out > -0.5 * LINE_M && parking {
            // Bays: a line along the lane and one across it every 6 m.
            out < 0.5 * LINE_M || place.s.rem_euclid(6.0) < LINE_M
        } else {
            let on_edge = stretch.edges && !parking && (0.0..LINE_M).contains(&(-out - 0.25));
            let mut symbols = stretch.symbols.iter();
            let symbol = |(at, left): &(f64, bool)| symbol(place, *at, *left, stretch.half_m);
            on_edge || centre_line(stretch.line, place) || symbols.any(symbol)
        }
    }
}

fn road(painted: bool) -> Class {
    if painted {
        Class::GroundSign
    } else {
        Class::Road
    }
}

fn striped(across: f64) -> bool {
    across.rem_euclid(2.0 * STRIPE_M) < STRIPE_M
}

fn centre_line(line: CentreLine, place: Frenet) -> bool {
    let on = place.d.abs() < 0.5 * LINE_M;
    match line {
        CentreLine::None => false,
        CentreLine::Dashed => on && place.s.rem_euclid(9.0) < 3.0,
        CentreLine::Solid => on,
    }
}

/// An arrow in the middle of a lane that points where its traffic goes.
fn symbol(place: Frenet, at: f64, left: bool, half_m: f64) -> bool {
    let side = if left { 1.0 } else { -1.0 };
    let ahead = -(place.s - at) * side;
    let across = (place.d - 0.5 * side * half_m).abs();
    let shaft = (-1.6..0.6).contains(&ahead) && across < 0.12;
    let head = (0.6..1.8).contains(&ahead) && across < 0.5 * (1.8 - ahead);
    shaft || head
}

/// The ground `out` metres from the edge of the carriageway.
fn beside(side: &Side, out: f64) -> Class {
    let behind = out - side.parking_m - side.verge_m;
    let paved = behind >= 0.0 && behind < side.walk_m + side.yard_m;
    if paved { Class::Sidewalk } else { Class::Other }
}
