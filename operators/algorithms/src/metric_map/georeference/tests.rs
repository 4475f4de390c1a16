#![allow(clippy::unwrap_used)]
use nalgebra::Vector3;

use super::*;

const ORIGIN: Geodetic = Geodetic {
    latitude_deg: 52.2646,
    longitude_deg: 10.5236,
    height_m: 81.0,
};

/// What a receiver does.
#[derive(Clone, Copy)]
struct Receiver {
    noise_m: f64,
    drift_m: f64,
    drift_s: f64,
    /// It hears nothing from here to there, seconds.
    outage_s: [f64; 2],
}

const PERFECT: Receiver = Receiver {
    noise_m: 0.0,
    drift_m: 0.0,
    drift_s: 1.0,
    outage_s: [0.0, 0.0],
};

/// Fixes of drives of 300 m around a corner at 5 m/s, five a second; `heading` is the map's.
fn drive(receiver: Receiver, sessions: usize, heading: f64, seed: u64) -> Vec<AntennaFix> {
    let mut random = SplitMix64(seed);
    let tangent = Tangent::at(ORIGIN);
    let turn = Rotation2::new(heading);
    let mut fixes = Vec::new();
    for session in 0..sessions {
        let mut drift = Vector3::from_fn(|_, _| receiver.drift_m * random.normal());
        for step in 0..300 {
            let seconds = 0.2 * f64::from(step);
            let kept = (-0.2 / receiver.drift_s).exp();
            let fresh = receiver.drift_m * (1.0 - kept * kept).sqrt();
            drift = kept * drift + Vector3::from_fn(|_, _| fresh * random.normal());
            let white = Vector3::from_fn(|_, _| receiver.noise_m * random.normal());
            if seconds >= receiver.outage_s[0] && seconds < receiver.outage_s[1] {
                continue;
            }
            let driven = 5.0 * seconds;
            let map = match driven < 200.0 {
                true => Vector3::new(driven, 0.0, 1.5),
                false => Vector3::new(200.0, driven - 200.0, 1.5),
            };
            let ground = turn * map.xy();
            let enu = Vector3::new(ground.x, ground.y, map.z) + white + drift;
            fixes.push(AntennaFix {
                session,
                seconds,
                map,
                earth: tangent.geodetic(&enu),
                has_height: true,
                sd_m: [None, None],
            });
        }
    }
    fixes
}

/// How far off a placement is: east, north, up and heading.
fn off(found: &Placement, heading: f64) -> [f64; 4] {
    let enu = Tangent::at(ORIGIN).enu(found.origin);
    let turned = Rotation2::new(found.heading_rad - heading).angle();
    [enu.x, enu.y, enu.z, turned]
}

#[test]
fn a_perfect_receiver_says_it_to_the_millimetre_at_any_heading() {
    for heading in [-3.1, -1.0, 0.0, 0.5, 2.0, 3.1] {
        let found = placement(&drive(PERFECT, 1, heading, 1)).unwrap();
        let off = off(&found, heading);
        assert!(off[..3].iter().all(|off| off.abs() < 1e-4), "{off:?}");
        assert!(off[3].abs() < 1e-7, "{off:?}");
        assert_eq!((found.outliers, found.drift), (0, None));
    }
}

/// Errors over their standard deviations, squared, on average over many receivers; and root mean squares of the errors
/// of the middle of the drive (m) and of the heading (rad).
fn over_seeds(receiver: Receiver, sessions: usize) -> ([f64; 2], [f64; 2]) {
    let (mut places, mut turns) = (0.0, 0.0);
    let (mut metres, mut radians) = (0.0, 0.0);
    let seeds = 40;
    for seed in 0..seeds {
        let heading = 0.1 * seed as f64;
        let found = placement(&drive(receiver, sessions, heading, 1000 + seed)).unwrap();
        let [east, north, _, turned] = off(&found, heading);
        let error = Vector3::new(east, north, turned);
        let solved = found.covariance.cholesky().unwrap().solve(&error);
        places += error.dot(&solved) / 3.0;
        turns += turned * turned / found.covariance[(2, 2)];
        let middle = Rotation2::new(found.heading_rad) * Vector2::new(130.0, 20.0)
            - Rotation2::new(heading) * Vector2::new(130.0, 20.0);
        metres += (Vector2::new(east, north) + middle).norm_squared();
        radians += turned * turned;
    }
    let mean = |sum: f64| sum / seeds as f64;
    (
        [mean(places), mean(turns)],
        [mean(metres).sqrt(), mean(radians).sqrt()],
    )
}

#[test]
fn white_noise_and_an_outage_are_averaged_out_and_the_covariance_says_how_far() {
    let receiver = Receiver {
        noise_m: 2.0,
        outage_s: [20.0, 35.0],
        ..PERFECT
    };
    let ([all, turns], [metres, radians]) = over_seeds(receiver, 1);
    assert!(
        (0.6..1.6).contains(&all) && (0.5..1.7).contains(&turns),
        "{all} {turns}"
    );
    assert!(
        metres < 0.3 && radians.to_degrees() < 0.2,
        "{metres} {radians}"
    );
}

