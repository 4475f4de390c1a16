//! Where a drive lies in a map, from loops of which many may be false.
//!
//! Each loop between a keyframe of the drive and something that lies in the map says where the
//! whole drive lies. True ones say the same, up to the odometry's drift between them; false ones
//! disagree with them and with each other. The loop that most others confirm is taken at its word.
//!
//! One place that looks like another is seen by many keyframes in a row, and all of them may tell
//! the same tale. So support is counted in *places*: keyframes closer than `place_m` along the
//! driven path are one.
//!
//! Source: the pairwise consistency of Mangelson et al., *Pairwise consistent measurement set
//! maximization for robust multi-robot map merging* (ICRA 2018), with the star of one loop in
//! place of the largest clique.

use crate::geometry::lie::se3;
use crate::geometry::pose::Pose;

/// A keyframe of a drive that is known to lie somewhere in the map, if that is true.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseVote {
    /// The keyframe's pose in the drive's own, drifting frame.
    pub drive_from_vehicle: Pose,
    /// Where it lies in the map.
    pub map_from_vehicle: Pose,
    /// Driven path to the keyframe (m).
    pub path_m: f64,
    /// Standard deviation of the position (m).
    pub sigma_m: f64,
    /// Standard deviation of the orientation (rad).
    pub sigma_rad: f64,
}

/// How drift grows, and what is enough.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rules {
    /// Standard deviation of the drive's position after one metre, growing with the root of the
    /// path (m).
    pub walk_m: f64,
    /// Standard deviation of the drive's orientation after one metre (rad).
    pub walk_rad: f64,
    /// Standard deviations that two sightings may differ by.
    pub sigmas: f64,
    /// Path between sightings that count as two (m).
    pub place_m: f64,
    /// Places that must agree.
    pub places: usize,
}

/// `map_from_drive` and the sightings that agree with it.
#[derive(Debug, Clone, PartialEq)]
pub struct Agreement {
    /// The drive's frame in the map.
    pub map_from_drive: Pose,
    /// Indices of the sightings that agree, ascending.
    pub sightings: Vec<usize>,
    /// Places among them.
    pub places: usize,
}

/// The sighting that most places confirm, if they are enough. Quadratic in the number of sightings.
pub fn agree(sightings: &[PoseVote], rules: &Rules) -> Option<Agreement> {
    let mut best: Option<(usize, usize, Vec<usize>)> = None;
    for hub in 0..sightings.len() {
        let with: Vec<usize> = (0..sightings.len())
            .filter(|other| consistent(&sightings[hub], &sightings[*other], rules))
            .collect();
        let places = places(with.iter().map(|s| sightings[*s].path_m), rules.place_m);
        let better = best
            .as_ref()
            .is_none_or(|(_, most, set)| (places, with.len()) > (*most, set.len()));
        if better {
            best = Some((hub, places, with));
        }
    }
    let (hub, places, sightings_of) = best?;
    let hub = sightings.get(hub)?;
    (places >= rules.places).then(|| Agreement {
        map_from_drive: hub
            .map_from_vehicle
            .compose(&hub.drive_from_vehicle.inverse()),
        sightings: sightings_of,
        places,
    })
}

/// How many keyframes there are with at least `place_m` of path between neighbours.
pub fn places(path_m: impl IntoIterator<Item = f64>, place_m: f64) -> usize {
    let mut path: Vec<f64> = path_m.into_iter().filter(|path| path.is_finite()).collect();
    path.sort_unstable_by(f64::total_cmp);
    let mut count = 0;
    let mut last = f64::NEG_INFINITY;
    for at in path {
        if at - last >= place_m {
            count += 1;
            last = at;
        }
    }
    count
}

/// Do two sightings say the same about the drive?
fn consistent(a: &PoseVote, b: &PoseVote, rules: &Rules) -> bool {
    let drive = a
        .drive_from_vehicle
        .inverse()
        .compose(&b.drive_from_vehicle);
    let map = a.map_from_vehicle.inverse().compose(&b.map_from_vehicle);
    let (rho, phi) = se3::split(&se3::minus(&map, &drive));
    let path = (a.path_m - b.path_m).abs();
    let apart = drive.translation.norm();
    let turn2 = a.sigma_rad.powi(2) + b.sigma_rad.powi(2) + rules.walk_rad.powi(2) * path;
    // A wrong heading moves what lies ahead.
    let place2 =
        a.sigma_m.powi(2) + b.sigma_m.powi(2) + rules.walk_m.powi(2) * path + turn2 * apart * apart;
    phi.norm() <= rules.sigmas * turn2.sqrt() && rho.norm() <= rules.sigmas * place2.sqrt()
}
