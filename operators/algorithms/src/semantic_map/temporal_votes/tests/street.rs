//! Votes on a simulated street whose labels are noisy, with its odometry: accuracy by the number of views.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stderr
)]

use std::collections::BTreeMap;

use super::super::*;
use crate::geometry::camera::Camera;
use crate::geometry::trajectory::{MAX_GAP_NS, StampedPose, pose_at};
use crate::learning::dense_crf::Confusion;
use evermap_test_data::shared;
use nalgebra::{Quaternion, UnitQuaternion};

const CLASSES: usize = 9;

/// Little-endian CDR, as ROS 2 writes it.
struct Cdr<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Cdr<'a> {
    fn new(message: &'a [u8]) -> Self {
        Self {
            bytes: &message[4..],
            at: 0,
        }
    }

    fn take(&mut self, size: usize, align: usize) -> &'a [u8] {
        self.at = self.at.next_multiple_of(align);
        self.at += size;
        &self.bytes[self.at - size..self.at]
    }

    fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.take(4, 4).try_into().unwrap())
    }

    fn f64(&mut self) -> f64 {
        f64::from_le_bytes(self.take(8, 8).try_into().unwrap())
    }

    fn bytes(&mut self) -> &'a [u8] {
        let size = self.u32() as usize;
        self.take(size, 1)
    }

    /// Stamp (ns) and frame.
    fn header(&mut self) -> i64 {
        let stamp = i64::from(self.u32()) * 1_000_000_000 + i64::from(self.u32());
        self.bytes();
        stamp
    }

    fn pose(&mut self) -> Pose {
        let [x, y, z] = [self.f64(), self.f64(), self.f64()];
        let [i, j, k, w] = [self.f64(), self.f64(), self.f64(), self.f64()];
        let rotation = UnitQuaternion::new_normalize(Quaternion::new(w, i, j, k));
        Pose::new(Vector3::new(x, y, z), rotation)
    }
}

#[derive(Default)]
struct Panorama {
    depth: Vec<u16>,
    labels: Vec<u8>,
    noisy: Vec<u8>,
}

#[derive(Default)]
struct Visit {
    panoramas: BTreeMap<i64, Panorama>,
    odometry: Vec<StampedPose>,
    vehicle_from_camera: Option<Pose>,
    camera: Option<Camera>,
}

fn image(message: &[u8]) -> (i64, Vec<u8>) {
    let mut cdr = Cdr::new(message);
    let stamp = cdr.header();
    cdr.bytes();
    let decoder = png::Decoder::new(std::io::Cursor::new(cdr.bytes()));
    let mut reader = decoder.read_info().unwrap();
    let mut data = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut data).unwrap();
    (stamp, data)
}

/// The messages of an MCAP log in the order of the file: chunks (opcode 6) hold channels (4) and messages (5).
fn messages(
    mut records: &[u8],
    topics: &mut BTreeMap<u16, String>,
    take: &mut dyn FnMut(&str, &[u8]),
) {
    let number =
        |bytes: &[u8], at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    let channel = |bytes: &[u8]| u16::from_le_bytes([bytes[0], bytes[1]]);
    // A record's length takes eight bytes; nothing here is longer than 4 GiB.
    while records.len() > 9 {
        let (opcode, size) = (records[0], number(records, 1) as usize);
        let record = &records[9..9 + size];
        match opcode {
            4 => {
                let topic = &record[8..8 + number(record, 4) as usize];
                let topic = std::str::from_utf8(topic).unwrap().to_owned();
                topics.insert(channel(record), topic);
            }
            5 => take(&topics[&channel(record)], &record[22..]),
            6 => {
                let name = number(record, 28) as usize;
                assert_eq!(&record[32..32 + name], b"zstd");
                let chunk = zstd::stream::decode_all(&record[32 + name + 8..]).unwrap();
                messages(&chunk, topics, take);
            }
            _ => {}
        }
        records = &records[9 + size..];
    }
}

