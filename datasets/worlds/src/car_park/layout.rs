//! Where everything in the hall stands.
//!
//! ```text
//!   y                     north row of bays          [utility]
//!   ^   NW ------------ NC --------------------- NE
//!   |   |   west island |      east island       |   east
//!   |   |   (2 rows)    |      (2 rows)          |   row
//!   |   SW ------------ SC --------------------- SE
//!   |     south row     |gate|   south row           [utility]
//!   +--------------------------------------------------> x
//! ```
//! Map frame: x east, y north, z up, metres; the origin is the hall's south-west corner, at the
//! height of the drain that runs along x through the middle. At SC four ways meet: the gate's drive crosses the south aisle.

use super::CarPark;
use crate::plane::Pose2;
use crate::vehicle::Ground;
use std::f64::consts::{FRAC_PI_2, PI};

/// Width of an aisle, metres.
pub const AISLE_M: f64 = 6.0;
/// Width of a bay, metres.
pub const BAY_WIDTH_M: f64 = 2.4;
/// Depth of a bay, metres.
pub const BAY_DEPTH_M: f64 = 5.0;
/// Width of the hatched walkway at each end of an island, metres.
pub const NOSE_M: f64 = 1.5;
/// Height of the ceiling, metres.
pub const CEILING_M: f64 = 2.9;
/// Width of painted lines, metres.
pub const LINE_M: f64 = 0.12;

/// An axis-aligned rectangle on the floor, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rect {
    /// West edge.
    pub x0: f64,
    /// South edge.
    pub y0: f64,
    /// East edge.
    pub x1: f64,
    /// North edge.
    pub y1: f64,
}

impl Rect {
    /// From its edges.
    pub fn new(x0: f64, y0: f64, x1: f64, y1: f64) -> Self {
        Self { x0, y0, x1, y1 }
    }

    /// Its middle.
    pub fn centre(&self) -> [f64; 2] {
        [0.5 * (self.x0 + self.x1), 0.5 * (self.y0 + self.y1)]
    }
}

/// A parking bay.
#[derive(Debug, Clone, PartialEq)]
pub struct Bay {
    /// Painted on the floor; unique.
    pub label: String,
    /// Its ground.
    pub rect: Rect,
    /// Heading of a car that drives in forwards, radians.
    pub entry_yaw: f64,
}

impl Bay {
    /// Its middle, and how a car drives into it forwards.
    pub fn entry(&self) -> Pose2 {
        Pose2::new(self.rect.centre(), self.entry_yaw)
    }
}

/// A zebra crossing, with the walk that uses it.
#[derive(Debug, Clone, PartialEq)]
pub struct Crossing {
    /// The striped ground.
    pub rect: Rect,
    /// Where walkers wait on the island's side.
    pub island: [f64; 2],
    /// Where walkers wait on the wall's side.
    pub wall: [f64; 2],
}

/// A meeting of aisles, or the gate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Node {
    /// South-west corner.
    SW,
    /// Four ways: gate, south aisle (both sides), cross aisle.
    SC,
    /// South-east corner.
    SE,
    /// North-west corner.
    NW,
    /// Three ways: north aisle (both sides), cross aisle.
    NC,
    /// North-east corner.
    NE,
    /// The roller door in the south wall.
    Gate,
}

use Node::{Gate, NC, NE, NW, SC, SE, SW};

/// All nodes, in the order in which the truth lists them.
pub const NODES: [Node; 7] = [SW, SC, SE, NW, NC, NE, Gate];

/// All aisles, as pairs of nodes.
pub const AISLES: [(Node, Node); 8] = [
    (SW, SC),
    (SC, SE),
    (NW, NC),
    (NC, NE),
    (SW, NW),
    (SC, NC),
    (SE, NE),
    (Gate, SC),
];

/// The hall, drawn to scale.
#[derive(Debug, Clone, PartialEq)]
pub struct Layout {
    /// Inner width (x), metres.
    pub width_m: f64,
    /// Inner depth (y), metres.
    pub depth_m: f64,
    /// The shape of the floor.
    pub ground: Ground,
    /// Ground of the western and the eastern island.
    pub islands: [Rect; 2],
    /// Closed rooms in the eastern corners.
    pub rooms: [Rect; 2],
    /// All bays.
    pub bays: Vec<Bay>,
    /// All zebra crossings.
    pub crossings: Vec<Crossing>,
    /// Ground of the pillars.
    pub pillars: Vec<Rect>,
    /// Middles of the lamps' tubes (each 1.5 m along x).
    pub lamps: Vec<[f64; 2]>,
    /// Middles (x) of the ceiling's beams, which run along y.
    pub beams: Vec<f64>,
}

