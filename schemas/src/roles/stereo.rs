//! Cameras whose images are rectified, and pairs of which one camera names the frame of another one.
//!
//! `sensor_msgs/CameraInfo` says two things of a rectified image beside its lens. R (`rectified_from_camera`) turns the axes
//! of its camera into those of the image, which all cameras of a pair share. The last column of P says where the camera
//! stands along these axes, seen from the first camera of the pair: at `-Tx / fx` and `-Ty / fy` (m). Messages name an
//! optical frame: that of the camera itself, as the definition of the message has it, or, as drivers of stereo cameras do,
//! that of the first camera for all of them.

use crate::roles::calibration::{self, TYPES};
use crate::roles::{Calibration, FARTHEST_M, Fields, FromMessage, Message, Messages};
use crate::{Pose, record};

record! {
    /// Where a camera is mounted, as its calibration says it.
    pub struct CameraMount {
        /// Frame that it is mounted on, as the transforms name it.
        frame: String,
        /// The camera in that frame.
        frame_from_camera: Pose,
    }
}

record! {
    /// The camera of a calibration: whose frame it names, and how it stands to the others of its pair.
    #[layer("calibrated_cameras", key(frame))]
    pub struct CalibratedCamera {
        /// The optical frame; the topic without its last parts where the message names none.
        frame: String,
        /// The camera in the axes of the pair's rectified images, with the pair's first camera in their origin; null where R
        /// or P makes no sense.
        pair_from_camera: Option<Pose>,
        /// What is wrong with R or P; null where both make sense.
        unplaced: Option<String>,
        /// Whether P has it stand beside the first camera of the pair; null where P makes no sense.
        is_beside: Option<bool>,
    }
}

record! {
    /// The frame that a calibration names, whatever else it says.
    #[layer("calibrated_frames", key(frame))]
    pub struct CalibratedFrame {
        /// The optical frame; the topic without its last parts where the message names none.
        frame: String,
    }
}

/// How messages with calibrations become [`CalibratedCamera`]s.
pub const CAMERAS: Messages = Messages::of::<CalibratedCamera>(TYPES);

/// How messages with calibrations become [`CalibratedFrame`]s.
pub const CAMERA_FRAMES: Messages = Messages::of::<CalibratedFrame>(TYPES);

impl FromMessage for CalibratedCamera {
    const MEMBERS: &'static [&'static str] = Calibration::MEMBERS;

    fn from_message(message: &Message<'_>) -> Result<Vec<Self>, String> {
        let said = calibration::said(message)?;
        let (pair_from_camera, unplaced) = match said.pair_from_camera {
            Ok(pose) => (Some(pose), None),
            Err(why) => (None, Some(why)),
        };
        Ok(vec![Self {
            frame: calibration::frame(message),
            pair_from_camera,
            unplaced,
            is_beside: is_beside(&message.fields.numbers(&["p", "P"])),
        }])
    }
}

impl FromMessage for CalibratedFrame {
    const MEMBERS: &'static [&'static str] = &["header", "frame_id"];

    fn from_message(message: &Message<'_>) -> Result<Vec<Self>, String> {
        let frame = calibration::frame(message);
        Ok(vec![Self { frame }])
    }
}

/// Where a camera is mounted on the frame that it names, which is that of `first`, another camera of its pair, or its own;
/// `None` where it is the camera's own and looks as its images do.
pub(super) fn mount(
    frame: &str,
    camera: &Pose,
    first: Option<&Pose>,
    is_rectified: bool,
) -> Option<CameraMount> {
    let of_frame = match (first, is_rectified) {
        (Some(first), _) => first,
        (None, true) => camera,
        (None, false) => return None,
    };
    let frame_from_pair = opposite(turn(of_frame));
    let away = [
        camera.x - of_frame.x,
        camera.y - of_frame.y,
        camera.z - of_frame.z,
    ];
    let [x, y, z] = turned(frame_from_pair, away);
    let [qx, qy, qz, qw] = match is_rectified {
        true => frame_from_pair,
        false => times(frame_from_pair, turn(camera)),
    };
    // No number is -0.
    let parts = [x, y, z, qx, qy, qz, qw].map(|part| part + 0.0);
    let frame_from_camera = Pose::from_array(parts);
    (frame_from_camera != Pose::IDENTITY).then(|| CameraMount {
        frame: frame.to_owned(),
        frame_from_camera,
    })
}

