#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod room;

use nalgebra::{Matrix6, UnitQuaternion, Vector3};

use super::classes::{Kinds, TooManyClasses};
use super::links::Links;
use super::occlusion::{Model, Occlusion, count};
use super::registration::{self, Pyramid, Registration, State, register};
use super::sphere::Lens;
use super::{inference, surroundings, warp};
use crate::geometry::pose::Pose;
use crate::learning::random_forest::{Forest, ForestOptions, train};
use crate::learning::samples::Samples;
use crate::semantic_map::semantic_graph::{Labels, VOID};
use room::{Block, CAR, FLOOR, PILLAR, SIGN, SKY, View, WALL, car, yard};

fn pose(x: f64, z: f64, yaw: f64) -> Pose {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), yaw);
    Pose::new(Vector3::new(x, 0.02 * z, z), turn)
}

fn registered(a: &View, b: &View) -> Option<Registration> {
    let options = registration::Options::default();
    let pyramid = |view: &View| Pyramid::new(&view.sphere(), &options).unwrap();
    register(&pyramid(a), &pyramid(b), None, &options)
}

fn with(more: &[Block]) -> Vec<Block> {
    let mut blocks = yard();
    blocks.extend(more);
    blocks
}

#[test]
fn a_panorama_is_registered_with_another_in_other_light() {
    let here = pose(0.0, 0.0, 0.0);
    let reference = View::new(&yard(), 512, &here, 1.0);
    for (x, z, yaw) in [
        (0.3, 0.7, 0.1),
        (-1.0, 2.5, -0.3),
        (1.5, -3.0, 0.25),
        (0.5, 1.5, 2.6),
    ] {
        let there = pose(x, z, yaw);
        let other = View::new(&yard(), 512, &there, 0.6);
        let found = registered(&reference, &other).unwrap();
        let truth = here.inverse().compose(&there);
        let off = truth.inverse().compose(&found.reference_from_other);
        assert_eq!(found.state, State::Converged, "{found:?}");
        assert!(off.translation.norm() < 0.02, "{:?}", off.translation);
        assert!(
            off.rotation.angle().to_degrees() < 0.1,
            "{:?}",
            off.rotation
        );
        assert!(
            (found.brightness[0] - 0.6).abs() < 0.1,
            "{:?}",
            found.brightness
        );
        assert!(found.covariance.symmetric_eigenvalues().min() > 0.0);
        assert!(found.inliers > 0.75 && found.overlap > 0.5);
    }
}

/// Another yard, which has nothing where this one has something.
#[test]
fn another_place_is_no_place() {
    let reference = View::new(&yard(), 256, &pose(0.0, 0.0, 0.0), 1.0);
    let wall = |x: f64, z: f64| Block {
        low: [x, -3.0, z],
        high: [x + 3.0, 1.5, z + 9.0],
        class: WALL,
    };
    let other = [
        yard()[0],
        wall(2.0, -12.0),
        wall(-5.0, -1.0),
        wall(1.5, 4.0),
    ];
    let found = registered(
        &reference,
        &View::new(&other, 256, &pose(0.0, 0.0, 0.0), 1.0),
    );
    assert!(
        found.is_none_or(|found| found.state != State::Converged),
        "{found:?}"
    );
}

#[test]
fn what_has_no_range_is_not_registered() {
    let mut blind = View::new(&yard(), 128, &pose(0.0, 0.0, 0.0), 1.0);
    blind.range.fill(0);
    let seeing = View::new(&yard(), 128, &pose(0.0, 0.0, 0.0), 1.0);
    assert_eq!(registered(&blind, &seeing), None);
    assert_eq!(registered(&seeing, &blind), None);
    blind.range.pop();
    assert!(Pyramid::new(&blind.sphere(), &registration::Options::default()).is_none());
}

fn kinds() -> Kinds {
    let names = ["sky", "floor", "wall", "pillar", "car", "sign"].map(str::to_owned);
    Kinds::new(&names, &["car".to_owned()], &["sky".to_owned()]).unwrap()
}

#[test]
fn classes_are_as_many_as_labels_tell_apart() {
    let names = |count: usize| -> Vec<String> { (0..count).map(|name| name.to_string()).collect() };
    let kinds = |count| Kinds::new(&names(count), &["254".to_owned()], &[]);
    let most = kinds(255).unwrap();
    assert!(most.is_dynamic(254) && !most.is_dynamic(VOID) && !most.is_static(VOID));
    assert_eq!(kinds(256), Err(TooManyClasses(256)));
}

