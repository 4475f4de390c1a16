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
    /// For each station, the stretch that it is on.
    stretches: Vec<u32>,
    /// For each station, the junction that it is near, if any.
    junctions: Vec<u32>,
}

/// Junctions reach no farther along the street, metres.
const JUNCTION_M: f64 = 9.0;

impl Land {
    /// The land of a course and a plan.
    pub fn new(course: Course, plan: Plan) -> Self {
        let ways = (0..course.stations.len()).map(|index| index as f64 * course.step_m());
        let stretches = ways.map(|s| {
            let after = plan.stretches.partition_point(|stretch| stretch.to <= s);
            after.min(plan.stretches.len() - 1) as u32
        });
        let count = course.stations.len();
        let reach = (JUNCTION_M / course.step_m()).ceil() as usize;
        let mut junctions = vec![u32::MAX; count];
        for (index, junction) in plan.junctions.iter().enumerate() {
            let middle = (junction.s / course.step_m()) as usize + count;
            for station in middle - reach.min(count)..=middle + reach {
                junctions[station % count] = index as u32;
            }
        }
        Self {
            stretches: stretches.collect(),
            junctions,
            course,
            plan,
        }
    }

    fn station(&self, s: f64) -> usize {
        let station = (s.rem_euclid(self.course.length_m) / self.course.step_m()) as usize;
        station.min(self.stretches.len() - 1)
    }

    /// The stretch at a distance along the street, metres.
    pub fn stretch(&self, s: f64) -> &Stretch {
        let stretches = &self.plan.stretches;
        let index = self.stretches[self.station(s)] as usize;
        let over = s.rem_euclid(self.course.length_m) >= stretches[index].to;
        &stretches[(index + usize::from(over)) % stretches.len()]
    }

    /// The junction near a place along the street.
    fn junction(&self, s: f64) -> Option<&Junction> {
        self.plan
            .junctions
            .get(self.junctions[self.station(s)] as usize)
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
    pub fn class(&self, place: Frenet) -> Class {
        let stretch = self.stretch(place.s);
        let side = &stretch.sides[usize::from(place.d < 0.0)];
        let out = place.d.abs() - stretch.half_m;
        if out > side.parking_m {
            let aside = self
                .junction(place.s)
                .and_then(|junction| self.side_street(junction, place, out - side.parking_m));
            return aside.unwrap_or_else(|| beside(side, out));
        }
        self.carriageway(stretch, side, place, out)
    }

    /// How far a point along the street is before or after a junction, metres.
    fn ahead(&self, junction: &Junction, s: f64) -> f64 {
        let length = self.course.length_m;
        (s - junction.s + 0.5 * length).rem_euclid(length) - 0.5 * length
    }

    /// Whether a place is on the roadway of a side street; with `margin` metres around it.
    pub fn in_side_street(&self, place: Frenet, margin: f64) -> bool {
        self.junction(place.s).is_some_and(|junction| {
            junction.arms[usize::from(place.d < 0.0)]
                && place.d.abs() < SIDE_STREET_M + margin
                && self.ahead(junction, place.s).abs() < junction.half_m + margin
        })
    }

    /// The ground at a place `out` metres beyond the kerb, if it belongs to a side street.
    fn side_street(&self, junction: &Junction, place: Frenet, out: f64) -> Option<Class> {
        let ahead = self.ahead(junction, place.s);
        let aside = ahead.abs();
        let reached = junction.arms[usize::from(place.d < 0.0)] && place.d.abs() < SIDE_STREET_M;
        if !reached || aside > junction.half_m + SIDE_WALK_M {
            return None;
        }
        if aside > junction.half_m {
            return Some(Class::Sidewalk);
        }
        let zebra = junction.zebra && (1.0..3.6).contains(&out);
        // On the right half, as one comes out of the side street.
        let stop = !junction.zebra && (0.6..1.1).contains(&out) && ahead * place.d < 0.0;
        let painted = if zebra { striped(aside) } else { stop };
        Some(if painted {
            Class::GroundSign
        } else {
            Class::Road
        })
    }

    fn carriageway(&self, stretch: &Stretch, side: &Side, place: Frenet, out: f64) -> Class {
        let near_junction = self
            .junction(place.s)
            .is_some_and(|junction| self.ahead(junction, place.s).abs() < junction.half_m + 2.0);
        let on_zebra = |zebra: &f64| self.course.apart(place.s, *zebra) < ZEBRA_M;
        let painted = if stretch.zebras.iter().any(on_zebra) {
            striped(place.d)
        } else if out > -0.5 * LINE_M && side.parking_m > 0.0 {
            // Bays: a line along the lane and one across it every 6 m.
            !near_junction && (out < 0.5 * LINE_M || place.s.rem_euclid(6.0) < LINE_M)
        } else if near_junction {
            false
        } else {
            let from_edge = -out - 0.25;
            (stretch.edges && side.parking_m == 0.0 && (0.0..LINE_M).contains(&from_edge))
                || centre_line(stretch.line, place)
                || stretch.symbols.iter().any(|(at, left)| {
                    symbol(place, *at, if *left { 1.0 } else { -1.0 }, stretch.half_m)
                })
        };
        if painted {
            Class::GroundSign
        } else {
            Class::Road
        }
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
fn symbol(place: Frenet, at: f64, side: f64, half_m: f64) -> bool {
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
