#![allow(clippy::unwrap_used, clippy::print_stderr)]

use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, UnitQuaternion, Vector3};
use proptest::prelude::*;

use super::DangerField;
use super::exposure::{ExposureParams, Looks, Shot, Standing, Surroundings};
use super::field::{LookCounts, Weights};
use super::foretelling::{Ground, Visit};
use super::presence::{FoundPerson, presence};
use super::speed::SpeedParams;
use crate::geometry::camera::Camera;
use crate::geometry::pose::Pose;
use crate::ground::cells::{Cell, along, cell_of, in_polygon, middle, neighbours};
use crate::ground::floor::Floor;
use crate::solving::random::SplitMix64;

/// Eq. 1 to 3 with weights, written down edge by edge and solved densely.
fn dense(cells: &[Cell], priors: &[f64], seen: &[LookCounts], weights: Weights) -> Vec<f64> {
    let n = cells.len();
    let mut matrix = DMatrix::<f64>::zeros(n, n);
    let mut right = DVector::<f64>::zeros(n);
    for i in 0..n {
        matrix[(i, i)] += weights.prior_looks + seen[i].looks;
        right[i] += weights.prior_looks * priors[i] + seen[i].people;
        for j in 0..i {
            let [a, b] = [0, 1].map(|k| (cells[i][k] - cells[j][k]).abs());
            if a + b == 1 {
                for (row, column, sign) in [(i, i, 1.0), (j, j, 1.0), (i, j, -1.0), (j, i, -1.0)] {
                    matrix[(row, column)] += sign * weights.tie_looks;
                }
            }
        }
    }
    matrix.lu().solve(&right).unwrap().as_slice().to_vec()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn the_sparse_solve_is_the_dense_one_and_a_mean_of_what_is_known(
        places in prop::collection::btree_map(
            [-5..5_i32, -5..5_i32],
            (0.0..1.0_f64, 0..40_u32, 0.0..1.0_f64),
            1..60,
        ),
        prior_looks in 0.01..100.0_f64,
        tie_looks in 0.0..100.0_f64,
    ) {
        let cells: Vec<Cell> = places.keys().copied().collect();
        let priors: Vec<f64> = places.values().map(|(prior, ..)| *prior).collect();
        let seen: Vec<LookCounts> = places
            .values()
            .map(|(_, looks, share)| LookCounts { looks: f64::from(*looks), people: share * f64::from(*looks) })
            .collect();
        let weights = Weights { prior_looks, tie_looks };
        let found = DangerField::new(cells.clone()).unwrap().solve(&priors, &seen, weights).unwrap();
        for (found, expected) in found.iter().zip(dense(&cells, &priors, &seen, weights)) {
            prop_assert!((found - expected).abs() < 1e-10, "{found} is not {expected}");
        }
        let shares = seen.iter().filter(|seen| seen.looks > 0.0).map(|seen| seen.people / seen.looks);
        let known: Vec<f64> = priors.iter().copied().chain(shares).collect();
        let (least, most) = known.iter().fold((1.0, 0.0), |(a, b): (f64, f64), x| (a.min(*x), b.max(*x)));
        prop_assert!(found.iter().all(|x| (least - 1e-9..=most + 1e-9).contains(x)));
    }
}

#[test]
fn without_ties_it_is_the_mean_of_a_beta_posterior() {
    let seen = [(10.0, 3.0), (0.0, 0.0)].map(|(looks, people)| LookCounts { looks, people });
    let weights = Weights {
        prior_looks: 5.0,
        tie_looks: 0.0,
    };
    let mut field = DangerField::new(vec![[0, 0], [0, 1]]).unwrap();
    let found = field.solve(&[0.1, 0.1], &seen, weights).unwrap();
    assert!((found[0] - (0.5 + 3.0) / 15.0).abs() < 1e-12);
    assert!((found[1] - 0.1).abs() < 1e-12);
}