/// A forged lens whose pixels are as large as the whole view fills in nothing, and takes no time.
#[test]
fn what_is_too_coarse_is_not_filled_in() {
    let here = pose(0.0, 0.0, 0.0);
    let before = View::new(&with(&[car(3.0, 0.5)]), 256, &here, 1.0);
    let mut other = View::new(&yard(), 256, &here, 1.0);
    let size = [other.lens.width, other.lens.height];
    for focal in [1e-12, 1e-300] {
        other.lens = Lens::new(size, [focal, focal], other.lens.centre).unwrap();
        let others = [(other.labelled(), Pose::identity())];
        let after = warp::replaced(
            &before.labelled(),
            &others,
            &kinds(),
            &warp::Options::default(),
        );
        assert_eq!(after, before.labels);
    }
}

/// A car beside the reference, gone when the other came; and one behind it, across the seam.
#[test]
fn what_others_saw_behind_a_car_is_put_in_its_place() {
    let here = pose(0.0, 0.0, 0.0);
    let before = View::new(&with(&[car(3.0, 0.5), car(0.2, -6.0)]), 512, &here, 1.0);
    let truth = View::new(&yard(), 512, &here, 1.0);
    let there = pose(-0.4, 1.2, 0.2);
    let other = View::new(&with(&[car(-4.0, -3.0)]), 512, &there, 1.0);
    let others = [(other.labelled(), here.inverse().compose(&there))];
    let after = warp::replaced(
        &before.labelled(),
        &others,
        &kinds(),
        &warp::Options::default(),
    );
    let (mut replaced, mut right, mut cars) = (0, 0, 0);
    for ((before, after), truth) in before.labels.iter().zip(&after).zip(&truth.labels) {
        if *before != CAR {
            assert_eq!(before, after, "static labels stay");
            continue;
        }
        cars += 1;
        replaced += usize::from(*after != CAR && *after != VOID);
        right += usize::from(after == truth);
    }
    assert!(replaced * 10 > cars * 9, "{replaced} of {cars}");
    assert!(right * 100 > replaced * 98, "{right} of {replaced}");
    let (counts, left) = count(&before.labels, &after, &kinds());
    let unclear = after.iter().filter(|label| **label == VOID).count();
    assert_eq!(left as usize, cars - replaced - unclear);
    let sum: u64 = counts.iter().map(|count| count.pixels).sum();
    assert_eq!(sum as usize, replaced);
    assert!(
        counts
            .iter()
            .all(|count| count.dynamic == CAR && count.class != CAR)
    );
}

/// The car's own range would fetch what is in front of it or beside it; and what stands before the car is not behind it.
#[test]
fn what_is_in_front_of_a_car_is_not_behind_it() {
    let here = pose(0.0, 0.0, 0.0);
    // A sign stands between the two views and the car, but only the other sees it: in the reference, labels say car.
    let mut before = View::new(&with(&[car(3.0, 0.5)]), 512, &here, 1.0);
    let thin = Block {
        low: [1.4, -2.0, 0.3],
        high: [1.6, 1.5, 0.5],
        class: SIGN,
    };
    let there = pose(-0.5, 0.5, 0.0);
    let other = View::new(&with(&[thin]), 512, &there, 1.0);
    let others = [(other.labelled(), here.inverse().compose(&there))];
    let after = warp::replaced(
        &before.labelled(),
        &others,
        &kinds(),
        &warp::Options::default(),
    );
    let changed = before
        .labels
        .iter()
        .zip(&after)
        .filter(|(before, _)| **before == CAR);
    assert!(changed.clone().all(|(_, after)| *after != SIGN));
    assert!(changed.clone().any(|(_, after)| *after == WALL));
    // A hole in the car's range: whatever is nearest.
    before.range.fill(0);
    let after = warp::replaced(
        &before.labelled(),
        &others,
        &kinds(),
        &warp::Options::default(),
    );
    let mut changed = before
        .labels
        .iter()
        .zip(&after)
        .filter(|(before, _)| **before == CAR);
    assert!(changed.any(|(_, after)| *after == SIGN));
}