fn read(path: &std::path::Path) -> Visit {
    let bytes = std::fs::read(path).unwrap();
    let mut visit = Visit::default();
    let mut topics: BTreeMap<u16, String> = BTreeMap::new();
    messages(&bytes[8..], &mut topics, &mut |topic, data| match topic {
        "/panorama/depth" => {
            let (stamp, data) = image(data);
            let (units, _) = data.as_chunks();
            let depth = units.iter().map(|unit| u16::from_be_bytes(*unit)).collect();
            visit.panoramas.entry(stamp).or_default().depth = depth;
        }
        "/panorama/labels" => {
            let (stamp, data) = image(data);
            visit.panoramas.entry(stamp).or_default().labels = data;
        }
        "/panorama/labels_noisy" => {
            let (stamp, data) = image(data);
            visit.panoramas.entry(stamp).or_default().noisy = data;
        }
        "/panorama/camera_info" => {
            let mut cdr = Cdr::new(data);
            cdr.header();
            let (height, width) = (cdr.u32(), cdr.u32());
            let model = cdr.bytes();
            let model = std::str::from_utf8(&model[..model.len() - 1]).unwrap();
            assert_eq!(cdr.u32(), 0, "no distortion");
            let k: Vec<f64> = (0..9).map(|_| cdr.f64()).collect();
            visit.camera = Camera::from_calibration(model, width, height, &k, &[]).ok();
        }
        "/odom" => {
            let mut cdr = Cdr::new(data);
            let stamp_ns = cdr.header();
            cdr.bytes();
            let pose = cdr.pose();
            visit.odometry.push(StampedPose { stamp_ns, pose });
        }
        "/tf_static" => {
            let mut cdr = Cdr::new(data);
            assert_eq!(cdr.u32(), 1, "one transform: base_link to the camera");
            cdr.header();
            cdr.bytes();
            visit.vehicle_from_camera = Some(cdr.pose());
        }
        _ => {}
    });
    visit
}

/// Of all panoramas of a visit, with this many views.
fn accuracy(visit: &Visit, views: usize, options: &VoteOptions) -> Confusion {
    let camera = visit.camera.as_ref().unwrap();
    let size = [camera.width, camera.height];
    let sure = |labels: &[u8]| -> Vec<u8> {
        let mut bytes = vec![0; CLASSES * labels.len()];
        for (of_pixel, label) in bytes.chunks_exact_mut(CLASSES).zip(labels) {
            of_pixel[usize::from(*label)] = 255;
        }
        bytes
    };
    let bytes: Vec<Vec<u8>> = visit
        .panoramas
        .values()
        .map(|panorama| sure(&panorama.noisy))
        .collect();
    let held: Vec<ScoredView<'_>> = visit
        .panoramas
        .iter()
        .zip(&bytes)
        .map(|((stamp, panorama), bytes)| ScoredView {
            scores: ScoresView::new(size, 1, CLASSES, bytes).unwrap(),
            depth: DepthView::new(size, &panorama.depth, 0.001),
            odom_from_camera: pose_at(&visit.odometry, *stamp, MAX_GAP_NS)
                .unwrap()
                .compose(&visit.vehicle_from_camera.unwrap()),
        })
        .collect();
    let voter = Voter::new(camera, options);
    let mut confusion = Confusion::new(CLASSES);
    for (at, panorama) in visit.panoramas.values().enumerate().step_by(20) {
        let reach = views / 2;
        let around: Vec<ScoredView<'_>> = (at.saturating_sub(reach)
            ..(at + reach + 1).min(held.len()))
            .filter(|other| *other != at)
            .map(|other| held[other])
            .collect();
        let votes = voter.vote(&held[at], &around);
        let most = |of_pixel: &[u8]| {
            let most = of_pixel.iter().max().unwrap();
            of_pixel.iter().position(|vote| vote == most).unwrap() as u8
        };
        let found: Vec<u8> = votes.chunks_exact(CLASSES).map(most).collect();
        confusion.add(&panorama.labels, &found);
    }
    confusion
}

#[test]
fn neighbours_correct_noisy_labels() {
    let Some(path) = shared("worlds/street_small/visit_a/visit_a.mcap") else {
        return;
    };
    let visit = read(&path);
    let options = VoteOptions::default();
    let by_views = [1, 3, 7, 11].map(|views| {
        let found = accuracy(&visit, views, &options);
        eprintln!(
            "{views} views: {:.2} % of the pixels, {:.2} % of the classes",
            100.0 * found.pixel_accuracy(),
            100.0 * found.class_accuracy()
        );
        found
    });
    let [alone, three, seven, _] = &by_views;
    assert!(three.pixel_accuracy() > alone.pixel_accuracy() + 0.02);
    assert!(seven.pixel_accuracy() > three.pixel_accuracy());
    assert!(seven.class_accuracy() > alone.class_accuracy() + 0.02);
}