#[test]
fn areas_have_the_cells_whose_middles_they_hold() {
    let corners = [
        [0.0, 0.0],
        [2.0, 0.0],
        [2.0, 1.0],
        [1.0, 1.0],
        [1.0, 2.0],
        [0.0, 2.0],
    ];
    let cells = in_polygon(&corners, 0.5).unwrap();
    assert_eq!(cells.len(), 12);
    assert!(cells.contains(&[0, 3]) && cells.contains(&[3, 0]) && !cells.contains(&[3, 3]));
    let line = along(&[[0.0, 0.0], [2.0, 0.0], [2.0, 2.0]], 0.3, 0.5).unwrap();
    assert!(line.contains(&[0, 0]) && line.contains(&[4, 3]) && !line.contains(&[0, 1]));
    assert!(line.windows(2).all(|pair| pair[0] < pair[1]));
    assert_eq!(in_polygon(&[[0.0, 0.0], [1e9, 0.0], [1e9, 1e9]], 0.5), None);
    assert_eq!(along(&[[0.0, 0.0], [f64::NAN, 1.0]], 0.5, 0.5), None);
    assert_eq!(cell_of([-0.1, 1e300], 0.5), None);
    assert_eq!(
        neighbours(&[[0, 0], [0, 1], [1, 0], [3, 3]]),
        [(0, 1), (0, 2)]
    );
}

fn found(stamp: i64, position: [f64; 2], sigma_m: f64) -> FoundPerson {
    let variance = sigma_m * sigma_m;
    FoundPerson {
        stamp,
        position,
        covariance: [variance, 0.0, variance],
        probability: 1.0,
    }
}

#[test]
fn a_person_is_in_one_cell_of_a_look_and_is_counted_once_in_it() {
    let second = 1_000_000_000;
    let sure = |stamp| found(stamp, [0.25, 0.25], 0.01);
    let (people, senseless) = presence(&[sure(0), sure(second / 10), sure(second)], 0.5, second);
    assert_eq!(senseless, 0);
    assert!(
        people[&[0, 0]] > 1.9 && people[&[0, 0]] <= 2.0,
        "{people:?}"
    );
    let (people, _) = presence(&[found(0, [0.25, 0.25], 0.5)], 0.5, second);
    let all: f64 = people.values().sum();
    assert!((all - 1.0).abs() < 1e-9 && people[&[0, 0]] > people[&[1, 0]]);
    let mut bad = [sure(0), sure(0), sure(0)];
    bad[0].covariance[1] = 5.0;
    bad[1].position[0] = f64::NAN;
    bad[2].probability = 1.5;
    assert_eq!(presence(&bad, 0.5, second).1, 3);
}

/// A camera 1 m above the ground that looks ahead, 90 degrees wide and high.
fn ahead() -> (Camera, Pose) {
    let optical = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(optical));
    let k = [100.0, 0.0, 99.5, 0.0, 100.0, 99.5, 0.0, 0.0, 1.0];
    let camera = Camera::from_calibration("plumb_bob", 200, 200, &k, &[]).unwrap();
    (camera, Pose::new(Vector3::new(0.0, 0.0, 1.0), rotation))
}