#[test]
fn a_hole_in_a_wall_is_not_sky_and_sky_has_no_range() {
    let here = pose(0.0, 0.0, 0.0);
    let before = View::new(&with(&[car(3.0, 0.5)]), 256, &here, 1.0);
    let mut other = View::new(&yard(), 256, &here, 1.0);
    let replaced = |other: &View| {
        warp::replaced(
            &before.labelled(),
            &[(other.labelled(), Pose::identity())],
            &kinds(),
            &warp::Options::default(),
        )
    };
    let seen = |labels: &[u8], class: u8| {
        let cars = before
            .labels
            .iter()
            .zip(labels)
            .filter(|(before, _)| **before == CAR);
        cars.filter(|(_, after)| **after == class).count()
    };
    let all = seen(&replaced(&other), WALL);
    assert!(all > 20);
    let walls: Vec<usize> = (0..other.labels.len())
        .filter(|pixel| other.labels[*pixel] == WALL)
        .collect();
    walls.iter().for_each(|pixel| other.range[*pixel] = 0);
    let labels = replaced(&other);
    assert_eq!((seen(&labels, WALL), seen(&labels, SKY)), (0, 0));
    // A mislabelled wall: sky that is 6 m away.
    let mut wrong = View::new(&yard(), 256, &here, 1.0);
    walls.iter().for_each(|pixel| wrong.labels[*pixel] = SKY);
    assert_eq!(seen(&replaced(&wrong), SKY), 0);
}

#[test]
fn views_vote() {
    let here = pose(0.0, 0.0, 0.0);
    let before = View::new(&with(&[car(3.0, 0.5)]), 256, &here, 1.0);
    let right = View::new(&yard(), 256, &here, 1.0);
    let mut wrong = View::new(&yard(), 256, &here, 1.0);
    for label in &mut wrong.labels {
        *label = if *label == WALL { SIGN } else { *label };
    }
    let view = |view| (View::labelled(view), Pose::identity());
    let seen = |votes: usize, class: u8| {
        let mut others = vec![view(&wrong)];
        others.resize(1 + votes, view(&right));
        let after = warp::replaced(
            &before.labelled(),
            &others,
            &kinds(),
            &warp::Options::default(),
        );
        let cars = before.labels.iter().zip(after);
        cars.filter(|(before, after)| **before == CAR && *after == class)
            .count()
    };
    // One of nine is overruled; one of three says that it is not clear.
    assert!(seen(8, WALL) > 20 && seen(8, SIGN) == 0);
    assert_eq!((seen(2, WALL), seen(2, SIGN)), (0, 0));
    assert!(seen(2, VOID) > 20);
    // Nothing to see, nothing to replace.
    assert_eq!(
        warp::replaced(&before.labelled(), &[], &kinds(), &warp::Options::default()),
        before.labels
    );
}

/// A drive of four views, the last of which another visit knows, and a loop that says less surely the same.
#[test]
fn views_are_seen_along_the_surest_links() {
    let mut links = Links::new(5.0);
    let sure = |variance: f64| Matrix6::identity() * variance;
    let step = pose(0.0, 2.0, 0.0);
    for view in 0..3 {
        links.add(view, view + 1, step, &sure(1e-6));
    }
    links.add(0, 2, pose(0.0, 4.5, 0.0), &sure(1e-2));
    links.add(9, 1, pose(0.0, 1.0, std::f64::consts::PI), &sure(1e-6));
    links.add(5, 1, step, &sure(f64::NAN));
    let around = links.around(&0);
    let names: Vec<i32> = around.iter().map(|(view, _)| **view).collect();
    // The fourth view is 6 m away.
    assert_eq!(names, [1, 9, 2]);
    let at: Vec<f64> = around.iter().map(|(_, pose)| pose.translation.z).collect();
    for (found, expected) in at.iter().zip([2.0, 3.0, 4.0]) {
        assert!((found - expected).abs() < 1e-9, "{at:?}");
    }
    let back = links.around(&9);
    assert_eq!(
        back.iter().map(|(view, _)| **view).collect::<Vec<_>>(),
        [1, 2, 0, 3]
    );
    assert!(links.around(&7).is_empty());
}

