//! Things that stand along the street, and what they are made of.

use super::classes::Class;
use crate::plane::Pose2;
use crate::render::{Seen, Side, Solid};
use evermap_algorithms::geometry::pose::Pose;
use nalgebra::Vector3;

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
    /// A hedge: half length, half thickness, height.
    Hedge([f64; 3]),
    /// Anything box-shaped: half length, half width, from which height, to which height.
    Block([f64; 4]),
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
    /// What most of it counts as.
    pub class: Class,
    /// Chance's share in its look.
    pub seed: u32,
}

/// A surface as a ray may meet it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surface {
    /// Its class.
    pub class: Class,
    /// Its look.
    pub finish: Finish,
    /// The thing's chance.
    pub seed: u32,
    /// Where the thing stands, and the direction of its x axis.
    pub pose: Pose2,
    /// Centre of an ellipsoid, metres, and its radii; for its normals.
    pub ball: Option<([f64; 3], [f64; 2])>,
}

/// Faces of every convex part: ±x, ±y, ±z and two more.
pub const FACES: u32 = 8;

/// What surrounds one eye: solids to meet, and what their faces are.
#[derive(Default)]
pub struct Stage {
    /// To be met.
    pub seen: Vec<Seen>,
    /// Face `f` is of surface `f / FACES`.
    pub surfaces: Vec<Surface>,
}

impl Thing {
    /// No part is farther from its place, metres.
    pub fn reach(&self) -> f64 {
        match self.shape {
            Shape::House([a, b, ..]) => a.hypot(b) + 0.6,
            Shape::Broadleaf([_, r, _]) | Shape::Poplar([_, r]) => 1.5 * r,
            Shape::Conifer([_, r]) | Shape::Bush([_, r]) => r,
            Shape::Hedge([a, b, _]) | Shape::Block([a, b, ..]) => a.hypot(b),
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
            Shape::Hedge(_) | Shape::Block(_) | Shape::Car(_) => 90.0,
            Shape::Bush(_) | Shape::Post(_) | Shape::Lamp(_) => 70.0,
        }
    }

    /// Puts the thing on a stage around `eye`, metres.
    pub fn stand(&self, eye: [f64; 3], stage: &mut Stage) {
        let mut hands = Hands {
            thing: self,
            eye,
            stage,
        };
        let class = self.class;
        match self.shape {
            Shape::House(size) => hands.house(size),
            Shape::Broadleaf(size) => hands.broadleaf(size),
            Shape::Poplar([height, radius]) => {
                hands.trunk(0.12, 2.0);
                let half = 0.5 * (height - 1.2);
                hands.ball(
                    class,
                    Finish::Leaves,
                    [0.0, 0.0, 1.2 + half],
                    [radius, half],
                );
            }
            Shape::Conifer([height, radius]) => {
                hands.trunk(0.12, 1.4);
                hands.cone(height, radius);
            }
            Shape::Bush([height, radius]) => {
                let half = 0.55 * height;
                hands.ball(
                    class,
                    Finish::Leaves,
                    [0.0, 0.0, 0.45 * height],
                    [radius, half],
                );
            }
            Shape::Hedge([a, b, height]) => {
                hands.cuboid(class, Finish::Leaves, [-a, -b, 0.0], [a, b, height]);
            }
            Shape::Block([a, b, low, high]) => {
                let finish = if class == Class::Sign {
                    Finish::Board
                } else {
                    Finish::Plain
                };
                hands.cuboid(class, finish, [-a, -b, low], [a, b, high]);
            }
            Shape::Post([half, tall, middle]) => {
                hands.cuboid(
                    Class::Other,
                    Finish::Plain,
                    [-0.06, -0.04, 0.0],
                    [0.02, 0.04, middle],
                );
                let (low, high) = ([0.02, -half, middle - tall], [0.05, half, middle + tall]);
                hands.cuboid(class, Finish::Board, low, high);
            }
            Shape::Lamp([height, arm]) => {
                hands.cuboid(
                    class,
                    Finish::Plain,
                    [-0.08, -0.08, 0.0],
                    [0.08, 0.08, height],
                );
                let (low, high) = ([0.0, -0.12, height - 0.2], [arm, 0.12, height]);
                hands.cuboid(class, Finish::Plain, low, high);
            }
            Shape::Car(size) => hands.car(size),
        }
    }
}

/// Puts parts of one thing on the stage.
struct Hands<'a> {
    thing: &'a Thing,
    eye: [f64; 3],
    stage: &'a mut Stage,
}

