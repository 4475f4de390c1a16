//! Parked cars: who stands where in which session, and what they look like.

use super::CarPark;
use super::canvas::Canvas;
use super::layout::Layout;
use crate::plane::Pose2;
use crate::random::{scramble, stream};
use crate::render::{Side, Solid};
use evermap_algorithms::geometry::pose::Pose;
use nalgebra::Vector3;
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use std::f64::consts::{FRAC_PI_4, PI};

/// Texels per metre of cars.
pub const CAR_SCALE: f64 = 90.0;
const GLASS: f64 = 34.0;

/// Measures of a car, metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Measures {
    /// Bumper to bumper.
    pub length: f64,
    /// Without mirrors.
    pub width: f64,
    /// Roof above the floor.
    pub height: f64,
    /// Lower edge of the windows above the floor.
    pub belt: f64,
    /// Length of the bonnet.
    pub bonnet: f64,
    /// How far the rear window leans forward.
    pub rear_slope: f64,
    /// Length of the boot behind the rear window.
    pub boot: f64,
    /// Grey of the paint, 0 to 255.
    pub paint: f64,
}

/// A car in a bay.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ParkedCar {
    /// Index of the bay.
    pub bay: usize,
    /// Middle of the car, and where its front points.
    #[serde(flatten)]
    pub pose: Pose2,
    /// Whether it stands there in every session.
    pub resident: bool,
    /// Its measures.
    pub shape: Measures,
}

/// The cars parked during a session, in the order of the bays.
pub fn parked_cars(world: &CarPark, layout: &Layout, session: usize) -> Vec<ParkedCar> {
    let mut cars = Vec::new();
    let share = world.occupancy * world.residents;
    let visitors = (world.occupancy - share) / (1.0 - share).max(1e-9);
    for bay in 0..layout.bays.len() {
        let mut home = stream(world.seed, "resident", bay as u64);
        if home.random_bool(share.clamp(0.0, 1.0)) {
            cars.push(park(layout, bay, true, &mut home));
            continue;
        }
        let visit = scramble(session as u64) ^ bay as u64;
        let mut guest = stream(world.seed, "visitor", visit);
        if guest.random_bool(visitors.clamp(0.0, 1.0)) {
            cars.push(park(layout, bay, false, &mut guest));
        }
    }
    cars
}

fn park(layout: &Layout, bay: usize, resident: bool, rng: &mut ChaCha8Rng) -> ParkedCar {
    let entry = layout.bays[bay].entry();
    let shape = draw_shape(rng);
    let deep = rng.random_range(-0.1..0.12) + 0.5 * (4.75 - shape.length) * 0.3;
    let left = rng.random_range(-0.14..0.14);
    let backwards = if rng.random_bool(0.35) { PI } else { 0.0 };
    ParkedCar {
        bay,
        pose: Pose2::new(
            entry.point([deep, left]),
            entry.yaw + backwards + rng.random_range(-0.035..0.035),
        ),
        resident,
        shape,
    }
}

fn draw_shape(rng: &mut ChaCha8Rng) -> Measures {
    let paints = [28.0, 48.0, 75.0, 120.0, 165.0, 205.0, 235.0];
    let paint = paints[rng.random_range(0..paints.len())];
    let mut between = |low: f64, high: f64| rng.random_range(low..high);
    let belt = between(0.86, 0.98);
    let common = Measures {
        length: between(3.7, 4.2),
        width: between(1.66, 1.8),
        height: between(1.42, 1.56),
        belt,
        bonnet: between(0.95, 1.15),
        rear_slope: between(0.2, 0.4),
        boot: between(0.02, 0.1),
        paint: paint + between(-12.0, 12.0),
    };
    let (kind, grow) = (between(0.0, 1.0), between(0.0, 0.35));
    match kind {
        // A saloon: longer, with a boot.
        k if k < 0.3 => Measures {
            length: 4.3 + grow,
            rear_slope: 0.55,
            boot: 0.75,
            ..common
        },
        // A van: tall and blunt.
        k if k < 0.45 => Measures {
            length: 4.25 + grow,
            height: 1.78 + 0.3 * grow,
            bonnet: 0.7,
            rear_slope: 0.08,
            boot: 0.01,
            ..common
        },
        // An estate or a small off-roader.
        k if k < 0.65 => Measures {
            length: 4.2 + grow,
            height: 1.58 + 0.2 * grow,
            ..common
        },
        _ => common,
    }
}