#[test]
fn a_drift_is_found_and_makes_the_answer_less_sure() {
    let receiver = Receiver {
        noise_m: 1.0,
        drift_m: 1.5,
        drift_s: 10.0,
        ..PERFECT
    };
    let ([all, turns], _) = over_seeds(receiver, 3);
    assert!(
        (0.5..2.0).contains(&all) && (0.4..2.2).contains(&turns),
        "{all} {turns}"
    );
    let found = placement(&drive(receiver, 6, 1.0, 5)).unwrap();
    let [drift_m, drift_s] = found.drift.unwrap();
    assert!((0.7..1.3).contains(&found.noise_m), "{found:?}");
    assert!(
        (0.7..3.0).contains(&drift_m) && (2.0..101.0).contains(&drift_s),
        "{found:?}"
    );
}

#[test]
fn a_third_of_wild_fixes_does_no_harm_and_is_counted() {
    let receiver = Receiver {
        noise_m: 0.5,
        ..PERFECT
    };
    let mut fixes = drive(receiver, 1, 0.7, 3);
    let mut wild = 0;
    for fix in fixes.iter_mut().skip(40).step_by(3) {
        fix.earth.latitude_deg += 0.0005;
        fix.earth.longitude_deg -= 0.001 * f64::from(wild % 4);
        wild += 1;
    }
    fixes[0].earth = Geodetic {
        latitude_deg: 0.0,
        longitude_deg: 0.0,
        height_m: 0.0,
    };
    let found = placement(&fixes).unwrap();
    let off = off(&found, 0.7);
    assert!(
        off[0].hypot(off[1]) < 0.3 && off[3].abs() < 0.005,
        "{off:?}"
    );
    assert_eq!(found.outliers, wild as usize + 1);
}

#[test]
fn the_map_may_begin_far_from_the_fixes_and_beside_the_date_line() {
    let far = Vector3::new(3_000.0, -2_000.0, 0.0);
    let origin = Geodetic {
        latitude_deg: 65.0,
        longitude_deg: 179.99,
        height_m: 5.0,
    };
    let tangent = Tangent::at(origin);
    let moved = drive(PERFECT, 1, 0.0, 1).into_iter().map(|fix| {
        let map = fix.map + far;
        AntennaFix {
            map,
            earth: tangent.geodetic(&map),
            ..fix
        }
    });
    let found = placement(&moved.collect::<Vec<_>>()).unwrap();
    let off = tangent.enu(found.origin);
    assert!(off.norm() < 1e-3, "{off:?}");
    assert!(found.heading_rad.abs() < 1e-6);
}

#[test]
fn what_does_not_say_where_the_map_is_places_nothing() {
    assert_eq!(placement(&[]), Err(PlacementError::TooFew));
    let fixes = drive(PERFECT, 1, 0.0, 1);
    assert_eq!(placement(&fixes[..2]), Err(PlacementError::TooFew));
    let standing: Vec<AntennaFix> = fixes
        .iter()
        .map(|fix| AntennaFix {
            map: fixes[0].map,
            earth: fixes[0].earth,
            ..*fix
        })
        .collect();
    assert_eq!(placement(&standing), Err(PlacementError::NoHeading));
    let receiver = Receiver {
        noise_m: 5.0,
        ..PERFECT
    };
    let short = drive(receiver, 1, 0.0, 1);
    assert_eq!(placement(&short[..10]), Err(PlacementError::NoHeading));
}

#[test]
fn without_heights_the_place_is_found_and_its_height_is_not() {
    let mut fixes = drive(PERFECT, 1, 0.3, 1);
    for fix in &mut fixes {
        fix.has_height = false;
        fix.earth.height_m = 0.0;
    }
    let found = placement(&fixes).unwrap();
    assert_eq!(found.height_sd_m, None);
    let off = off(&found, 0.3);
    assert!(
        off[0].hypot(off[1]) < 0.01 && off[3].abs() < 1e-4,
        "{off:?}"
    );
}

#[test]
fn what_a_receiver_admits_and_does_not_show_is_a_bias_of_the_drive() {
    let receiver = Receiver {
        noise_m: 0.5,
        ..PERFECT
    };
    let admitting = |sessions| {
        let mut fixes = drive(receiver, sessions, 0.3, 1);
        for fix in &mut fixes {
            fix.sd_m = [Some(2.0), Some(3.0)];
        }
        placement(&fixes).unwrap()
    };
    let (one, four) = (admitting(1), admitting(4));
    let sd = |found: &Placement| found.covariance[(0, 0)].sqrt();
    assert!((1.7..2.2).contains(&sd(&one)), "{one:?}");
    assert!((0.8..1.1).contains(&sd(&four)), "{four:?}");
    assert!((2.7..3.2).contains(&one.height_sd_m.unwrap()), "{one:?}");
}
