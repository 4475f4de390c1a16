#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
mod street;

use super::*;
use crate::geometry::camera::Equirectangular;
use nalgebra::UnitQuaternion;
use proptest::prelude::*;
use std::f64::consts::TAU;

const SIZE: [u32; 2] = [128, 48];
const PIXELS: usize = (SIZE[0] * SIZE[1]) as usize;

fn panorama() -> Camera {
    let focal = f64::from(SIZE[0]) / TAU;
    let centre = [63.5, 23.5];
    Camera::new(
        Model::Equirectangular(Equirectangular::new([focal; 2], centre)),
        SIZE[0],
        SIZE[1],
    )
}

/// A room of 6 × 8 m and 4 m height about the origin, whose walls are painted in stripes of two classes, open above: the
/// range along a ray from a position, in mm, and the class. A pillar may stand in it.
fn room(position: &Vector3<f64>, ray: &Vector3<f64>, pillar: bool) -> (u16, u8) {
    let half = Vector3::new(3.0, 2.0, 4.0);
    let mut nearest = (f64::INFINITY, 0);
    for axis in 0..3 {
        let wall = half[axis] * ray[axis].signum();
        let range = (wall - position[axis]) / ray[axis];
        if range > 0.0 && range < nearest.0 {
            let hit = position + ray * range;
            let stripe = ((hit.x + hit.z + 20.0) / 1.5) as u8 % 2;
            // y is down: the ceiling is the sky.
            nearest = (range, if axis == 1 && ray.y < 0.0 { 3 } else { stripe });
        }
    }
    if pillar {
        let across = Vector3::new(ray.x, 0.0, ray.z);
        let to = Vector3::new(1.5 - position.x, 0.0, 1.0 - position.z);
        let along = to.dot(&across) / across.norm_squared();
        if along > 0.0 && (to - across * along).norm() < 0.3 && along < nearest.0 {
            nearest = (along, 2);
        }
    }
    match nearest {
        (_, 3) => (0, 3),
        (range, class) => ((range * 1000.0).round() as u16, class),
    }
}

struct Seen {
    depth: Vec<u16>,
    labels: Vec<u8>,
    pose: Pose,
}

fn seen(x: f64, z: f64, turn: f64, pillar: bool) -> Seen {
    let pose = Pose::new(
        Vector3::new(x, 0.0, z),
        UnitQuaternion::from_axis_angle(&Vector3::y_axis(), turn),
    );
    let camera = panorama();
    let rays = (0..PIXELS).map(|i| {
        let pixel = [(i % SIZE[0] as usize) as f64, (i / SIZE[0] as usize) as f64];
        pose.rotate(&camera.unproject(pixel).unwrap())
    });
    let (depth, labels) = rays
        .map(|ray| room(&pose.translation, &ray, pillar))
        .unzip();
    Seen {
        depth,
        labels,
        pose,
    }
}

/// Sure of the labels, but for those that chance replaces.
fn scores(labels: &[u8], noise: impl Fn(usize) -> bool) -> Vec<u8> {
    let mut bytes = vec![0; 4 * labels.len()];
    for (i, label) in labels.iter().enumerate() {
        let label = if noise(i) {
            (label + 1 + (i % 3) as u8) % 4
        } else {
            *label
        };
        bytes[4 * i + usize::from(label)] = 255;
    }
    bytes
}

fn view<'a>(seen: &'a Seen, bytes: &'a [u8]) -> ScoredView<'a> {
    ScoredView {
        scores: ScoresView::new(SIZE, 1, 4, bytes).unwrap(),
        depth: DepthView::new(SIZE, &seen.depth, 0.001),
        odom_from_camera: seen.pose,
    }
}

fn right(votes: &[u8], labels: &[u8]) -> f64 {
    let best = |of_pixel: &[u8]| {
        let most = of_pixel.iter().max().unwrap();
        of_pixel.iter().position(|vote| vote == most).unwrap() as u8
    };
    let right = votes
        .chunks(4)
        .zip(labels)
        .filter(|(of_pixel, label)| best(of_pixel) == **label);
    right.count() as f64 / labels.len() as f64
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    /// Views that are sure and right agree wherever they see the same thing; around the edges of stripes, of which a
    /// panorama as coarse as this has many, a pixel may be another's.
    #[test]
    fn views_of_one_room_agree(
        steps in prop::collection::vec((-0.6..0.6f64, -0.6..0.6f64, -3.0..3.0f64), 4),
    ) {
        let views: Vec<Seen> = steps.iter().map(|(x, z, turn)| seen(*x, *z, *turn, true)).collect();
        let bytes: Vec<Vec<u8>> = views.iter().map(|seen| scores(&seen.labels, |_| false)).collect();
        let all: Vec<ScoredView<'_>> = views.iter().zip(&bytes).map(|(seen, bytes)| view(seen, bytes)).collect();
        let votes = Voter::new(&panorama(), &VoteOptions::default()).vote(&all[0], &all[1..]);
        let right = right(&votes, &views[0].labels);
        prop_assert!(right > 0.95, "{right}");
        let sure = votes.chunks(4).filter(|of_pixel| of_pixel.contains(&255)).count();
        prop_assert!(sure as f64 > 0.75 * PIXELS as f64, "{sure}");
    }
}