/// Something for each view of a car: its pictures, at [`CAR_SCALE`], or the faces that they are painted on.
#[derive(Debug, Clone, Copy)]
pub struct CarViews<T> {
    /// Both flanks: columns from rear to front, rows up.
    pub side: T,
    /// Columns along y, rows up.
    pub front: T,
    /// Columns along y, rows up.
    pub rear: T,
    /// From above: columns from rear to front, rows along y.
    pub top: T,
}

/// The solids of a car that stands at `stand`: body, cabin, four wheels. Rubber and underside are `dark`.
pub fn car_solids(car: &ParkedCar, stand: &Pose, faces: &CarViews<u16>, dark: u16) -> Vec<Solid> {
    let s = &car.shape;
    let (hx, hy) = (0.5 * s.length, 0.5 * s.width);
    let v = Vector3::new;
    // A sloping side through (x, z), rising `rise` over `run` towards the middle of the car.
    let slope = |x: f64, z: f64, run: f64, rise: f64, face: u16| -> Side {
        let normal = v(rise * x.signum(), 0.0, run);
        (normal, normal.x * x + normal.z * z, face)
    };
    let body = [
        (v(0.0, 1.0, 0.0), hy, faces.side),
        (v(0.0, -1.0, 0.0), hy, faces.side),
        (v(1.0, 0.0, 0.0), hx, faces.front),
        (v(-1.0, 0.0, 0.0), hx, faces.rear),
        (v(0.0, 0.0, 1.0), s.belt, faces.top),
        (v(0.0, 0.0, -1.0), -0.2, dark),
        slope(hx, 0.68, s.bonnet, s.belt - 0.68, faces.top),
        slope(-hx, 0.8, 0.3, s.belt - 0.8, faces.top),
    ];
    let (low, high) = (v(-hx, -hy, 0.2), v(hx, hy, s.belt));
    let mut solids = vec![Solid::new(stand, &body, low, high)];
    let rise = s.height - s.belt;
    let (front, back) = (hx - s.bonnet, s.boot - hx);
    let lean = |side: f64| -> Side {
        let normal = v(0.0, side * rise, 0.19);
        (normal, rise * (hy - 0.01) + 0.19 * s.belt, faces.side)
    };
    let cabin = [
        lean(1.0),
        lean(-1.0),
        (v(0.0, 0.0, 1.0), s.height, faces.top),
        (v(0.0, 0.0, -1.0), 0.05 - s.belt, dark),
        slope(front.max(0.1), s.belt, 0.72, rise, faces.top),
        slope(back.min(-0.1), s.belt, s.rear_slope, rise, faces.top),
    ];
    let low = v(back, -hy, s.belt - 0.05);
    solids.push(Solid::new(stand, &cabin, low, v(front + 0.1, hy, s.height)));
    for x in [0.3 * s.length, -0.3 * s.length] {
        for y in [hy - 0.19, -hy - 0.012] {
            solids.push(wheel(stand, [x, y], faces.side, dark));
        }
    }
    solids
}

fn wheel(stand: &Pose, [x, y]: [f64; 2], side: u16, dark: u16) -> Solid {
    let (radius, width) = (0.31, 0.2);
    let mut sides = vec![
        (Vector3::new(0.0, 1.0, 0.0), y + width, side),
        (Vector3::new(0.0, -1.0, 0.0), -y, side),
    ];
    for k in 0..8 {
        let (sin, cos) = (f64::from(k) * FRAC_PI_4).sin_cos();
        let offset = radius + cos * x + sin * radius;
        sides.push((Vector3::new(cos, 0.0, sin), offset, dark));
    }
    let low = Vector3::new(x - 0.34, y, 0.0);
    let high = Vector3::new(x + 0.34, y + width, 0.66);
    Solid::new(stand, &sides, low, high)
}

/// Paints a car.
pub fn paint_car(shape: &Measures) -> CarViews<Canvas> {
    CarViews {
        side: paint_side(shape),
        front: paint_end(shape, true),
        rear: paint_end(shape, false),
        top: paint_top(shape),
    }
}

