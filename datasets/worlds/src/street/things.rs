//! Things that stand along the street, and what they are made of.

use super::classes::Class;
use crate::plane::{Pose2, distance};
use crate::render::{Side, Solid, VisibleSolid, box_sides, nearest_first};
use nalgebra::Vector3;
use std::f64::consts::FRAC_PI_3;

/// What a surface looks like.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Finish {
    /// Walls with windows and doors.
    Facade,
    /// Tiles.
    Roof,
    /// Leaves.
    Leaves,
    /// Bark.
    Bark,
    /// One colour, a little dirty.
    Plain,
    /// A picture or letters.
    Board,
    /// Body of a car.
    Body,
    /// Windows of a car.
    Glass,
}

impl Finish {
    /// What a surface that looks like this counts as.
    pub fn class(self) -> Class {
        match self {
            Self::Facade | Self::Roof => Class::Building,
            Self::Leaves | Self::Bark => Class::Tree,
            Self::Plain => Class::Other,
            Self::Board => Class::Sign,
            Self::Body | Self::Glass => Class::Car,
        }
    }
}

/// The shape and size of a thing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape {
    /// A house: half width along the front, half depth, height of the walls, and of the roof above
    /// them (0 flat), metres.
    House([f64; 4]),
    /// A broadleaf tree: height, radius of the crown, height of the trunk, metres.
    Broadleaf([f64; 3]),
    /// A slim tree: height and radius.
    Poplar([f64; 2]),
    /// A conifer: height and radius at the bottom.
    Conifer([f64; 2]),
    /// A bush: height and radius.
    Bush([f64; 2]),
    /// Anything box-shaped (a hedge, a wall, a board on a house): half length, half width, from which height, to which
    /// height.
    Block(Finish, [f64; 4]),
    /// A board on a post: half width, half height, height of its middle; the board faces along x.
    Post([f64; 3]),
    /// A lamp post: height and reach of its arm.
    Lamp([f64; 2]),
    /// A car: length, width, height, and share of the length that the cabin takes.
    Car([f64; 4]),
}

/// A thing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Thing {
    /// Where it stands, and the direction of its x axis.
    pub pose: Pose2,
    /// What it is.
    pub shape: Shape,
    /// Chance's share in its look.
    pub seed: u32,
}

/// A surface as a ray may meet it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surface {
    /// Its look.
    pub finish: Finish,
    /// What it is a part of.
    pub thing: Thing,
    /// Centre of an ellipsoid in the map, metres, and its radii; for its normals.
    pub ball: Option<([f64; 3], [f64; 2])>,
}

/// Faces of every convex part: ±x, ±y, ±z and two more.
pub const FACES: u32 = 8;

/// A part of a thing, in the thing's frame, metres.
enum Primitive {
    /// Its sides, and the corners (low, high) of a box around it.
    Convex(Vec<Side>, [f64; 3], [f64; 3]),
    /// An upright ellipsoid: its centre, and its radii (horizontal, vertical).
    Ball([f64; 3], [f64; 2]),
}
use Primitive::{Ball, Convex};

/// What surrounds one eye (metres).
pub struct Stage {
    eye: [f64; 3],
    /// Face `f` is of surface `f / FACES`.
    pub surfaces: Vec<Surface>,
}

impl Stage {
    /// An empty one.
    pub fn new(eye: [f64; 3]) -> Self {
        Self {
            eye,
            surfaces: Vec::new(),
        }
    }