/// A hole, moved to the side, asks for what was seen there.
#[test]
fn examples_are_holes_that_were_moved() {
    let width = 64;
    let labels = |with: u8| -> Vec<u8> {
        let row = |class: u8| {
            (0..width).map(move |column| match column {
                10..14 => CAR,
                14..30 => with,
                _ => class,
            })
        };
        row(WALL).chain(row(FLOOR)).collect()
    };
    let (before, after) = (labels(CAR), labels(PILLAR));
    let image = Labels {
        width: width as u32,
        height: 2,
        values: &after,
    };
    let found = surroundings::examples(&before, &image, true, &kinds(), 1000);
    // Moved right by 1, 2 and 4: 1, 2 and 4 columns lie in what was seen.
    assert_eq!(found.classes, [PILLAR; 14]);
    assert_eq!(found.values.len(), 14 * surroundings::DIMENSIONS);
    assert!(
        found
            .values
            .chunks_exact(surroundings::DIMENSIONS)
            .all(|of| of[0] == CAR)
    );
    let few = surroundings::examples(&before, &image, true, &kinds(), 6);
    assert!(few.classes.len() <= 6 && !few.classes.is_empty());
}

#[test]
fn a_model_is_shares_of_what_was_relabelled() {
    let counted = |class, pixels| Occlusion {
        dynamic: CAR,
        class,
        pixels,
    };
    let model = Model::new(5, [counted(FLOOR, 30), counted(WALL, 10)]);
    assert_eq!(model.probability(FLOOR, CAR), 0.75);
    assert_eq!(model.probability(SKY, CAR), 0.0);
    assert_eq!(model.probability(FLOOR, PILLAR), 0.0);
    assert_eq!(model.most_probable(CAR), Some((FLOOR, 0.75)));
    assert_eq!(Model::new(5, []).most_probable(CAR), None);
    assert_eq!(model.probability(200, 100), 0.0);
}

/// A car on the boundary of wall and floor, and one that fills the picture.
#[test]
fn what_nobody_saw_is_taken_from_what_is_around_it() {
    let (width, height) = (60, 40);
    let class = |column: usize, row: usize| {
        let car = (20..40).contains(&column) && (12..28).contains(&row);
        if car {
            CAR
        } else if row < 20 {
            WALL
        } else {
            FLOOR
        }
    };
    let values: Vec<u8> = (0..width * height)
        .map(|at| class(at % width, at / width))
        .collect();
    let labels = |values: &'_ [u8]| inference_of(values, width as u32, height as u32, &model());
    let found = labels(&values);
    for (at, label) in found.labels.iter().enumerate() {
        let (column, row) = (at % width, at / width);
        let inside = class(column, row) == CAR;
        assert_eq!(
            found.certainty[at] == 255,
            !inside || found.certainty[at] == 255
        );
        if (12..17).contains(&row) && inside {
            assert_eq!(*label, WALL, "{column} {row}");
        }
        if (24..28).contains(&row) && inside {
            assert_eq!(*label, FLOOR, "{column} {row}");
        }
    }
    let pixels: u64 = found.inferred.iter().map(|inferred| inferred.pixels).sum();
    assert_eq!((pixels, found.unknown), (20 * 16, 0));
    assert!(
        found
            .inferred
            .iter()
            .all(|it| it.probability > 0.5 && it.probability <= 1.0)
    );
    // Nothing around it: what cars hide most often. Nothing known either: nothing.
    let all = vec![CAR; width * height];
    let found = labels(&all);
    assert!(found.labels.iter().all(|label| *label == FLOOR));
    assert_eq!(found.certainty[0], 153);
    let found = inference_of(&all, width as u32, height as u32, &Model::new(5, []));
    assert!(found.labels.iter().all(|label| *label == VOID));
    assert_eq!(found.unknown as usize, width * height);
    // What had no class before is not known either, and stays so.
    let mut unclear = values.clone();
    unclear[..2 * width].fill(VOID);
    let found = labels(&unclear);
    assert!(found.labels[..2 * width].iter().all(|label| *label == VOID));
    assert_eq!(found.unknown as usize, 2 * width);
    let found = inference_of(&unclear, width as u32, height as u32, &Model::new(5, []));
    let without = found.labels.iter().filter(|label| **label == VOID).count();
    assert_eq!(found.unknown as usize, without);
    assert_eq!(without, 2 * width + 20 * 16);
}

fn model() -> Model {
    let counted = |class, pixels| Occlusion {
        dynamic: CAR,
        class,
        pixels,
    };
    Model::new(5, [counted(FLOOR, 60), counted(WALL, 40)])
}