#[test]
fn what_an_image_would_show_counts_once_a_look() {
    let (camera, mount) = ahead();
    let params = ExposureParams::default();
    let looks = |stamps: &[i64], points: Vec<[f64; 3]>, body: fn([f64; 2]) -> bool| {
        let mut looks = Looks::default();
        for stamp in stamps {
            let around = Surroundings {
                floor: &Floor::default(),
                standing: &Standing::new(points.clone()),
            };
            let shot = Shot {
                map_from_vehicle: &Pose::identity(),
                camera: &camera,
                vehicle_from_camera: &mount,
            };
            looks.add(
                *stamp,
                &shot.shows(&around, body, &params).unwrap(),
                &params,
            );
        }
        looks.into_cells()
    };
    let tenth = 100_000_000;
    let free = looks(&[0, tenth, 8 * tenth, 30 * tenth], vec![], |_| false);
    let cell = |x: f64, y: f64| cell_of([x, y], params.cell_m).unwrap();
    assert_eq!(free[&cell(4.1, 0.1)].looks, 3);
    assert_eq!(free[&cell(4.1, 0.1)].first_stamp, 0);
    for unseen in [
        cell(-2.0, 0.1),
        cell(0.6, 0.1),
        cell(9.0, 0.1),
        cell(3.0, 4.0),
    ] {
        assert!(!free.contains_key(&unseen), "{unseen:?}");
    }
    assert!(free.keys().all(|cell| {
        let [x, y] = middle(*cell, params.cell_m);
        x > 0.0 && x.hypot(y) <= params.range_m
    }));
    // A post of two points hides what is behind it, and a lamp nothing.
    let post = vec![
        [4.0, 0.16, 1.0],
        [4.0, 0.165, 0.6],
        [5.0, 2.0, 2.5],
        [5.0, 2.1, 2.5],
    ];
    let behind_post = looks(&[0], post, |_| false);
    assert!(
        behind_post.contains_key(&cell(3.6, 0.1)) && !behind_post.contains_key(&cell(6.1, 0.1))
    );
    assert!(behind_post.contains_key(&cell(6.1, 2.6)));
    // The bonnet fills the lower quarter.
    let before_bonnet = looks(&[0], vec![], |[_, v]| v > 130.0);
    assert!(free.contains_key(&cell(2.1, 0.1)) && !before_bonnet.contains_key(&cell(2.1, 0.1)));
}

/// Up a ramp, heads are above the image before feet are.
#[test]
fn people_stand_on_the_floor_that_bends() {
    let (camera, mount) = ahead();
    let params = ExposureParams::default();
    let level = |z: f64| {
        move |x: i32| {
            Pose::new(
                Vector3::new(0.1 * f64::from(x), 0.0, z),
                UnitQuaternion::identity(),
            )
        }
    };
    let seen = |floor: &Floor| {
        let around = Surroundings {
            floor,
            standing: &Standing::default(),
        };
        let shot = Shot {
            map_from_vehicle: &Pose::identity(),
            camera: &camera,
            vehicle_from_camera: &mount,
        };
        let cell = cell_of([3.1, 0.1], params.cell_m).unwrap();
        shot.shows(&around, |_| false, &params)
            .unwrap()
            .contains(&cell)
    };
    let [same, above] = [0.0, 3.0].map(|z| {
        let poses: Vec<Pose> = (20..40).map(level(z)).collect();
        Floor::under(&poses, 0.0, params.range_m)
    });
    assert!(seen(&Floor::default()) && seen(&same) && !seen(&above));
}

#[test]
fn speed_falls_linearly_to_that_of_a_person_walking() {
    let params = SpeedParams::default();
    let full = params.full_danger(0.5);
    // 4.1 m to stand, 2 m wide: 33 cells.
    assert!((full - 0.25 / (2.0 * (2.8 + 2.8 * 2.8 / 6.0))).abs() < 1e-12);
    let speeds = [0.0, full / 2.0, full, 1.0].map(|danger| params.speed(danger, 0.5));
    for (found, expected) in speeds.iter().zip([2.8, 2.1, 1.4, 1.4]) {
        assert!((found - expected).abs() < 1e-12, "{speeds:?}");
    }
    let wrong = SpeedParams {
        min_mps: 3.0,
        ..params
    };
    assert!(params.check().is_ok() && wrong.check().is_err());
}

/// A car park of 40 m × 25 m with a crossing at either end: kinds other, lane, crossing.
fn car_park() -> (Vec<Cell>, Vec<usize>) {
    let cells: Vec<Cell> = (0..80).flat_map(|i| (0..50).map(move |j| [i, j])).collect();
    let crossing = |range: std::ops::Range<i32>, cell: &Cell| {
        range.contains(&cell[0]) && (20..30).contains(&cell[1])
    };
    let kind = |cell: &Cell| match cell {
        cell if crossing(4..10, cell) || crossing(70..76, cell) => 2,
        [_, 18..32] => 1,
        _ => 0,
    };
    let kinds = cells.iter().map(kind).collect();
    (cells, kinds)
}

