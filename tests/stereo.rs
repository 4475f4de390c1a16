//! Logs of which only rectified images were recorded, turned against their cameras' frames as R says, make the maps that
//! logs make whose images are not turned.

use std::collections::BTreeMap;
use std::path::Path;

use evermap_algorithms::geometry::camera::Camera;
use evermap_messages::ros2::{CompressedImage, Header, Message};
use evermap_tests::park::{Park, adjusted_error, run_small};
use evermap_tests::rows_of_log;
use evermap_tests::trajectories::rows;
use evermap_vision::{Grey, decode_grey, encode_png};
use nalgebra::{Rotation3, Unit, Vector3};
use serde_json::Value;

/// Size of the images, those of the simulated car park: px.
const SIZE: [usize; 2] = [400, 300];

/// Focal length and centre of rectified images, px: they show 114° of the 190° of the lens, about as finely.
const FOCAL: f64 = 130.0;
const CENTRE: [f64; 2] = [199.5, 149.5];

/// What a lens sees is cut here, rad: the image circle ends there.
const CIRCLE_RAD: f64 = 1.65;

/// How the images of one camera are rectified.
struct Rectified {
    /// R.
    rectified_from_camera: Rotation3<f64>,
    /// By pixel, where it is in the image as the lens has it; `None` outside of that.
    places: Vec<Option<[f64; 2]>>,
}

impl Rectified {
    fn new(lens: &Camera, rectified_from_camera: Rotation3<f64>) -> Self {
        let pixels = (0..SIZE[1]).flat_map(|v| (0..SIZE[0]).map(move |u| [u as f64, v as f64]));
        let place = |[u, v]: [f64; 2]| {
            let ray = Vector3::new((u - CENTRE[0]) / FOCAL, (v - CENTRE[1]) / FOCAL, 1.0);
            lens.project(&(rectified_from_camera.inverse() * ray))
        };
        Self {
            rectified_from_camera,
            places: pixels.map(place).collect(),
        }
    }

    /// The image, rectified, as a PNG.
    fn image(&self, file: &[u8]) -> Vec<u8> {
        let mut seen = Grey::default();
        decode_grey(file, &mut seen).unwrap();
        let value = |place: &Option<[f64; 2]>| place.and_then(|at| between(&seen, at)).unwrap_or(0);
        let rectified = Grey {
            width: SIZE[0] as u32,
            height: SIZE[1] as u32,
            data: self.places.iter().map(value).collect(),
        };
        encode_png(&rectified).unwrap()
    }

    /// A `CameraInfo` of the lens with this R, and with the P of these images.
    fn info(&self, message: &[u8]) -> Vec<u8> {
        /// Binning and the region of interest end the message.
        const BEHIND: usize = 6 * 4 + 1;
        let rows = self.rectified_from_camera.matrix().transpose();
        let [cx, cy] = CENTRE;
        let p = [
            [FOCAL, 0.0, cx, 0.0],
            [0.0, FOCAL, cy, 0.0],
            [0.0, 0.0, 1.0, 0.0],
        ];
        let numbers = rows.iter().chain(p.as_flattened());
        let bytes: Vec<u8> = numbers.flat_map(|number| number.to_le_bytes()).collect();
        let mut message = message.to_vec();
        let end = message.len() - BEHIND;
        message[end - bytes.len()..end].copy_from_slice(&bytes);
        message
    }
}

/// The value between the four pixels around a place.
fn between(image: &Grey, [u, v]: [f64; 2]) -> Option<u8> {
    let (left, top) = (u.floor(), v.floor());
    let (right, down) = (u - left, v - top);
    let at = |x: f64, y: f64| image.at([left + x, top + y]).map(f64::from);
    let upper = at(0.0, 0.0)? * (1.0 - right) + at(1.0, 0.0)? * right;
    let lower = at(0.0, 1.0)? * (1.0 - right) + at(1.0, 1.0)? * right;
    Some((upper * (1.0 - down) + lower * down).round() as u8)
}

/// The cameras of a log by the name in their topics, each turned by this angle about another axis.
fn cameras(log: &Path, degrees: f64) -> BTreeMap<String, Rectified> {
    let sql = "SELECT camera, model, intrinsics, distortion FROM calibration";
    let found = rows_of_log(log, sql);
    let numbers = |list: &Value| -> Vec<f64> {
        let list = list.as_array().unwrap().iter();
        list.map(|number| number.as_f64().unwrap()).collect()
    };
    let camera = |row: &Value| {
        let name = row["camera"].as_str().unwrap();
        let name = name.strip_suffix("_optical_frame").unwrap();
        let axis = match name {
            "front" => Vector3::new(0.0, 1.0, 0.0),
            "left" => Vector3::new(1.0, 0.0, 0.0),
            "rear" => Vector3::new(0.0, -1.0, 1.0),
            _ => Vector3::new(-1.0, 1.0, 1.0),
        };
        let turn = Rotation3::from_axis_angle(&Unit::new_normalize(axis), degrees.to_radians());
        let lens = Camera::from_calibration(
            row["model"].as_str().unwrap(),
            SIZE[0] as u32,
            SIZE[1] as u32,
            &numbers(&row["intrinsics"]),
            &numbers(&row["distortion"]),
        );
        let lens = lens.unwrap().with_max_angle(CIRCLE_RAD);
        (name.to_owned(), Rectified::new(&lens, turn))
    };
    found.as_array().unwrap().iter().map(camera).collect()
}