/// The camera in the axes of its pair, by R and P; at the origin, and not turned, where these are not filled in.
///
/// # Errors
/// In words, where R turns nothing or P says that the camera is nowhere.
pub(super) fn pair_from_camera(fields: &Fields<'_>) -> Result<Pose, String> {
    let [qx, qy, qz, qw] = rotation(&fields.numbers(&["r", "R"]))?;
    let [x, y] = beside(&fields.numbers(&["p", "P"]))?;
    Ok(Pose::from_array([x, y, 0.0, qx, qy, qz, qw]))
}

/// What a number of R may be off from the identity's: less than a hundredth of a pixel, of whatever lens.
const TURNED: f64 = 1e-6;

/// What products of rows of R may be off from those of a rotation: calibrations are written down with few digits.
const ROUNDED: f64 = 1e-3;

/// The quaternion of R, row by row; that of the identity where R was not filled in.
fn rotation(r: &[f64]) -> Result<[f64; 4], String> {
    if r.iter().all(|entry| *entry == 0.0) {
        return Ok(STRAIGHT);
    }
    let rows = <[f64; 9]>::try_from(r);
    let rows = rows.map_err(|_| format!("expected 9 numbers as R, found {}", r.len()))?;
    if !is_rotation(&rows) {
        return Err(format!(
            "expected R to be a rotation, row by row, found {rows:?}"
        ));
    }
    let identity = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let is_straight = rows
        .iter()
        .zip(identity)
        .all(|(entry, one)| (entry - one).abs() <= TURNED);
    Ok(match is_straight {
        true => STRAIGHT,
        false => quaternion(&rows),
    })
}

/// Whether rows are of length 1, square to each other and right-handed.
fn is_rotation(&[a, b, c, d, e, f, g, h, i]: &[f64; 9]) -> bool {
    let (x, y, z) = ([a, b, c], [d, e, f], [g, h, i]);
    let dot = |one: [f64; 3], other: [f64; 3]| -> f64 {
        one.iter().zip(other).map(|(one, other)| one * other).sum()
    };
    let across = [b * f - c * e, c * d - a * f, a * e - b * d];
    let lengths = [dot(x, x), dot(y, y), dot(z, z), dot(across, z)];
    let angles = [dot(x, y), dot(y, z), dot(z, x)];
    let is_one = |length: f64| (length - 1.0).abs() <= ROUNDED;
    lengths.into_iter().all(is_one) && angles.into_iter().all(|angle| angle.abs() <= ROUNDED)
}

/// The quaternion of a rotation by its largest part, of length 1.
fn quaternion(&[a, b, c, d, e, f, g, h, i]: &[f64; 9]) -> [f64; 4] {
    let parts = [
        [1.0 + a - e - i, b + d, c + g, h - f],
        [b + d, 1.0 - a + e - i, f + h, c - g],
        [c + g, f + h, 1.0 - a - e + i, d - b],
        [h - f, c - g, d - b, 1.0 + a + e + i],
    ];
    let squares = |part: &[f64; 4]| -> f64 { part.iter().map(|number| number * number).sum() };
    let [first, others @ ..] = parts;
    let longest = others.into_iter().fold(first, |longest, part| {
        match squares(&part) > squares(&longest) {
            true => part,
            false => longest,
        }
    });
    let length = squares(&longest).sqrt();
    longest.map(|number| number / length)
}

/// Cameras that are closer than this are one, m: what is left of a zero that was computed.
const APART_M: f64 = 1e-6;

/// How far beside the first camera of its pair the camera of P stands, along x and y (m).
fn beside(p: &[f64]) -> Result<[f64; 2], String> {
    let &[fx, _, _, tx, _, fy, _, ty, ..] = p else {
        return Ok([0.0; 2]);
    };
    let away = |(t, focal): (f64, f64)| match t == 0.0 {
        true => 0.0,
        false => -t / focal,
    };
    let found = [(tx, fx), (ty, fy)].map(away);
    let is_near = |away: &f64| away.abs() <= FARTHEST_M;
    if !found.iter().all(is_near) {
        let [x, y] = found;
        return Err(format!(
            "expected P to say where a camera of a pair stands, found {x} m and {y} m beside the first one"
        ));
    }
    Ok(found.map(|away| match away.abs() < APART_M {
        true => 0.0,
        false => away,
    }))
}