impl Hands<'_> {
    /// Declares a surface and gives the number of its first face.
    fn surface(&mut self, class: Class, finish: Finish, ball: Option<([f64; 3], [f64; 2])>) -> u32 {
        self.stage.surfaces.push(Surface {
            class,
            finish,
            seed: self.thing.seed,
            pose: self.thing.pose,
            ball,
        });
        (self.stage.surfaces.len() as u32 - 1) * FACES
    }

    /// The thing's frame as seen from the eye.
    fn frame(&self) -> Pose {
        let Pose2 { x, y, yaw } = self.thing.pose;
        let [ex, ey, ez] = self.eye;
        Pose2::new([x - ex, y - ey], yaw).upright(-ez)
    }

    fn convex(
        &mut self,
        class: Class,
        finish: Finish,
        sides: &[Side],
        low: [f64; 3],
        high: [f64; 3],
    ) {
        let solid = Solid::new(&self.frame(), sides, low.into(), high.into());
        let first = self.surface(class, finish, None);
        self.stage.seen.extend(Seen::new(&solid, [0.0; 3], first));
    }

    fn cuboid(&mut self, class: Class, finish: Finish, low: [f64; 3], high: [f64; 3]) {
        self.convex(class, finish, &box_sides(low, high), low, high);
    }

    /// An upright ellipsoid, placed in the thing's frame.
    fn ball(&mut self, class: Class, finish: Finish, centre: [f64; 3], radii: [f64; 2]) {
        let [x, y] = self.thing.pose.point([centre[0], centre[1]]);
        let middle = [x, y, centre[2]];
        let first = self.surface(class, finish, Some((middle, radii)));
        let from_eye = [0, 1, 2].map(|axis| (middle[axis] - self.eye[axis]) as f32);
        let radii = radii.map(|radius| radius as f32);
        self.stage
            .seen
            .extend(Seen::ellipsoid(from_eye, radii, first));
    }

    fn trunk(&mut self, half: f64, height: f64) {
        let (low, high) = ([-half, -half, 0.0], [half, half, height]);
        self.cuboid(self.thing.class, Finish::Bark, low, high);
    }

    fn house(&mut self, [a, b, wall, roof]: [f64; 4]) {
        let class = self.thing.class;
        self.cuboid(class, Finish::Facade, [-a, -b, 0.0], [a, b, wall]);
        if roof > 0.0 {
            // A gable along the front: two slopes with eaves.
            let (eave, half) = (0.35, b + 0.35);
            let slope = Vector3::new(0.0, roof, half);
            let other = Vector3::new(0.0, -roof, half);
            let offset = half * (wall + roof);
            let sides: [Side; 5] = [
                (Vector3::x(), a + eave, 0),
                (-Vector3::x(), a + eave, 1),
                (slope, offset, 2),
                (other, offset, 3),
                (-Vector3::z(), -wall, 5),
            ];
            let (low, high) = ([-a - eave, -half, wall], [a + eave, half, wall + roof]);
            self.convex(class, Finish::Roof, &sides, low, high);
        }
    }

    fn broadleaf(&mut self, [height, radius, trunk]: [f64; 3]) {
        let class = self.thing.class;
        self.trunk(0.1 + 0.012 * height, trunk + 0.8);
        let half = 0.5 * (height - trunk);
        let middle = trunk + half;
        self.ball(class, Finish::Leaves, [0.0, 0.0, middle], [radius, half]);
        // Two or three smaller crowns beside the big one.
        let chance = self.thing.seed;
        for k in 0..2 + chance % 2 {
            let turn = f64::from(chance >> (8 * k) & 255) / 40.0;
            let (sin, cos) = turn.sin_cos();
            let out = 0.62 * radius;
            let up = middle + half * (0.5 * f64::from(k) - 0.45);
            let radii = [0.62 * radius, 0.5 * half];
            self.ball(class, Finish::Leaves, [out * cos, out * sin, up], radii);
        }
    }

    /// A pyramid of six sides that begins a metre above the ground.
    fn cone(&mut self, height: f64, radius: f64) {
        let low = 0.9;
        let mut sides: Vec<Side> = (0..6)
            .map(|k| {
                let turn = f64::from(k) * std::f64::consts::FRAC_PI_3;
                let normal = Vector3::new(
                    (height - low) * turn.cos(),
                    (height - low) * turn.sin(),
                    radius,
                );
                (normal, radius * height, 0)
            })
            .collect();
        sides.push((-Vector3::z(), -low, 5));
        let wide = 1.16 * radius;
        let (from, to) = ([-wide, -wide, low], [wide, wide, height]);
        self.convex(self.thing.class, Finish::Leaves, &sides, from, to);
    }

    fn car(&mut self, [length, width, height, cabin]: [f64; 4]) {
        let class = self.thing.class;
        let (a, b) = (0.5 * length, 0.5 * width);
        let belt = 0.58 * height;
        self.cuboid(class, Finish::Body, [-a, -b, 0.2], [a, b, belt]);
        for end in [-0.62, 0.62] {
            let (low, high) = (
                [end * a - 0.31, -b - 0.02, 0.0],
                [end * a + 0.31, b + 0.02, 0.62],
            );
            self.cuboid(class, Finish::Glass, low, high);
        }
        // The cabin: glass that leans in on all sides, from a little behind the middle.
        let (half, back) = (cabin * a, -0.08 * length);
        let lean = 0.55;
        let rise = height - belt;
        let sides: [Side; 5] = [
            (Vector3::new(1.0, 0.0, lean), back + half + lean * belt, 0),
            (Vector3::new(-1.0, 0.0, lean), -back + half + lean * belt, 1),
            (Vector3::new(0.0, 1.0, 0.25), b - 0.04 + 0.25 * belt, 2),
            (Vector3::new(0.0, -1.0, 0.25), b - 0.04 + 0.25 * belt, 3),
            (Vector3::z(), belt + rise, 4),
        ];
        let (low, high) = ([back - half, -b, belt], [back + half, b, height]);
        self.convex(class, Finish::Glass, &sides, low, high);
    }
}

fn box_sides(low: [f64; 3], high: [f64; 3]) -> [Side; 6] {
    [
        (Vector3::x(), high[0], 0),
        (-Vector3::x(), -low[0], 1),
        (Vector3::y(), high[1], 2),
        (-Vector3::y(), -low[1], 3),
        (Vector3::z(), high[2], 4),
        (-Vector3::z(), -low[2], 5),
    ]
}

/// The outward normal of a box-like part's face in the map.
pub fn face_normal(surface: &Surface, face: u32) -> Vector3<f64> {
    let own = match face {
        0 => Vector3::x(),
        1 => -Vector3::x(),
        2 => Vector3::y(),
        3 => -Vector3::y(),
        5 => -Vector3::z(),
        _ => Vector3::z(),
    };
    surface.pose.upright(0.0).rotate(&own)
}
