//! Any graph that a view might have.

use proptest::prelude::*;

use super::{Area, Edge, Graph};

pub(super) const WIDTH: u32 = 1024;

fn area() -> impl Strategy<Value = Area> {
    let place = (0.0_f32..WIDTH as f32, 100.0_f32..230.0);
    let shape = (700_u32..90_000, 0.0_f32..1.0, -1.5_f32..1.57);
    (0_u8..4, place, shape).prop_map(|(class, (u, v), (pixels, eccentricity, angle))| {
        let major_px = (pixels as f32).sqrt();
        Area {
            class,
            pixels,
            u,
            v,
            major_px,
            minor_px: major_px * (1.0 - eccentricity * eccentricity).sqrt(),
            orientation_rad: angle,
            eccentricity,
        }
    })
}

pub(crate) fn graph() -> impl Strategy<Value = Graph> {
    let edges = prop::collection::vec((0_u16..40, 0_u16..40, 1_u32..400), 0..40);
    (prop::collection::vec(area(), 0..40), edges, any::<bool>()).prop_map(
        |(areas, edges, wraps)| {
            let mut edges: Vec<Edge> = edges
                .into_iter()
                .filter(|(a, b, _)| a < b && usize::from(*b) < areas.len())
                .map(|(a, b, boundary_px)| Edge { a, b, boundary_px })
                .collect();
            edges.sort_by_key(|edge| (edge.a, edge.b));
            edges.dedup_by_key(|edge| (edge.a, edge.b));
            Graph {
                width: WIDTH,
                height: 333,
                wraps,
                field_of_view_rad: None,
                areas,
                edges,
            }
        },
    )
}