    /// The things that are near enough to be seen, but not the eye's own place, nearest first.
    pub fn with<'a>(&mut self, things: impl Iterator<Item = &'a Thing>) -> Vec<VisibleSolid> {
        let mut seen = Vec::new();
        for thing in things {
            let away = distance([self.eye[0], self.eye[1]], thing.pose.at());
            if away < thing.sight() + thing.reach() {
                self.put(thing, &mut seen);
            }
        }
        nearest_first(seen)
    }

    fn put(&mut self, thing: &Thing, seen: &mut Vec<VisibleSolid>) {
        let Pose2 { x, y, yaw } = thing.pose;
        let [ex, ey, ez] = self.eye;
        let stand = Pose2::new([x - ex, y - ey], yaw).upright(-ez);
        for (finish, part) in thing.parts() {
            let first = self.surfaces.len() as u32 * FACES;
            let (part, ball) = match part {
                Convex(sides, low, high) => {
                    let solid = Solid::new(&stand, &sides, low.into(), high.into());
                    (VisibleSolid::new(&solid, [0.0; 3], first), None)
                }
                Ball([ahead, left, up], radii) => {
                    let [x, y] = thing.pose.point([ahead, left]);
                    let from_eye = [x - ex, y - ey, up - ez].map(|part| part as f32);
                    let part =
                        VisibleSolid::ellipsoid(from_eye, radii.map(|radius| radius as f32), first);
                    (part, Some(([x, y, up], radii)))
                }
            };
            seen.extend(part);
            self.surfaces.push(Surface {
                finish,
                thing: *thing,
                ball,
            });
        }
    }
}

impl Thing {
    /// No part is farther from its place, metres.
    pub fn reach(&self) -> f64 {
        match self.shape {
            Shape::House([a, b, ..]) => a.hypot(b) + 0.6,
            Shape::Broadleaf([_, r, _]) | Shape::Poplar([_, r]) => 1.5 * r,
            Shape::Conifer([_, r]) | Shape::Bush([_, r]) => r,
            Shape::Block(_, [a, b, ..]) => a.hypot(b),
            Shape::Post([w, ..]) => w + 0.1,
            Shape::Lamp([_, arm]) => arm + 0.3,
            Shape::Car([a, b, ..]) => 0.5 * a.hypot(b),
        }
    }

    /// Farther away than this it is left out, metres.
    pub fn sight(&self) -> f64 {
        match self.shape {
            Shape::House(_) => 170.0,
            Shape::Broadleaf(_) | Shape::Poplar(_) | Shape::Conifer(_) => 130.0,
            Shape::Block(..) | Shape::Car(_) => 90.0,
            Shape::Bush(_) | Shape::Post(_) | Shape::Lamp(_) => 70.0,
        }
    }

    fn parts(&self) -> Vec<(Finish, Primitive)> {
        use Finish::{Board, Leaves, Plain};
        match self.shape {
            Shape::House(size) => house(size),
            Shape::Broadleaf(size) => broadleaf(size, self.seed),
            Shape::Poplar([height, radius]) => {
                let half = 0.5 * (height - 1.2);
                let crown = Ball([0.0, 0.0, 1.2 + half], [radius, half]);
                vec![trunk(0.12, 2.0), (Leaves, crown)]
            }
            Shape::Conifer([height, radius]) => {
                vec![trunk(0.12, 1.4), (Leaves, cone(height, radius))]
            }
            Shape::Bush([height, radius]) => {
                let crown = Ball([0.0, 0.0, 0.45 * height], [radius, 0.55 * height]);
                vec![(Leaves, crown)]
            }
            Shape::Block(finish, [a, b, low, high]) => {
                vec![(finish, cuboid([-a, -b, low], [a, b, high]))]
            }
            Shape::Post([half, tall, middle]) => {
                let post = cuboid([-0.06, -0.04, 0.0], [0.02, 0.04, middle]);
                let board = cuboid([0.02, -half, middle - tall], [0.05, half, middle + tall]);
                vec![(Plain, post), (Board, board)]
            }
            Shape::Lamp([height, arm]) => {
                let post = cuboid([-0.08, -0.08, 0.0], [0.08, 0.08, height]);
                let arm = cuboid([0.0, -0.12, height - 0.2], [arm, 0.12, height]);
                vec![(Plain, post), (Plain, arm)]
            }
            Shape::Car(size) => car(size),
        }
    }
}

fn cuboid(low: [f64; 3], high: [f64; 3]) -> Primitive {
    Convex(box_sides(low, high).to_vec(), low, high)
}

