//! How fast small messages become columns: 100,000 `nav_msgs/Odometry`, one core.
#![allow(missing_docs, clippy::unwrap_used)]

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use evermap_messages::MessageType;
use std::hint::black_box;

const MESSAGES: usize = 100_000;
/// Rows in one batch.
const BATCH: usize = 8_192;

const ODOMETRY: &str = "\
std_msgs/Header header
string child_frame_id
geometry_msgs/PoseWithCovariance pose
geometry_msgs/TwistWithCovariance twist
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
================================================================================
MSG: geometry_msgs/PoseWithCovariance
Pose pose
float64[36] covariance
================================================================================
MSG: geometry_msgs/Pose
Point position
Quaternion orientation
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
================================================================================
MSG: geometry_msgs/TwistWithCovariance
Twist twist
float64[36] covariance
================================================================================
MSG: geometry_msgs/Twist
Vector3 linear
Vector3 angular
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
";

fn payload(index: usize) -> Vec<u8> {
    let mut p = vec![0, 1, 0, 0];
    p.extend((index as i32).to_le_bytes());
    p.extend(500_u32.to_le_bytes());
    p.extend(5_u32.to_le_bytes());
    p.extend(b"odom\0\0\0\0");
    p.extend(10_u32.to_le_bytes());
    p.extend(b"base_link\0");
    while !(p.len() - 4).is_multiple_of(8) {
        p.push(0);
    }
    for value in 0..(7 + 36 + 6 + 36) {
        p.extend((value as f64 + index as f64).to_le_bytes());
    }
    p
}

fn decode(c: &mut Criterion) {
    let message = MessageType::parse(
        "cdr",
        "ros2msg",
        "nav_msgs/msg/Odometry",
        ODOMETRY.as_bytes(),
    )
    .unwrap();
    let payloads: Vec<Vec<u8>> = (0..MESSAGES).map(payload).collect();
    let mut group = c.benchmark_group("odometry");
    group.throughput(Throughput::Elements(MESSAGES as u64));
    group.sample_size(10);
    for (name, projection) in [("all", None), ("header", Some(&[0_usize][..]))] {
        group.bench_function(name, |b| {
            b.iter(|| {
                let mut decoder = message.decoder(projection);
                for batch in payloads.chunks(BATCH) {
                    for payload in batch {
                        decoder.push(payload).unwrap();
                    }
                    black_box(decoder.finish().unwrap());
                }
            });
        });
    }
    group.finish();
}

criterion_group!(benches, decode);
criterion_main!(benches);