fn inference_of(values: &[u8], width: u32, height: u32, model: &Model) -> inference::Stable {
    let labels = Labels {
        width,
        height,
        values,
    };
    inference::infer(
        &labels,
        true,
        &kinds(),
        inference::Teller::Ellipses(model),
        &inference::Options {
            min_probability: 0.0,
            ..inference::Options::default()
        },
    )
    .unwrap()
}

/// What stands around a pixel in eight directions, across the seam.
#[test]
fn surroundings_are_what_comes_first_in_each_direction() {
    // A car from the last column to the first two, below a wall; a sign to the right, floor below.
    let rows = [
        [WALL; 8],
        [CAR, CAR, SIGN, FLOOR, FLOOR, FLOOR, FLOOR, CAR],
        [CAR, CAR, FLOOR, FLOOR, FLOOR, FLOOR, PILLAR, CAR],
        [VOID; 8],
    ];
    let values: Vec<u8> = rows.into_iter().flatten().collect();
    let labels = Labels {
        width: 8,
        height: 4,
        values: &values,
    };
    let found = |wraps, pixel| surroundings::features(&labels, wraps, &kinds(), &[pixel]);
    let classes = |features: &[u8]| -> Vec<u8> {
        let pairs = features[2..].chunks_exact(2);
        pairs.map(|pair| pair[0]).collect()
    };
    let corner = found(true, 8);
    assert_eq!(corner[..2], [CAR, 64]);
    // Right, and on clockwise; the left sees across the seam.
    let around = [SIGN, VOID, VOID, VOID, FLOOR, WALL, WALL, WALL];
    assert_eq!(classes(&corner), around);
    let distance = |steps: f64| (32.0 * (1.0 + steps * 128.0).log2()).min(254.0) as u8;
    assert_eq!([corner[3], corner[15]], [distance(2.0), distance(1.0)]);
    assert_eq!(corner[5], 255);
    let alone = found(false, 8);
    let around = [SIGN, VOID, VOID, VOID, VOID, VOID, WALL, WALL];
    assert_eq!(classes(&alone), around);
}

/// Floor is behind cars where floor is below them, walls where they are above: learnt from other rows, and no more said
/// than is sure.
#[test]
fn what_is_behind_things_is_learnt_from_what_was_seen_behind_others() {
    let (width, height) = (60_usize, 40_usize);
    let truth = |pixel: usize| if pixel / width < 20 { WALL } else { FLOOR };
    let with_car = |from: usize| -> Vec<u8> {
        let class = |pixel: usize| match (from..from + 8).contains(&(pixel % width)) {
            true if (12..28).contains(&(pixel / width)) => CAR,
            _ => truth(pixel),
        };
        (0..width * height).map(class).collect()
    };
    fn image(values: &[u8]) -> Labels<'_> {
        Labels {
            width: 60,
            height: 40,
            values,
        }
    }
    let (mut classes, mut samples) = (Vec::new(), Vec::new());
    for from in [2, 14, 40] {
        let values = with_car(from);
        let cars: Vec<usize> = (0..values.len()).filter(|at| values[*at] == CAR).collect();
        let features = surroundings::features(&image(&values), true, &kinds(), &cars);
        samples.extend(features);
        classes.extend(cars.into_iter().map(truth));
    }
    let samples = Samples {
        dimensions: surroundings::DIMENSIONS,
        classes: 6,
        labels: &classes,
        values: &samples,
        blocks: &[],
    };
    let options = ForestOptions {
        balance: 0.0,
        ..ForestOptions::default()
    };
    let trees = train(&samples, &options);
    let forest = Forest::new(&trees, surroundings::DIMENSIONS, 6).unwrap();
    let values = with_car(27);
    let teller = inference::Teller::Forest(&forest, None);
    let infer = |min_probability| {
        let options = inference::Options {
            min_probability,
            ..inference::Options::default()
        };
        inference::infer(&image(&values), true, &kinds(), teller, &options).unwrap()
    };
    let all = infer(0.0);
    let right = |labels: &[u8]| {
        (0..labels.len())
            .filter(|at| labels[*at] == truth(*at))
            .count()
    };
    assert_eq!(all.unknown, 0);
    assert!(
        right(&all.labels) >= values.len() - 8,
        "{}",
        right(&all.labels)
    );
    let sure = infer(0.97);
    let silent = sure.labels.iter().filter(|label| **label == VOID).count();
    assert_eq!(sure.unknown as usize, silent);
    assert_eq!(right(&sure.labels) + silent, values.len());
}