impl Layout {
    /// The layout for these parameters.
    pub fn new(world: &CarPark) -> Self {
        let island = |x0: f64, bays: usize| {
            let x1 = x0 + 2.0 * NOSE_M + bays as f64 * BAY_WIDTH_M;
            let y0 = BAY_DEPTH_M + AISLE_M;
            Rect::new(x0, y0, x1, y0 + 2.0 * BAY_DEPTH_M)
        };
        let west = island(AISLE_M, world.west_bays);
        let east = island(west.x1 + AISLE_M, world.east_bays);
        let width_m = east.x1 + AISLE_M + BAY_DEPTH_M;
        let depth_m = 4.0 * BAY_DEPTH_M + 2.0 * AISLE_M;
        let mut layout = Self {
            width_m,
            depth_m,
            ground: Ground {
                drain_y: 0.5 * depth_m,
                slope: world.floor_slope,
            },
            islands: [west, east],
            rooms: [0.0, depth_m - BAY_DEPTH_M]
                .map(|y| Rect::new(width_m - BAY_DEPTH_M, y, width_m, y + BAY_DEPTH_M)),
            bays: Vec::new(),
            crossings: Vec::new(),
            pillars: Vec::new(),
            lamps: Vec::new(),
            beams: Vec::new(),
        };
        layout.add_bays();
        layout.add_crossings();
        layout.add_pillars();
        layout.add_ceiling();
        layout
    }

    /// Where a node lies, metres.
    pub fn node(&self, node: Node) -> [f64; 2] {
        let (south, north) = (
            BAY_DEPTH_M + 0.5 * AISLE_M,
            self.depth_m - BAY_DEPTH_M - 0.5 * AISLE_M,
        );
        let (west, cross) = (0.5 * AISLE_M, self.islands[0].x1 + 0.5 * AISLE_M);
        let east = self.islands[1].x1 + 0.5 * AISLE_M;
        match node {
            SW => [west, south],
            SC => [cross, south],
            SE => [east, south],
            NW => [west, north],
            NC => [cross, north],
            NE => [east, north],
            Gate => [cross, 1.6],
        }
    }

    fn add_bays(&mut self) {
        let [west, east] = self.islands;
        let (top, end) = (self.depth_m - BAY_DEPTH_M, self.width_m - BAY_DEPTH_M);
        let (north, south) = (FRAC_PI_2, -FRAC_PI_2);
        let inner = |island: Rect| (island.x0 + NOSE_M, island.x1 - NOSE_M);
        // Letter, western and eastern end, south edge, and which way one drives in.
        let rows = [
            ('A', (0.1, west.x1 - NOSE_M), 0.0, south),
            ('B', (east.x0 + 0.1, end), 0.0, south),
            ('C', inner(west), west.y0, north),
            ('D', inner(west), west.centre()[1], south),
            ('E', inner(east), east.y0, north),
            ('F', inner(east), east.centre()[1], south),
            ('G', (0.1, east.x0), top, north),
            ('H', (east.x0 + NOSE_M + 0.1, end), top, north),
        ];
        for (letter, (x0, x1), y0, entry_yaw) in rows {
            let count = ((x1 - x0) / BAY_WIDTH_M + 1e-6).floor() as usize;
            for k in 0..count {
                let x0 = x0 + k as f64 * BAY_WIDTH_M;
                let rect = Rect::new(x0, y0, x0 + BAY_WIDTH_M, y0 + BAY_DEPTH_M);
                self.add_bay(letter, k, rect, entry_yaw);
            }
        }
        let count = ((top - BAY_DEPTH_M) / BAY_WIDTH_M).floor() as usize;
        for k in 0..count {
            let y0 = BAY_DEPTH_M + 0.2 + k as f64 * BAY_WIDTH_M;
            let rect = Rect::new(end, y0, self.width_m, y0 + BAY_WIDTH_M);
            self.add_bay('K', k, rect, 0.0);
        }
    }

    fn add_bay(&mut self, letter: char, k: usize, rect: Rect, entry_yaw: f64) {
        self.bays.push(Bay {
            label: format!("{letter}{}", k + 1),
            rect,
            entry_yaw,
        });
    }