/// Whether the camera of P stands beside the first one of its pair; `None` where P makes no sense.
fn is_beside(p: &[f64]) -> Option<bool> {
    let away = beside(p).ok()?;
    Some(away != [0.0; 2])
}

/// The quaternion that turns nothing.
const STRAIGHT: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

fn turn(pose: &Pose) -> [f64; 4] {
    let [_, _, _, turn @ ..] = pose.to_array();
    turn
}

/// The quaternion that turns back.
fn opposite([x, y, z, w]: [f64; 4]) -> [f64; 4] {
    [-x, -y, -z, w]
}

/// The quaternion that turns as `b` does and then as `a` does.
fn times([ax, ay, az, aw]: [f64; 4], [bx, by, bz, bw]: [f64; 4]) -> [f64; 4] {
    [
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    ]
}

/// A vector as a quaternion turns it.
fn turned(q: [f64; 4], [x, y, z]: [f64; 3]) -> [f64; 3] {
    let [x, y, z, _] = times(times(q, [x, y, z, 0.0]), opposite(q));
    [x, y, z]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// R, row by row, of a turn about y.
    fn about_y(degrees: f64) -> [f64; 9] {
        let (sin, cos) = degrees.to_radians().sin_cos();
        [cos, 0.0, sin, 0.0, 1.0, 0.0, -sin, 0.0, cos]
    }

    fn pair_from_camera(r: &[f64], p: &[f64]) -> Result<Pose, String> {
        let [qx, qy, qz, qw] = rotation(r)?;
        let [x, y] = beside(p)?;
        Ok(Pose::from_array([x, y, 0.0, qx, qy, qz, qw]))
    }

    /// P of focal lengths of 200 and 100 px.
    fn p(tx: f64, ty: f64) -> [f64; 12] {
        [
            200.0, 0.0, 80.0, tx, 0.0, 100.0, 60.0, ty, 0.0, 0.0, 1.0, 0.0,
        ]
    }

    fn product(rows: &[f64; 9], [x, y, z]: [f64; 3]) -> [f64; 3] {
        [0, 3, 6].map(|at| rows[at] * x + rows[at + 1] * y + rows[at + 2] * z)
    }

    fn is_near(one: [f64; 3], other: [f64; 3]) -> bool {
        let off = |(one, other): (f64, f64)| (one - other).abs() < 1e-12;
        one.into_iter().zip(other).all(off)
    }

    /// A point of a mounted camera in the frame that it is mounted on.
    fn in_frame(mount: &Pose, point: [f64; 3]) -> [f64; 3] {
        let [x, y, z] = turned(turn(mount), point);
        [x + mount.x, y + mount.y, z + mount.z]
    }

    #[test]
    fn a_quaternion_turns_as_its_rows_do() {
        // A turn about each axis, and about one between them, near a half turn and far from one.
        let third = 1.0 / 3.0;
        let all = [
            about_y(5.0),
            about_y(-179.0),
            [1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0],
            [-0.6, -0.8, 0.0, 0.8, -0.6, 0.0, 0.0, 0.0, 1.0],
            [2.0, -1.0, 2.0, 2.0, 2.0, -1.0, -1.0, 2.0, 2.0].map(|entry: f64| third * entry),
        ];
        let point = [0.3, -1.2, 4.0];
        for r in all {
            let found = rotation(&r).map(|q| turned(q, point));
            let is_turned = |found| is_near(found, product(&r, point));
            assert!(found.is_ok_and(is_turned), "{r:?}");
        }
        for r in [&[0.0; 9][..], &[], &[0.0; 4], &about_y(1e-5)] {
            assert_eq!(rotation(r), Ok(STRAIGHT));
        }
        let mut stretched = about_y(5.0);
        stretched[4] = 1.01;
        for r in [&stretched[..], &[1.0; 9], &[f64::NAN; 9], &[1.0; 3]] {
            assert!(rotation(r).is_err(), "{r:?}");
        }
    }

    #[test]
    fn a_point_is_where_the_camera_sees_it_once_its_image_is_rectified() {
        let r = about_y(5.0);
        let camera = pair_from_camera(&r, &p(0.0, 0.0)).unwrap_or(Pose::IDENTITY);
        let mount = mount("left", &camera, None, true).map(|mount| mount.frame_from_camera);
        let mount = mount.unwrap_or(Pose::IDENTITY);
        // By hand: a point that its own camera has at (0.4, -0.2, 2), rectified and through a lens of 100 px.
        let point = [0.4, -0.2, 2.0];
        let (sin, cos) = 5.0_f64.to_radians().sin_cos();
        let rectified = [0.4 * cos + 2.0 * sin, -0.2, -0.4 * sin + 2.0 * cos];
        let expected =
            [rectified[0] / rectified[2], rectified[1] / rectified[2]].map(|at| 100.0 * at);
        // As the map has it: where the point is in the frame is known, and the frame that images look along is mounted on it.
        let seen = turned(opposite(turn(&mount)), point);
        let found = [seen[0] / seen[2], seen[1] / seen[2]].map(|at| 100.0 * at);
        assert!(is_near(rectified, seen), "{seen:?}");
        assert!((found[0] - expected[0]).abs() < 1e-9 && (found[1] - expected[1]).abs() < 1e-9);
        assert!((found[0] - 29.3).abs() < 0.1, "{found:?}");
    }

    #[test]
    fn the_second_camera_of_a_pair_stands_at_the_baseline_along_the_first_ones_images() {
        let (left, right) = (about_y(5.0), about_y(-3.0));
        let first = pair_from_camera(&left, &p(0.0, 0.0)).unwrap_or(Pose::IDENTITY);
        // B = -Tx / fx = 0.12 m, and 0.05 m down.
        let second = pair_from_camera(&right, &p(-24.0, -5.0)).unwrap_or(Pose::IDENTITY);
        assert!((second.x - 0.12).abs() < 1e-12 && (second.y - 0.05).abs() < 1e-12);
        let mounted = |is_rectified| {
            let found = mount("left", &second, Some(&first), is_rectified);
            found.map_or(Pose::IDENTITY, |found| found.frame_from_camera)
        };
        let (rectified, raw) = (mounted(true), mounted(false));
        // A point that the right camera has ahead, in its rectified image and before: the left one rectifies it to where P
        // has it.
        let ahead = [0.3, 0.1, 5.0];
        let in_pair = |frame: [f64; 3]| product(&left, frame);
        let expected = [0.3 + 0.12, 0.1 + 0.05, 5.0];
        assert!(is_near(in_pair(in_frame(&rectified, ahead)), expected));
        let before = product(&about_y(3.0), ahead);
        assert!(is_near(in_pair(in_frame(&raw, before)), expected));
        // Under its own frame it stands there, and is turned as its own images are.
        let own = mount("right", &second, None, true).map(|own| own.frame_from_camera);
        let own = own.unwrap_or(Pose::IDENTITY);
        assert_eq!([own.x, own.y, own.z], [0.0; 3]);
        assert!(is_near(product(&right, in_frame(&own, ahead)), ahead));
        assert_eq!(mount("right", &second, None, false), None);
    }

    #[test]
    fn p_says_where_a_camera_is_or_is_refused() {
        for straight in [&p(0.0, 0.0)[..], &p(1e-9, -0.0), &[], &[0.0; 12]] {
            assert_eq!(beside(straight), Ok([0.0; 2]));
            assert_eq!(is_beside(straight), Some(false));
        }
        for away in [p(-24.0, 0.0), p(0.0, 5.0)] {
            assert_eq!(is_beside(&away), Some(true));
        }
        let mut without_focus = p(-24.0, 0.0);
        without_focus[0] = 0.0;
        for p in [without_focus, p(f64::NAN, 0.0), p(-1e300, 0.0)] {
            let said = beside(&p).err().unwrap_or_default();
            assert!(said.contains("expected P to say where"), "{said}");
            assert_eq!(is_beside(&p), None);
        }
    }
}