/// Seven views of the room by a vehicle that drives and turns, whose labels are wrong here and there, and the labels.
fn drive() -> (Vec<Seen>, Vec<Vec<u8>>) {
    let step = |i: i32| {
        let i = f64::from(i);
        seen(0.1 * i, 0.15 * i, 0.4 * i, false)
    };
    let views: Vec<Seen> = (0..7).map(step).collect();
    let noise = |view: usize| {
        move |i: usize| (i * 7919 + view * 104_729).wrapping_mul(2_654_435_761) >> 9 & 1023 < 200
    };
    let views_with_noise = views.iter().enumerate();
    let bytes = views_with_noise.map(|(i, seen)| scores(&seen.labels, noise(i)));
    let bytes = bytes.collect();
    (views, bytes)
}

/// What the view in the middle of the drive becomes by itself, and with the others.
fn middle_of(views: &[Seen], bytes: &[Vec<u8>]) -> [Vec<u8>; 2] {
    let all = views.iter().zip(bytes);
    let mut others: Vec<ScoredView<'_>> = all.map(|(seen, bytes)| view(seen, bytes)).collect();
    let middle = others.remove(3);
    let voter = Voter::new(&panorama(), &VoteOptions::default());
    [voter.vote(&middle, &[]), voter.vote(&middle, &others)]
}

#[test]
fn noise_of_single_views_is_voted_down() {
    let (views, bytes) = drive();
    let [alone, together] = middle_of(&views, &bytes).map(|votes| right(&votes, &views[3].labels));
    assert!(alone < 0.83 && together > 0.96, "{alone} {together}");
}

/// A wall of which the view measured nothing is as far away as its neighbours say, and no sky.
#[test]
fn a_hole_is_where_neighbours_measured_something() {
    let (mut views, bytes) = drive();
    let is_hole = |i: usize| (40..80).contains(&(i % SIZE[0] as usize));
    let is_wall: Vec<bool> = views[3].depth.iter().map(|depth| *depth > 0).collect();
    for (i, depth) in views[3].depth.iter_mut().enumerate() {
        *depth = if is_hole(i) { 0 } else { *depth };
    }
    let of_hole = |votes: &[u8]| {
        let inside = (0..PIXELS).filter(|i| is_hole(*i) && is_wall[*i]);
        let (votes, labels): (Vec<_>, Vec<_>) = inside
            .map(|i| (&votes[4 * i..4 * i + 4], views[3].labels[i]))
            .unzip();
        right(&votes.concat(), &labels)
    };
    let [alone, together] = middle_of(&views, &bytes).map(|votes| of_hole(&votes));
    assert!(alone < 0.83 && together > 0.94, "{alone} {together}");
}

/// What is said to be beyond range is where what was not measured may be.
#[test]
fn the_sky_may_be_measured() {
    let (mut views, bytes) = drive();
    let [_, unmeasured] = middle_of(&views, &bytes);
    for depth in views.iter_mut().flat_map(|seen| &mut seen.depth) {
        *depth = if *depth == 0 { u16::MAX } else { *depth };
    }
    let [_, beyond] = middle_of(&views, &bytes);
    let [unmeasured, beyond] = [unmeasured, beyond].map(|votes| right(&votes, &views[3].labels));
    assert!(
        beyond >= unmeasured && unmeasured > 0.96,
        "{beyond} {unmeasured}"
    );
}

/// What stands in front of a wall here is not seen there, and says nothing of the wall.
#[test]
fn occlusion_is_seen() {
    let (here, there) = (seen(0.0, 0.0, 0.0, false), seen(0.1, 0.0, 0.0, true));
    let (of_here, of_there) = (
        scores(&here.labels, |_| false),
        scores(&there.labels, |_| false),
    );
    let votes = Voter::new(&panorama(), &VoteOptions::default())
        .vote(&view(&here, &of_here), &[view(&there, &of_there)]);
    let of_pillar = there.labels.iter().filter(|label| **label == 2).count();
    // At its foot the pillar is as far away as the floor.
    let taken = votes.chunks(4).filter(|of_pixel| of_pixel[2] > 0).count();
    assert!(
        of_pillar > 100 && taken * 20 < of_pillar,
        "{taken} of {of_pillar}"
    );
}

#[test]
fn views_that_do_not_fit_have_no_say() {
    let seen = seen(0.0, 0.0, 0.0, false);
    let bytes = scores(&seen.labels, |_| false);
    let here = view(&seen, &bytes);
    let voter = Voter::new(&panorama(), &VoteOptions::default());
    let blind = ScoredView {
        depth: None,
        ..here
    };
    assert_eq!(voter.vote(&blind, &[here]), bytes);
    assert_eq!(voter.vote(&here, &[blind]), bytes);
    let small = [255];
    let other = ScoredView {
        scores: ScoresView::new([1, 1], 1, 1, &small).unwrap(),
        ..here
    };
    assert_eq!(voter.vote(&here, &[other]), bytes);
    assert!(DepthView::new([2, 2], &[0; 3], 0.001).is_none());
    assert!(DepthView::new([2, 2], &[0; 4], 0.0).is_none());
}
