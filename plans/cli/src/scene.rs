//! What there is to draw of a map from above.

use std::collections::{BTreeMap, BTreeSet};

use evermap_algorithms::geometry::pose::Pose;
use evermap_engine::map::LayerInfo;
use evermap_language::listed;
use evermap_schemas::layers::{Georeference, Keyframe, Lane, OverheadTile, VehiclePose};
use evermap_schemas::{Fault, LayerRow, Stamp};
use nalgebra::Vector3;

use crate::draw::{Canvas, Mark, NOTHING, Outline, Picture, Scene, SlowCell, Trajectory, draw};
use crate::reader::MapReader;
use crate::shown::{Hypothesis, Label, LaneSpeed, PersonSeen, Space, SpaceState, SpeedCell};

/// Where a vehicle was, and when.
type Passed = (Stamp, [f64; 2]);

/// The trajectories of a map, by site and session; from keyframes where it has no poses.
///
/// # Errors
/// As [`MapReader::rows`].
pub async fn trajectories(reader: &MapReader) -> Result<Vec<Trajectory>, Fault> {
    Ok(lines(driven(reader, None).await?))
}

fn lines(driven: Driven) -> Vec<Trajectory> {
    let line = |((_, session), passed): (_, Vec<Passed>)| Trajectory {
        session,
        points: passed.into_iter().map(|(_, point)| point).collect(),
    };
    driven.into_iter().map(line).collect()
}

/// Where vehicles were by site and session, in the order of time.
type Driven = BTreeMap<(String, String), Vec<Passed>>;

async fn driven(reader: &MapReader, site: Option<&str>) -> Result<Driven, Fault> {
    let mut sessions = Driven::new();
    for row in reader.rows::<VehiclePose>(site).await? {
        let points = sessions.entry((row.site, row.session)).or_default();
        points.push((row.stamp, [row.map_from_vehicle.x, row.map_from_vehicle.y]));
    }
    if sessions.is_empty() {
        for row in reader.rows::<Keyframe>(site).await? {
            let points = sessions.entry((row.site, row.session)).or_default();
            points.push((
                row.stamp,
                [row.odom_from_vehicle.x, row.odom_from_vehicle.y],
            ));
        }
    }
    for points in sessions.values_mut() {
        points.sort_by_key(|(stamp, _)| *stamp);
    }
    Ok(sessions)
}

/// Questions of a kind that are drawn: what somebody would answer at a sitting.
const QUESTIONS: u32 = 10;

/// Parking spaces as they were last seen, labels of other things, and what a person is asked about first; what was rejected is
/// not there.
async fn outlines(
    reader: &MapReader,
    site: Option<&str>,
    driven: &Driven,
) -> Result<Vec<Outline>, Fault> {
    let spaces: Vec<Space> = reader.rows(site).await?;
    let states = last_states(reader.rows(site).await?, driven);
    let known: BTreeSet<String> = spaces.iter().filter_map(|it| it.label.clone()).collect();
    let of_space = |space: Space| {
        let state = states.get(&space.space).map_or("unseen", String::as_str);
        Outline {
            mark: Mark::of_state(state),
            title: format!("space {}: {}, {state}", space.space, space.standing),
            said: space.standing != "found",
            closed: true,
            points: outlined(&space.map_from_space, [space.length_m, space.width_m]),
        }
    };
    let mut outlines: Vec<Outline> = spaces.into_iter().map(of_space).collect();
    let labels: Vec<Label> = reader.rows(site).await?;
    let is_shown = |label: &Label| label.standing != "rejected" && !known.contains(&label.label);
    outlines.extend(labels.into_iter().filter(is_shown).map(|label| Outline {
        mark: Mark::Label(label.kind.clone()),
        title: format!("{} {}: {}", label.kind, label.label, label.standing),
        said: true,
        closed: label.shape != "polyline",
        points: label.points.iter().map(|[x, y, _]| [*x, *y]).collect(),
    }));
    let asked: Vec<Hypothesis> = reader.rows(site).await?;
    outlines.extend(asked.into_iter().filter_map(|one| {
        let question = one.question.filter(|place| *place <= QUESTIONS)?;
        let likely = 100.0 * one.probability;
        Some(Outline {
            mark: Mark::Asked,
            title: format!("question {question}: {}? {likely:.0} % likely", one.kind),
            said: false,
            closed: true,
            points: outlined(&one.map_from_label, [one.length_m, one.width_m]),
        })
    }));
    Ok(outlines)
}

/// By space: its state when it was last seen.
fn last_states(mut seen: Vec<SpaceState>, driven: &Driven) -> BTreeMap<u32, String> {
    seen.retain(|row| row.state != "unseen");
    let last = |row: &SpaceState| {
        let passed = driven.get(&(row.site.clone(), row.session.clone()))?;
        passed.last().map(|(stamp, _)| *stamp)
    };
    seen.sort_by_key(last);
    let states = seen.into_iter().map(|row| (row.space, row.state));
    states.collect()
}

