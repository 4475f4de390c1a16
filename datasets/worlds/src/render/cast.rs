//! Rays of a tile and the solids they meet.

use super::lens::{Lanes, Lens, PIXELS, Window};
use super::solid::{Extent, Solid};
use evermap_algorithms::geometry::pose::Pose;
use std::f32::consts::PI;

/// Farther than anything, metres.
pub const FAR: f32 = 1e9;

/// A solid as seen from one eye: planes it lies behind, and planes it lies in front of.
pub struct Seen {
    /// Where it may show.
    pub extent: Extent,
    shape: Shape,
}

enum Shape {
    Convex {
        /// Normal and distance (negative: the eye is outside), and the face.
        towards: Vec<([f32; 3], f32, f32)>,
        /// Normal and distance (not negative: the eye is inside).
        away: Vec<([f32; 3], f32)>,
    },
    Ellipsoid {
        /// From the eye, in radii, metres per metre.
        centre: [f32; 3],
        /// One over the radii along x, y and z, 1/m.
        scale: [f32; 3],
        face: f32,
    },
}

impl Seen {
    /// A solid; `None` when it surrounds the eye. Its faces are numbered from `first`.
    pub fn new(solid: &Solid, eye: [f32; 3], first: u32) -> Option<Self> {
        let (mut towards, mut away) = (Vec::new(), Vec::new());
        for plane in &solid.planes {
            let n = plane.normal;
            let gap = plane.offset - (n[0] * eye[0] + n[1] * eye[1] + n[2] * eye[2]);
            if gap < 0.0 {
                towards.push((n, gap, (first + u32::from(plane.face)) as f32));
            } else {
                away.push((n, gap));
            }
        }
        let extent = solid.extent(eye);
        let shape = Shape::Convex { towards, away };
        (!matches!(&shape, Shape::Convex { towards, .. } if towards.is_empty()))
            .then_some(Self { extent, shape })
    }

    /// An upright ellipsoid around `centre` (from the eye, metres) with `radii` (horizontal, vertical, metres);
    /// `None` when it surrounds the eye.
    pub fn ellipsoid(centre: [f32; 3], radii: [f32; 2], face: u32) -> Option<Self> {
        let [x, y, z] = centre;
        let scale = [1.0 / radii[0], 1.0 / radii[0], 1.0 / radii[1]];
        let own = [x * scale[0], y * scale[1], z * scale[2]];
        let outside = own.iter().map(|part| part * part).sum::<f32>() > 1.0;
        let level = x.hypot(y);
        let near = level - radii[0];
        let around = near > 0.0;
        // Every point is at a level distance between these, and at a height between those.
        let (least, most) = (near.max(1e-3), level + radii[0]);
        let angle = |height: f32| [(height).atan2(least), (height).atan2(most)];
        let (low, high) = (angle(z - radii[1]), angle(z + radii[1]));
        let extent = Extent {
            azimuth: y.atan2(x),
            half_azimuth: if around {
                (radii[0] / level).asin()
            } else {
                PI
            },
            elevation: [low[0].min(low[1]), high[0].max(high[1])],
            near: near.max(0.0),
        };
        let shape = Shape::Ellipsoid {
            centre: own,
            scale,
            face: face as f32,
        };
        outside.then_some(Self { extent, shape })
    }
}

/// Working memory of one thread.
pub struct Scratch {
    /// Unit rays, map frame.
    pub rays: [Lanes; 3],
    /// How far each ray goes, metres.
    pub t: Lanes,
    /// Number of the face it meets.
    pub face: Lanes,
    enter: Lanes,
    entered: Lanes,
    /// How bright it is there.
    pub grey: Lanes,
}

impl Default for Scratch {
    fn default() -> Self {
        let zero = [0.0; PIXELS];
        Self {
            rays: [zero; 3],
            t: zero,
            face: zero,
            enter: zero,
            entered: zero,
            grey: zero,
        }
    }
}

/// Where a camera is in the map, and how it is turned.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Eye {
    /// Position, metres.
    pub at: [f64; 3],
    /// Rotation `map_from_vehicle`.
    pub turn: [[f32; 3]; 3],
}

impl Eye {
    /// The eye of a camera on a vehicle.
    pub fn new(lens: &Lens, map_from_vehicle: &Pose) -> Self {
        let at = map_from_vehicle.transform(&lens.vehicle_from_camera.translation);
        let matrix = map_from_vehicle.rotation.to_rotation_matrix();
        Self {
            at: at.into(),
            turn: [0, 1, 2].map(|row| [0, 1, 2].map(|column| matrix[(row, column)] as f32)),
        }
    }

    /// Position in the precision of rays, metres.
    pub fn position(&self) -> [f32; 3] {
        self.at.map(|part| part as f32)
    }

    /// A ray of the vehicle's frame in the map frame.
    pub fn turned(&self, own: [f32; 3]) -> [f32; 3] {
        self.turn
            .map(|row| row[0] * own[0] + row[1] * own[1] + row[2] * own[2])
    }
}

