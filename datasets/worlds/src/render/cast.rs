//! Rays of a tile and the solids they meet.

use super::lens::{Lanes, Lens, PIXELS, Window};
use super::solid::Solid;
use evermap_algorithms::geometry::pose::Pose;
use std::f32::consts::PI;

/// Farther than anything, metres.
pub const FAR: f32 = 1e9;

/// A solid as seen from one eye: planes it lies behind, and planes it lies in front of.
pub struct VisibleSolid {
    /// Where it may show.
    pub window: Window,
    /// No point is nearer than this, metres.
    pub near: f32,
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

impl VisibleSolid {
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
        let (window, near) = solid.extent(eye);
        let outside = !towards.is_empty();
        outside.then_some(Self {
            window,
            near,
            shape: Shape::Convex { towards, away },
        })
    }

    /// An upright ellipsoid around `centre` (from the eye, metres) with `radii` (horizontal, vertical, metres);
    /// `None` when it surrounds the eye.
    pub fn ellipsoid([x, y, z]: [f32; 3], radii: [f32; 2], face: u32) -> Option<Self> {
        let scale = [1.0 / radii[0], 1.0 / radii[0], 1.0 / radii[1]];
        let centre = [x * scale[0], y * scale[1], z * scale[2]];
        let outside = centre.iter().map(|part| part * part).sum::<f32>() > 1.0;
        let level = x.hypot(y);
        let near = level - radii[0];
        // Every point is at a level distance between these, and at a height between those.
        let (least, most) = (near.max(1e-3), level + radii[0]);
        let angle = |height: f32| [(height).atan2(least), (height).atan2(most)];
        let (low, high) = (angle(z - radii[1]), angle(z + radii[1]));
        let window = Window {
            azimuth: y.atan2(x),
            half_azimuth: if near > 0.0 {
                (radii[0] / level).asin()
            } else {
                PI
            },
            elevation: [low[0].min(low[1]), high[0].max(high[1])],
        };
        let face = face as f32;
        outside.then_some(Self {
            window,
            near: near.max(0.0),
            shape: Shape::Ellipsoid {
                centre,
                scale,
                face,
            },
        })
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
        let along = |row: [f32; 3]| row[0] * own[0] + row[1] * own[1] + row[2] * own[2];
        self.turn.map(along)
    }

    /// A tile's rays, likewise.
    pub fn turn_rays(&self, own: &[Lanes; 3], rays: &mut [Lanes; 3]) {
        for (row, out) in self.turn.iter().zip(rays) {
            for i in 0..PIXELS {
                out[i] = row[0] * own[0][i] + row[1] * own[1][i] + row[2] * own[2][i];
            }
        }
    }
}

/// Looks through a lens, tile by tile. `surround` lets all rays of a tile end at what is around everything; then they
/// meet the solids of each layer (nearest first), and `met` is told the tile's index and the layer's.
pub fn cast<const LAYERS: usize>(
    lens: &Lens,
    eye: &Eye,
    layers: [&[VisibleSolid]; LAYERS],
    surround: impl Fn(&mut Scratch),
    mut met: impl FnMut(usize, usize, &mut Scratch),
) {
    let mut scratch = Scratch::default();
    for (index, tile) in lens.tiles.iter().enumerate() {
        let Some(cone) = &tile.cone else { continue };
        eye.turn_rays(&tile.rays, &mut scratch.rays);
        surround(&mut scratch);
        let window = Window::of(cone, eye);
        for (layer, solids) in layers.iter().enumerate() {
            meet_solids(solids, &window, &mut scratch);
            met(index, layer, &mut scratch);
        }
    }
}

/// The solids as seen from `eye`, nearest first; without those that surround it.
pub fn seen_from<'a>(eye: [f32; 3], solids: impl Iterator<Item = &'a Solid>) -> Vec<VisibleSolid> {
    let seen = solids.filter_map(|solid| VisibleSolid::new(solid, eye, 0));
    nearest_first(seen.collect())
}

/// Sorts by distance.
pub fn nearest_first(mut seen: Vec<VisibleSolid>) -> Vec<VisibleSolid> {
    seen.sort_by(|a, b| a.near.total_cmp(&b.near));
    seen
}

/// Lets the rays of a tile end at the first of the solids, which are sorted by distance.
pub fn meet_solids(solids: &[VisibleSolid], window: &Window, scratch: &mut Scratch) {
    let mut farthest = highest(&scratch.t);
    for seen in solids {
        if seen.near > farthest {
            break;
        }
        if window.meets(&seen.window) {
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
pub fn meet_solid(seen: &VisibleSolid, scratch: &mut Scratch) {
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
