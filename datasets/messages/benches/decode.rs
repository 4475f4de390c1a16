//! How fast small messages become columns: 100,000 `nav_msgs/Odometry`, one core.
#![allow(missing_docs, clippy::unwrap_used)]

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use evermap_messages::MessageType;
use evermap_messages::ros2::{Message, Odometry};
use std::hint::black_box;

const MESSAGES: usize = 100_000;
/// Rows in one batch.
const BATCH: usize = 8_192;

fn payload(index: usize) -> Vec<u8> {
    let value = index as f64;
    let message = Odometry {
        stamp_ns: 1_000_000_000 * index as u64 + 500,
        pose: [value; 7],
        pose_variances: [value; 6],
        twist: [value; 6],
        twist_variances: [value; 6],
    };
    message.encode()
}

fn decode(c: &mut Criterion) {
    let definition = Odometry::DEFINITION.as_bytes();
    let message = MessageType::parse("cdr", "ros2msg", Odometry::NAME, definition).unwrap();
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