fn paint_side(s: &Measures) -> Canvas {
    let mut side = Canvas::new(s.length, s.height, CAR_SCALE, s.paint as u8);
    // The lower half mirrors the dark floor, the shoulder the lamps.
    side.repaint([0.0, 0.0, s.length, s.belt], |_, y, old| {
        old * (0.72 + 0.38 * (y / s.belt).powi(2))
    });
    side.fill([0.0, 0.0, s.length, 0.32], 30.0, 0.75);
    let (from, to) = ([0.25, s.belt - 0.1], [s.length - 0.4, s.belt - 0.16]);
    side.line(from, to, 0.03, 250.0, 0.35);
    let (rear, front) = (s.boot + 0.3, s.length - s.bonnet - 0.12);
    let top = s.height - 0.1;
    let glass = [
        [rear, s.belt + 0.04],
        [front, s.belt + 0.04],
        [front - 0.62, top],
        [rear + s.rear_slope, top],
    ];
    side.polygon(&glass, GLASS, 1.0);
    let post = 0.5 * (rear + front) - 0.1;
    side.fill([post, s.belt, post + 0.09, s.height], s.paint * 0.6, 1.0);
    for x in [post + 0.04, front - 0.05, rear + 0.25] {
        side.line([x, 0.35], [x, s.belt], 0.018, 12.0, 0.8);
    }
    for x in [post + 0.2, post - 0.75] {
        side.fill([x, s.belt - 0.2, x + 0.2, s.belt - 0.155], 15.0, 0.8);
    }
    for x in [0.2 * s.length, 0.8 * s.length] {
        side.disc([x, 0.33], 0.39, 12.0, 1.0);
        side.disc([x, 0.31], 0.2, 150.0, 1.0);
        for k in 0..5 {
            let (sin, cos) = (f64::from(k) * 0.4 * PI).sin_cos();
            side.disc([x + 0.12 * cos, 0.31 + 0.12 * sin], 0.045, 30.0, 1.0);
        }
    }
    side.fill([s.length - 0.3, 0.62, s.length, 0.76], 235.0, 0.9);
    side.fill([0.0, 0.68, 0.22, 0.85], 60.0, 0.9);
    side
}

fn paint_end(s: &Measures, front: bool) -> Canvas {
    let mut end = Canvas::new(s.width, s.height, CAR_SCALE, (s.paint * 0.9) as u8);
    let middle = 0.5 * s.width;
    end.fill([0.0, 0.0, s.width, 0.34], 28.0, 0.85);
    end.fill([middle - 0.26, 0.4, middle + 0.26, 0.51], 238.0, 1.0);
    for k in 0..6 {
        let x = middle - 0.21 + 0.075 * f64::from(k);
        end.fill([x, 0.42, x + 0.045, 0.49], 30.0, 0.8);
    }
    let (lamp, height) = if front { (245.0, 0.56) } else { (70.0, 0.62) };
    for x in [0.08, s.width - 0.42] {
        end.fill([x, height, x + 0.34, height + 0.14], lamp, 1.0);
    }
    if front {
        for k in 0..3 {
            let y = 0.56 + 0.045 * f64::from(k);
            end.line([middle - 0.4, y], [middle + 0.4, y], 0.022, 20.0, 1.0);
        }
    } else {
        end.line([0.1, 0.78], [s.width - 0.1, 0.78], 0.015, 15.0, 0.8);
    }
    end
}

fn paint_top(s: &Measures) -> Canvas {
    let mut top = Canvas::new(s.length, s.width, CAR_SCALE, s.paint as u8);
    top.repaint([0.0, 0.0, s.length, s.width], |_, y, old| {
        let across = 2.0 * y / s.width - 1.0;
        old * (1.08 - 0.25 * across * across)
    });
    let glass = |x0: f64, x1: f64| [x0, 0.13, x1, s.width - 0.13];
    let windscreen = s.length - s.bonnet;
    top.fill(glass(windscreen - 0.7, windscreen - 0.02), GLASS, 1.0);
    if s.rear_slope > 0.15 {
        let rear = glass(s.boot + 0.04, s.boot + 0.9 * s.rear_slope);
        top.fill(rear, GLASS, 1.0);
    }
    for y in [0.3, s.width - 0.3] {
        let (from, to) = ([windscreen + 0.05, y], [s.length - 0.2, y + 0.05]);
        top.line(from, to, 0.02, 12.0, 0.4);
    }
    let (from, to) = ([windscreen, 0.1], [windscreen, s.width - 0.1]);
    top.line(from, to, 0.03, 12.0, 0.9);
    top
}