    fn add_crossings(&mut self) {
        let [west, east] = self.islands;
        let (south, north) = (BAY_DEPTH_M, self.depth_m - BAY_DEPTH_M);
        let x = west.x1 - 0.5 * NOSE_M;
        self.crossings.push(Crossing {
            rect: Rect::new(west.x1 - NOSE_M, south, west.x1, south + AISLE_M),
            island: [x, west.y0 + 1.2],
            wall: [x, 1.2],
        });
        let x = east.x0 + 0.5 * NOSE_M;
        self.crossings.push(Crossing {
            rect: Rect::new(east.x0, north - AISLE_M, east.x0 + NOSE_M, north),
            island: [x, east.y1 - 1.2],
            wall: [x, self.depth_m - 1.2],
        });
    }

    fn add_pillars(&mut self) {
        let pillar = |x: f64, y: f64| Rect::new(x - 0.2, y - 0.25, x + 0.2, y + 0.25);
        let pillars = &mut self.pillars;
        for island in self.islands {
            let bays = ((island.x1 - island.x0 - 2.0 * NOSE_M) / BAY_WIDTH_M).round() as usize;
            for k in (0..=bays).step_by(2) {
                let x = island.x0 + NOSE_M + k as f64 * BAY_WIDTH_M;
                pillars.push(pillar(x, island.centre()[1]));
            }
        }
        let far = self.depth_m - BAY_DEPTH_M;
        for y in [BAY_DEPTH_M - 0.5, far + 0.5] {
            let step = 3.0 * BAY_WIDTH_M;
            let west = (1..).map(|k| 0.1 + f64::from(3 * k) * BAY_WIDTH_M);
            let west = west.take_while(|x| *x <= self.islands[0].x1 - NOSE_M);
            pillars.extend(west.map(|x| pillar(x, y)));
            let mut x = self.islands[1].x0 + if y < far { 0.1 } else { NOSE_M + 0.1 } + step;
            while x < self.width_m - BAY_DEPTH_M - 0.5 {
                pillars.push(pillar(x, y));
                x += step;
            }
        }
    }

    fn add_ceiling(&mut self) {
        let rows = [
            0.5 * BAY_DEPTH_M,
            self.node(SC)[1],
            0.5 * self.depth_m,
            self.node(NC)[1],
            self.depth_m - 0.5 * BAY_DEPTH_M,
        ];
        let columns = (self.width_m / 5.5).round().max(2.0) as usize;
        let pitch = self.width_m / columns as f64;
        for y in rows {
            let lamps = (0..columns).map(|k| [(k as f64 + 0.5) * pitch, y]);
            self.lamps.extend(lamps);
        }
        self.beams = (1..columns).map(|k| k as f64 * pitch).collect();
    }
}

/// Whether the pose heading `yaw` is along y rather than x.
pub fn runs_along_y(yaw: f64) -> bool {
    let turned = yaw.rem_euclid(PI);
    (turned - FRAC_PI_2).abs() < 0.25 * PI
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;

    fn apart(a: &Rect, b: &Rect) -> bool {
        let gap = 1e-9;
        a.x1 <= b.x0 + gap || b.x1 <= a.x0 + gap || a.y1 <= b.y0 + gap || b.y1 <= a.y0 + gap
    }

    #[test]
    fn nothing_overlaps_at_any_size() {
        for (west_bays, east_bays) in [(1, 1), (2, 4), (7, 3)] {
            let layout = Layout::new(&CarPark {
                west_bays,
                east_bays,
                ..CarPark::default()
            });
            assert!(layout.bays.len() > 20);
            let hall = Rect::new(0.0, 0.0, layout.width_m, layout.depth_m);
            for (i, a) in layout.bays.iter().enumerate() {
                assert!(a.rect.x0 >= hall.x0 && a.rect.x1 <= hall.x1 + 1e-9);
                for b in &layout.bays[i + 1..] {
                    assert!(apart(&a.rect, &b.rect), "{} on {}", a.label, b.label);
                    assert_ne!(a.label, b.label);
                }
                for crossing in &layout.crossings {
                    assert!(apart(&a.rect, &crossing.rect));
                }
                for room in &layout.rooms {
                    assert!(apart(&a.rect, room), "{} in a room", a.label);
                }
            }
        }
    }
}