/// People who walk across one of the crossings, and one who walks to a car.
fn visit(number: u64, cells: &[Cell], right: bool, people: usize) -> Visit {
    let mut random = SplitMix64(number);
    let mut chance = move || random.next() as f64 / u64::MAX as f64;
    let mut seen: Visit = (0..cells.len())
        .map(|cell| {
            (
                cell,
                LookCounts {
                    looks: f64::round(6.0 + 18.0 * chance()),
                    people: 0.0,
                },
            )
        })
        .collect();
    for walker in 0..people {
        let middle_m = if right { 36.5 } else { 3.5 };
        let (x, way) = (middle_m + 1.6 * (chance() - 0.5), chance() - 0.5);
        for step in 0..12 {
            let across = 0.45 * f64::from(step) * way.signum();
            let start = if way > 0.0 { 10.0 } else { 15.0 };
            let at = if walker == people - 1 {
                [2.0 + 36.0 * chance(), 1.0 + 23.0 * chance()]
            } else {
                [x + 0.3 * (chance() - 0.5), start + across]
            };
            let cell = cell_of(at, 0.5).unwrap();
            if let Ok(index) = cells.binary_search(&cell) {
                let of_cell = &mut seen[index].1;
                of_cell.people = (of_cell.people + 1.0).min(of_cell.looks);
            }
        }
    }
    seen
}

fn ground(visits: Vec<Visit>) -> Ground {
    let (cells, kinds) = car_park();
    Ground {
        field: DangerField::new(cells).unwrap(),
        kinds,
        expected: vec![5e-4, 5e-4, 0.02],
        visits,
    }
}

/// What a visit is foretold by all before it, with the weights that they teach, by `[map, prior, kinds, counts]`.
fn foretold(visits: &[Visit]) -> [f64; 4] {
    let next = visits.len() - 1;
    let learnt = ground(visits[..next].to_vec()).learn().unwrap();
    let before: Vec<usize> = (0..next).collect();
    let mut then = ground(visits.to_vec());
    let found = then.foretell(&before, next, learnt.weights).unwrap();
    eprintln!("visit {next}: {:?}, {found:.1?}", learnt.weights);
    [found.map, found.prior, found.kinds, found.counts]
}

#[test]
fn visits_are_foretold_better_than_by_the_prior_or_by_counting() {
    let (cells, _) = car_park();
    for seed in [0, 100, 200] {
        let mut visits = vec![visit(seed, &cells, true, 0)];
        visits.extend((1..=6).map(|number| visit(seed + number, &cells, number <= 3, 4)));
        let found: Vec<[f64; 4]> = (3..=visits.len())
            .map(|count| foretold(&visits[..count]))
            .collect();
        let sum = |by: usize| found.iter().map(|found| found[by]).sum::<f64>();
        eprintln!("sums: {:.1?}", [0, 1, 2, 3].map(sum));
        assert!(sum(0) > sum(1) && sum(0) > sum(3), "{found:?}");
        // Visit 4 is that of the other crossing: what was learnt of the first one misleads, counting most of all. Of three
        // visits alike, the third is foretold best by the map.
        assert!(
            found.iter().all(|[map, .., counts]| map > counts),
            "{found:?}"
        );
        for number in [3, 6] {
            let [map, prior, ..] = found[number - 2];
            assert!(map > prior, "visit {number}: {found:?}");
        }
        assert!(found[1][0] > found[1][2], "{found:?}");
    }
}

#[test]
fn before_anybody_is_found_the_map_is_the_prior() {
    let (cells, kinds) = car_park();
    let empty = visit(0, &cells, true, 0);
    let mut ground = ground(vec![empty.clone(), empty]);
    let learnt = ground.learn().unwrap();
    assert_eq!((&learnt.priors, learnt.foretold), (&ground.expected, None));
    let danger = ground
        .danger(&[0, 1], &learnt.priors, learnt.weights)
        .unwrap();
    assert!(
        danger
            .iter()
            .zip(&kinds)
            .all(|(found, kind)| *found == ground.expected[*kind])
    );
}