fn trunk(half: f64, height: f64) -> (Finish, Primitive) {
    let wood = cuboid([-half, -half, 0.0], [half, half, height]);
    (Finish::Bark, wood)
}

fn house([a, b, wall, roof]: [f64; 4]) -> Vec<(Finish, Primitive)> {
    let mut parts = vec![(Finish::Facade, cuboid([-a, -b, 0.0], [a, b, wall]))];
    if roof > 0.0 {
        // A gable along the front: two slopes with eaves.
        let (along, half) = (a + 0.35, b + 0.35);
        let offset = half * (wall + roof);
        let sides = vec![
            (Vector3::x(), along, 0),
            (-Vector3::x(), along, 1),
            (Vector3::new(0.0, roof, half), offset, 2),
            (Vector3::new(0.0, -roof, half), offset, 3),
            (-Vector3::z(), -wall, 5),
        ];
        let (low, high) = ([-along, -half, wall], [along, half, wall + roof]);
        parts.push((Finish::Roof, Convex(sides, low, high)));
    }
    parts
}

fn broadleaf([height, radius, wood]: [f64; 3], chance: u32) -> Vec<(Finish, Primitive)> {
    let half = 0.5 * (height - wood);
    let middle = wood + half;
    let crown = Ball([0.0, 0.0, middle], [radius, half]);
    let mut parts = vec![
        trunk(0.1 + 0.012 * height, wood + 0.8),
        (Finish::Leaves, crown),
    ];
    // Two or three smaller crowns beside the big one.
    for k in 0..2 + chance % 2 {
        let turn = f64::from(chance >> (8 * k) & 255) / 40.0;
        let (sin, cos) = turn.sin_cos();
        let out = 0.62 * radius;
        let up = middle + half * (0.5 * f64::from(k) - 0.45);
        let crown = Ball([out * cos, out * sin, up], [out, 0.5 * half]);
        parts.push((Finish::Leaves, crown));
    }
    parts
}

/// A pyramid of six sides that begins a metre above the ground.
fn cone(height: f64, radius: f64) -> Primitive {
    let low = 0.9;
    let mut sides: Vec<Side> = (0..6)
        .map(|k| {
            let turn = f64::from(k) * FRAC_PI_3;
            let (x, y) = ((height - low) * turn.cos(), (height - low) * turn.sin());
            (Vector3::new(x, y, radius), radius * height, 0)
        })
        .collect();
    sides.push((-Vector3::z(), -low, 5));
    let wide = 1.16 * radius;
    Convex(sides, [-wide, -wide, low], [wide, wide, height])
}

fn car([length, width, height, cabin]: [f64; 4]) -> Vec<(Finish, Primitive)> {
    let (a, b) = (0.5 * length, 0.5 * width);
    let belt = 0.58 * height;
    let wheels = |end: f64| {
        let (rear, front) = (end * a - 0.31, end * a + 0.31);
        cuboid([rear, -b - 0.02, 0.0], [front, b + 0.02, 0.62])
    };
    // The cabin: glass that leans in on all sides, from a little behind the middle.
    let (half, back) = (cabin * a, -0.08 * length);
    let (lean, rise) = (0.55, height - belt);
    let sides = vec![
        (Vector3::new(1.0, 0.0, lean), back + half + lean * belt, 0),
        (Vector3::new(-1.0, 0.0, lean), -back + half + lean * belt, 1),
        (Vector3::new(0.0, 1.0, 0.25), b - 0.04 + 0.25 * belt, 2),
        (Vector3::new(0.0, -1.0, 0.25), b - 0.04 + 0.25 * belt, 3),
        (Vector3::z(), belt + rise, 4),
    ];
    let cabin = Convex(sides, [back - half, -b, belt], [back + half, b, height]);
    vec![
        (Finish::Body, cuboid([-a, -b, 0.2], [a, b, belt])),
        (Finish::Glass, wheels(-0.62)),
        (Finish::Glass, wheels(0.62)),
        (Finish::Glass, cabin),
    ]
}