/// Numbers and texts of a message in CDR, one after the other.
struct Members<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Members<'a> {
    fn number(&mut self) -> u32 {
        self.at = self.at.next_multiple_of(4);
        let number = self.bytes[self.at..].first_chunk().unwrap();
        self.at += 4;
        u32::from_le_bytes(*number)
    }

    fn bytes(&mut self) -> &'a [u8] {
        let length = self.number() as usize;
        let found = &self.bytes[self.at..self.at + length];
        self.at += length;
        found
    }

    fn text(&mut self) -> &'a str {
        let (_, text) = self.bytes().split_last().unwrap();
        std::str::from_utf8(text).unwrap()
    }
}

/// The same message with its image rectified.
fn rectified(camera: &Rectified, message: &[u8]) -> Vec<u8> {
    let bytes = &message[4..];
    let mut members = Members { bytes, at: 0 };
    let (seconds, nanoseconds) = (members.number(), members.number());
    let (frame_id, _) = (members.text(), members.text());
    let message = CompressedImage {
        header: Header {
            stamp_ns: u64::from(seconds) * 1_000_000_000 + u64::from(nanoseconds),
            frame_id,
        },
        format: "png",
        data: &camera.image(members.bytes()),
    };
    message.encode()
}

/// Writes a log that says what another one says, but for its images: in their place it has rectified ones alone, turned by
/// this angle.
fn rectify(source: &Path, target: &Path, degrees: f64) {
    let cameras = cameras(source, degrees);
    let bytes = std::fs::read(source).unwrap();
    let file = std::io::BufWriter::new(std::fs::File::create(target).unwrap());
    let mut log = mcap::Writer::new(file).unwrap();
    let mut channels = BTreeMap::new();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        let of = &message.channel;
        let camera = of.topic.strip_prefix("/camera/");
        let camera = camera.and_then(|rest| cameras.get(rest.split('/').next().unwrap()));
        let is_image = of.topic.ends_with("/image/compressed");
        let channel_id = *channels.entry(of.id).or_insert_with(|| {
            let schema = of.schema.as_ref().unwrap();
            let schema = log.add_schema(&schema.name, &schema.encoding, &schema.data);
            let topic = of.topic.replace("/image/", "/image_rect/");
            let encoding = &of.message_encoding;
            let channel = log.add_channel(schema.unwrap(), &topic, encoding, &of.metadata);
            channel.unwrap()
        });
        let payload = match camera {
            Some(camera) if is_image => rectified(camera, &message.data),
            Some(camera) => camera.info(&message.data),
            None => message.data.to_vec(),
        };
        let header = mcap::records::MessageHeader {
            channel_id,
            sequence: message.sequence,
            log_time: message.log_time,
            publish_time: message.publish_time,
        };
        log.write_to_known_channel(&header, &payload).unwrap();
    }
    log.finish().unwrap();
}

#[test]
fn rectified_images_that_are_turned_are_mapped_as_those_that_are_not() {
    let folder = tempfile::tempdir().unwrap();
    let (session, truths) = Park::new(folder.path(), 18).drive(0, "initial", &["loops=0.6"]);
    let error = |name: &str, degrees: f64, turned: u64| {
        let folder = folder.path().join(name);
        std::fs::create_dir(&folder).unwrap();
        let (log, map) = (folder.join("initial.mcap"), folder.join("map"));
        rectify(&session, &log, degrees);
        run_small("metric_map", &map, &[&log]);
        let counted = "SELECT count(*) AS n, count(mount['frame']) AS turned FROM cameras";
        let counted = rows(&map, None, counted);
        assert_eq!([&counted[0]["n"], &counted[0]["turned"]], [4, turned]);
        adjusted_error(name, &map, None, &truths).position_m.rmse
    };
    let (straight, turned) = std::thread::scope(|scope| {
        let straight = scope.spawn(|| error("straight", 0.0, 0));
        let turned = error("turned", 5.0, 4);
        (straight.join().unwrap(), turned)
    });
    assert!(straight <= 0.10, "{straight} m");
    assert!(turned <= straight + 0.02, "{turned} m, and {straight} m");
}
