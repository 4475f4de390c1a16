//! Everything one session's cameras can see, ready to be looked at.

use super::CarPark;
use super::canvas::Canvas;
use super::cars::{CAR_SCALE, CarViews, ParkedCar, car_solids, paint_car};
use super::floor;
use super::layout::{AISLE_M, CEILING_M, Layout, Rect};
use super::lighting::Lighting;
use super::texture::Texture;
use super::visit::Visit;
use super::walkers::Walker;
use super::walls::{
    WALL_SCALE, light_wall, paint_ceiling, paint_concrete, paint_pillar, paint_wall, roller_door,
};
use crate::random::stream;
use crate::render::Solid;
use crate::vehicle::Ground;
use evermap_algorithms::geometry::pose::Pose;
use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;

/// A painted face: how map coordinates become texels, and how brightly it is lit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Face {
    /// Index into the scene's textures.
    pub texture: u16,
    /// Factor on the texture's grey.
    pub light: f32,
    /// Texel column = `u[0] x + u[1] y + u[2] z + u[3]`.
    pub u: [f32; 4],
    /// Texel row, likewise.
    pub v: [f32; 4],
}

/// The scene of one session.
#[derive(Debug, Clone)]
pub struct Scene {
    /// Pictures.
    pub textures: Vec<Texture>,
    /// Faces 0 to 5 are floor, ceiling, south, north, west and east wall.
    pub faces: Vec<Face>,
    /// All that does not move.
    pub solids: Vec<Solid>,
    /// Inner size of the hall, metres.
    pub room: [f32; 3],
    /// The shape of its floor.
    pub ground: Ground,
    /// For each walker: the faces of coat, trousers and head.
    pub walker_faces: Vec<[u16; 3]>,
}

/// A texture axis: a direction in the map (per metre) and the texel at the map's origin.
fn axis(direction: [f64; 3], scale: f64, origin: [f64; 3]) -> [f32; 4] {
    let d = direction.map(|part| part * scale);
    let offset = -(d[0] * origin[0] + d[1] * origin[1] + d[2] * origin[2]);
    [d[0] as f32, d[1] as f32, d[2] as f32, offset as f32]
}

/// A wall: where its lower left corner is, which way is right as seen from inside the hall, and its length.
type WallPlace = (char, [f64; 2], [f64; 2], f64);

impl Scene {
    /// Builds the scene of a session on the floor of [`floor::paint_floor`].
    pub fn build(world: &CarPark, layout: &Layout, empty_floor: &Canvas, visit: &Visit) -> Self {
        let session = visit.session.index;
        let lighting = Lighting::of_session(world, layout, session);
        let room = [layout.width_m, layout.depth_m, CEILING_M];
        let mut scene = Self {
            textures: Vec::new(),
            faces: Vec::new(),
            solids: Vec::new(),
            room: room.map(|side| side as f32),
            ground: layout.ground,
            walker_faces: Vec::new(),
        };
        let mut spots = stream(world.seed, "spots", session as u64);
        let mut ground = empty_floor.clone();
        floor::stains(&mut ground, layout, 14, &mut spots);
        scene.add_level(lighting.on_floor(&ground, &visit.parked));
        let mut rng = stream(world.seed, "walls", 0);
        scene.add_level(paint_ceiling(layout, &lighting, &mut rng));
        scene.add_walls(layout, &lighting, &mut rng);
        scene.add_rooms(layout, &lighting, &mut rng);
        scene.add_pillars(layout, &lighting, &mut rng);
        scene.add_beams(layout, &mut rng);
        for car in &visit.parked {
            scene.add_car(car, &lighting);
        }
        for person in &visit.walkers {
            let faces = person.greys.map(|grey| scene.plain(grey, 0.85));
            scene.walker_faces.push(faces);
        }
        scene
    }

    /// The solids of the walkers at an instant.
    pub fn walkers_at(&self, people: &[Walker], t: f64) -> Vec<Solid> {
        let pairs = people.iter().zip(&self.walker_faces);
        pairs
            .flat_map(|(person, faces)| person.solids(t, &self.ground, *faces))
            .collect()
    }

    fn texture(&mut self, texture: Texture) -> u16 {
        self.textures.push(texture);
        (self.textures.len() - 1) as u16
    }

    fn face(&mut self, texture: u16, light: f64, u: [f32; 4], v: [f32; 4]) -> u16 {
        let light = light as f32;
        self.faces.push(Face {
            texture,
            light,
            u,
            v,
        });
        (self.faces.len() - 1) as u16
    }

    fn painted(&mut self, canvas: Canvas, light: f64, u: [f32; 4], v: [f32; 4]) -> u16 {
        let texture = self.texture(canvas.into_texture());
        self.face(texture, light, u, v)
    }

    fn plain(&mut self, grey: u8, light: f64) -> u16 {
        let texture = self.texture(Texture::plain(grey));
        self.face(texture, light, [0.0; 4], [0.0; 4])
    }

    fn add_box(&mut self, low: [f64; 3], high: [f64; 3], faces: [u16; 6]) {
        let solid = Solid::cuboid(&Pose::identity(), low, high, faces);
        self.solids.push(solid);
    }

    /// The floor or the ceiling: columns along x, rows along y.
    fn add_level(&mut self, canvas: Canvas) {
        let u = axis([1.0, 0.0, 0.0], canvas.scale, [0.0; 3]);
        let v = axis([0.0, 1.0, 0.0], canvas.scale, [0.0; 3]);
        self.painted(canvas, 1.0, u, v);
    }