/// Corners of a box by its frame, length and width (m); `None` where the frame is not a rigid transform.
pub fn corners(map_from_box: &evermap_schemas::Pose, sides_m: [f64; 2]) -> Option<[[f64; 3]; 4]> {
    let map_from_box = Pose::from_array(map_from_box.to_array()).ok()?;
    let [x, y] = sides_m.map(|side| 0.5 * side);
    let corner = |[x, y]: [f64; 2]| map_from_box.transform(&Vector3::new(x, y, 0.0)).into();
    Some([[x, y], [-x, y], [-x, -y], [x, -y]].map(corner))
}

/// The same from above; none where there are none.
fn outlined(map_from_box: &evermap_schemas::Pose, sides_m: [f64; 2]) -> Vec<[f64; 2]> {
    let corners = corners(map_from_box, sides_m);
    corners.iter().flatten().map(|[x, y, _]| [*x, *y]).collect()
}

/// One site's scene: the one asked for, else the first by name. Also says the names of all sites.
///
/// # Errors
/// A user fault for a site that is not in the map.
pub async fn scene(reader: &MapReader, site: Option<&str>) -> Result<(Scene, Vec<String>), Fault> {
    let mapped = reader.map.version.sessions.iter();
    let sites: BTreeSet<String> = mapped.map(|session| session.log.site.clone()).collect();
    let sites: Vec<String> = sites.into_iter().collect();
    if let Some(site) = site
        && !sites.iter().any(|known| known == site)
    {
        let known = sites.join(", ");
        return Err(Fault::user(format!(
            "no site {site:?} in this map; there are {known}"
        )));
    }
    let site = site.or(sites.first().map(String::as_str));
    let driven = driven(reader, site).await?;
    let speeds: Vec<LaneSpeed> = reader.rows(site).await?;
    let speeds = speeds
        .into_iter()
        .filter_map(|row| Some((row.lane, [row.speed_mps?, row.mean_mps?])));
    let cells: Vec<SpeedCell> = reader.rows(site).await?;
    let people: Vec<PersonSeen> = reader.rows(site).await?;
    let placed: Vec<Georeference> = reader.rows(site).await?;
    let scene = Scene {
        heading_rad: placed.first().map(|row| row.heading_rad),
        tiles: reader.rows(site).await?,
        lanes: reader.rows(site).await?,
        intersections: reader.rows(site).await?,
        lane_speeds: speeds.collect(),
        slow: SlowCell::of(&cells),
        people: people.iter().map(|person| [person.x, person.y]).collect(),
        outlines: outlines(reader, site, &driven).await?,
        trajectories: lines(driven),
        ..Scene::default()
    };
    Ok((scene, sites))
}

/// Layers that a map is drawn from.
const DRAWN: [&str; 3] = [OverheadTile::NAME, Lane::NAME, VehiclePose::NAME];

/// Draws a scene of a map.
///
/// # Errors
/// As [`draw`]; where nothing is there to draw, with the layers that have no rows.
pub fn drawn(reader: &MapReader, scene: &Scene, canvas: Canvas) -> Result<Picture, Fault> {
    draw(scene, canvas).map_err(|fault| undrawn(&reader.map.layers(), fault))
}

/// Why nothing is drawn: layers that are drawn are empty, or the map has none of them.
fn undrawn(layers: &[LayerInfo], fault: Fault) -> Fault {
    let empty = layers.iter().filter(|layer| layer.rows == 0);
    let names = empty.map(|layer| layer.layer.as_str());
    let empty: Vec<_> = names.filter(|name| DRAWN.contains(name)).collect();
    match fault.message == NOTHING && !empty.is_empty() {
        true => Fault::user(format!("no row to draw in {}", listed(empty))),
        false => fault,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn layer(name: &str, rows: u64) -> LayerInfo {
        LayerInfo {
            layer: name.to_owned(),
            rows,
            bytes: 0,
            artifacts: 1,
            operator: None,
            digest: String::new(),
        }
    }

    #[test]
    fn layers_without_rows_are_why_nothing_is_drawn_and_nothing_else() {
        let nothing = || Fault::user(NOTHING).next("publish some");
        let layers = [layer("lanes", 0), layer("poses", 0), layer("features", 0)];
        let told = undrawn(&layers, nothing()).to_string();
        assert_eq!(told, "user: no row to draw in `lanes`, `poses`");
        assert_eq!(undrawn(&layers[2..], nothing()), nothing());
        let zoom = Fault::user("expected one of the zoom levels 0, found 7");
        assert_eq!(undrawn(&layers, zoom.clone()), zoom);
    }
}