/// Looks through a lens, tile by tile. `surround` lets all rays of a tile end at what is around everything; then they
/// meet the solids of each layer (nearest first), and `met` is told the tile's index and the layer's.
pub fn cast<const LAYERS: usize>(
    lens: &Lens,
    turn: &[[f32; 3]; 3],
    layers: [&[Seen]; LAYERS],
    scratch: &mut Scratch,
    surround: impl Fn(&mut Scratch),
    mut met: impl FnMut(usize, usize, &mut Scratch),
) {
    for block in &lens.blocks {
        let Some(cone) = &block.cone else { continue };
        let window = Window::of(cone, turn);
        let within = |seen: &&Seen| window.meets(&seen.extent);
        let layers = layers.map(|seen| seen.iter().filter(within).collect::<Vec<&Seen>>());
        for index in &block.tiles {
            let tile = &lens.tiles[*index];
            let Some(cone) = &tile.cone else { continue };
            turn_rays(&tile.rays, turn, &mut scratch.rays);
            surround(scratch);
            let window = Window::of(cone, turn);
            for (layer, nearby) in layers.iter().enumerate() {
                meet_solids(nearby, &window, scratch);
                met(*index, layer, scratch);
            }
        }
    }
}

/// The solids as seen from `eye`, nearest first; without those that surround it.
pub fn seen_from<'a>(eye: [f32; 3], solids: impl Iterator<Item = &'a Solid>) -> Vec<Seen> {
    let seen = solids.filter_map(|solid| Seen::new(solid, eye, 0));
    nearest_first(seen.collect())
}

/// Sorts by distance.
pub fn nearest_first(mut seen: Vec<Seen>) -> Vec<Seen> {
    seen.sort_by(|a, b| a.extent.near.total_cmp(&b.extent.near));
    seen
}

/// Turns a tile's rays into the map frame.
pub fn turn_rays(own: &[Lanes; 3], turn: &[[f32; 3]; 3], rays: &mut [Lanes; 3]) {
    for (row, out) in turn.iter().zip(rays) {
        for i in 0..PIXELS {
            out[i] = row[0] * own[0][i] + row[1] * own[1][i] + row[2] * own[2][i];
        }
    }
}

/// Lets the rays of a tile end at the first of the solids; `nearby` is sorted by distance.
pub fn meet_solids(nearby: &[&Seen], window: &Window, scratch: &mut Scratch) {
    let mut farthest = highest(&scratch.t);
    for seen in nearby {
        if seen.extent.near > farthest {
            break;
        }
        if window.meets(&seen.extent) {
            meet_solid(seen, scratch);
            farthest = highest(&scratch.t);
        }
    }
}

fn highest(values: &Lanes) -> f32 {
    let mut lanes = [0.0_f32; 8];
    for chunk in values.chunks_exact(8) {
        for (lane, value) in lanes.iter_mut().zip(chunk) {
            *lane = if *value > *lane { *value } else { *lane };
        }
    }
    lanes.into_iter().fold(0.0, f32::max)
}

/// Lets the rays of a tile end at one solid, where it is nearer than what they met before.
pub fn meet_solid(seen: &Seen, scratch: &mut Scratch) {
    match &seen.shape {
        Shape::Convex { towards, away } => meet_convex(towards, away, scratch),
        Shape::Ellipsoid {
            centre,
            scale,
            face,
        } => meet_ellipsoid(*centre, *scale, *face, scratch),
    }
}

/// The nearer root of |t d - c|² = 1 in a space where the ellipsoid is the unit ball.
fn meet_ellipsoid(c: [f32; 3], scale: [f32; 3], face_id: f32, scratch: &mut Scratch) {
    let Scratch {
        rays: [dx, dy, dz],
        t,
        face,
        ..
    } = scratch;
    let beyond = c[0] * c[0] + c[1] * c[1] + c[2] * c[2] - 1.0;
    for i in 0..PIXELS {
        let d = [dx[i] * scale[0], dy[i] * scale[1], dz[i] * scale[2]];
        let a = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
        let b = d[0] * c[0] + d[1] * c[1] + d[2] * c[2];
        let root = b * b - a * beyond;
        let here = (b - root.max(0.0).sqrt()) / a;
        let nearer = (root > 0.0) & (here > 0.0) & (here < t[i]);
        t[i] = if nearer { here } else { t[i] };
        face[i] = if nearer { face_id } else { face[i] };
    }
}

/// A ray enters a convex solid where it crosses the last of the planes that face the eye, if it
/// is then still inside all the others.
fn meet_convex(towards: &[([f32; 3], f32, f32)], away: &[([f32; 3], f32)], scratch: &mut Scratch) {
    let Scratch {
        rays: [dx, dy, dz],
        t,
        face,
        enter,
        entered,
        ..
    } = scratch;
    for (index, (n, gap, id)) in towards.iter().enumerate() {
        let first = index == 0;
        for i in 0..PIXELS {
            let slope = n[0] * dx[i] + n[1] * dy[i] + n[2] * dz[i];
            let here = if slope < -1e-7 { *gap / slope } else { FAR };
            let later = first | (here > enter[i]);
            enter[i] = if later { here } else { enter[i] };
            entered[i] = if later { *id } else { entered[i] };
        }
    }
    for (n, gap) in away {
        for i in 0..PIXELS {
            let slope = n[0] * dx[i] + n[1] * dy[i] + n[2] * dz[i];
            enter[i] = if enter[i] * slope > *gap {
                FAR
            } else {
                enter[i]
            };
        }
    }
    for i in 0..PIXELS {
        let nearer = enter[i] < t[i];
        t[i] = if nearer { enter[i] } else { t[i] };
        face[i] = if nearer { entered[i] } else { face[i] };
    }
}