    fn add_walls(&mut self, layout: &Layout, lighting: &Lighting, rng: &mut ChaCha8Rng) {
        let (w, d) = (layout.width_m, layout.depth_m);
        let places: [WallPlace; 4] = [
            ('S', [w, 0.0], [-1.0, 0.0], w),
            ('N', [0.0, d], [1.0, 0.0], w),
            ('W', [0.0, 0.0], [0.0, 1.0], d),
            ('E', [w, d], [0.0, -1.0], d),
        ];
        for place in places {
            let (name, .., length) = place;
            let mut canvas = paint_wall(length, name, rng);
            if name == 'S' {
                let gate = layout.islands[0].x1;
                roller_door(&mut canvas, w - gate - AISLE_M + 0.6, w - gate - 0.6);
            }
            self.add_wall(&canvas, place, lighting);
        }
    }

    fn add_wall(&mut self, canvas: &Canvas, place: WallPlace, lighting: &Lighting) -> u16 {
        let (_, [x, y], [rx, ry], _) = place;
        // Sampled half a metre inside the hall.
        let lit = light_wall(canvas, lighting, |m| {
            [x + m * rx + ry * 0.5, y + m * ry - rx * 0.5]
        });
        let u = axis([rx, ry, 0.0], WALL_SCALE, [x, y, 0.0]);
        let v = axis([0.0, 0.0, 1.0], WALL_SCALE, [x, y, 0.0]);
        self.painted(lit, 1.0, u, v)
    }

    fn add_rooms(&mut self, layout: &Layout, lighting: &Lighting, rng: &mut ChaCha8Rng) {
        for (room, top) in layout.rooms.iter().zip([false, true]) {
            let Rect { x0, y0, x1, y1 } = *room;
            let side = y1 - y0;
            let inner = if top {
                ('V', [x0, y0], [1.0, 0.0], side)
            } else {
                ('T', [x1, y1], [-1.0, 0.0], side)
            };
            let west = ('U', [x0, y1], [0.0, -1.0], side);
            let [west, inner] = [west, inner].map(|place: WallPlace| {
                let canvas = paint_wall(side, place.0, rng);
                self.add_wall(&canvas, place, lighting)
            });
            let high = [x1 + 0.1, y1, CEILING_M + 0.1];
            self.add_box([x0, y0, 0.0], high, [west, west, inner, inner, west, west]);
        }
    }

    fn add_pillars(&mut self, layout: &Layout, lighting: &Lighting, rng: &mut ChaCha8Rng) {
        for (index, pillar) in layout.pillars.iter().enumerate() {
            let canvas = paint_pillar(&format!("{}", index + 1), rng);
            let scale = canvas.scale;
            let texture = self.texture(canvas.into_texture());
            let up = axis([0.0, 0.0, 1.0], scale, [0.0; 3]);
            let [cx, cy] = pillar.centre();
            let [a, b, c, d] =
                [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]].map(|[nx, ny]| {
                    let left = [cx + 0.25 * ny, cy - 0.25 * nx, 0.0];
                    let light = 0.1 + 0.8 * lighting.at(cx + 0.6 * nx, cy + 0.6 * ny, 1.2);
                    self.face(texture, light, axis([-ny, nx, 0.0], scale, left), up)
                });
            let high = [pillar.x1, pillar.y1, CEILING_M + 0.1];
            self.add_box([pillar.x0, pillar.y0, 0.0], high, [a, b, c, d, a, a]);
        }
    }

    fn add_beams(&mut self, layout: &Layout, rng: &mut ChaCha8Rng) {
        for x in &layout.beams {
            let canvas = paint_concrete(layout.depth_m, 0.5, rng);
            let scale = canvas.scale;
            let texture = self.texture(canvas.into_texture());
            let low = [x - 0.2, -0.1, CEILING_M - 0.38];
            let high = [x + 0.2, layout.depth_m + 0.1, CEILING_M + 0.1];
            let along = axis([0.0, 1.0, 0.0], scale, [0.0; 3]);
            let up = axis([0.0, 0.0, 1.0], scale, [0.0, 0.0, low[2]]);
            let across = axis([1.0, 0.0, 0.0], scale, [low[0], 0.0, 0.0]);
            let side = self.face(texture, 0.75, along, up);
            let below = self.face(texture, 0.55, along, across);
            self.add_box(low, high, [side, side, side, side, below, below]);
        }
    }

    fn add_car(&mut self, car: &ParkedCar, lighting: &Lighting) {
        let paint = paint_car(&car.shape);
        let stand = self.ground.place(&car.pose);
        let (hx, hy) = (0.5 * car.shape.length, 0.5 * car.shape.width);
        // A texture axis along one of the car's own, from a place in its frame.
        let own = |way: Vector3<f64>, from: Vector3<f64>| {
            let origin = stand.transform(&from);
            axis(stand.rotate(&way).into(), CAR_SCALE, origin.into())
        };
        let along = own(Vector3::x(), Vector3::new(-hx, 0.0, 0.0));
        let across = own(Vector3::y(), Vector3::new(0.0, -hy, 0.0));
        let up = own(Vector3::z(), Vector3::zeros());
        let light = |ahead: f64| {
            let [x, y] = car.pose.point([ahead, 0.0]);
            0.15 + 0.75 * lighting.at(x, y, 0.8)
        };
        let faces = CarViews {
            side: self.painted(paint.side, 0.8 * light(0.0), along, up),
            front: self.painted(paint.front, 0.9 * light(2.0), across, up),
            rear: self.painted(paint.rear, 0.9 * light(-2.0), across, up),
            top: self.painted(paint.top, 1.05 * light(0.0), along, across),
        };
        let dark = self.plain(16, 1.0);
        self.solids.extend(car_solids(car, &stand, &faces, dark));
    }
}
