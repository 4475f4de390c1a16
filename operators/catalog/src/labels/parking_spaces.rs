#![doc = include_str!("parking_spaces.md")]

use evermap_algorithms::ground::boxes::GroundBox;
use evermap_algorithms::ground::boxes::rows::{
    ENTERED_WITHIN_M, LaneLine, NumberedSpace, numbered,
};
use evermap_contract::{Emit, Fault, Key, Operator, Port, Sides, Work};
use evermap_schemas::Wkb;
use evermap_schemas::layers::{BoxHypothesis, Lane, ParkingSpace, PlacedLabel};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::boxes::{ground_box, lane_line, pose, said_before};

/// See the module's page.
pub struct ParkingSpaces;

/// Which boxes are spaces, and where they are entered from.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct ParkingSpacesParams {
    /// Kind of the labels that are parking spaces.
    pub kind: String,
    /// Probability from which on a hypothesis counts as found: at a half, as many are wrong to have as to leave out.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub probability: f64,
    /// From the middle of a space to the lane that it is entered from, at most (m): half a space of 5 m, and the 6 m of an
    /// aisle, on whose far side the lane may be.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub lane_within_m: f64,
}

impl Default for ParkingSpacesParams {
    fn default() -> Self {
        Self {
            kind: "parking_space".to_owned(),
            probability: 0.5,
            lane_within_m: ENTERED_WITHIN_M,
        }
    }
}

impl Operator for ParkingSpaces {
    const NAME: &'static str = "parking_spaces";
    const VERSION: u32 = 3;
    const PAGE: &'static str = include_str!("parking_spaces.md");
    type Params = ParkingSpacesParams;
    type Output = ParkingSpace;

    fn work() -> Work<Self::Params> {
        let labels = Port::site::<PlacedLabel>("labels");
        let sides = vec![
            Port::site::<BoxHypothesis>("hypotheses").optional(),
            Port::site::<Lane>("lanes").optional(),
        ];
        Work::group(labels, Key::SITE, sides, spaces)
    }
}

/// A box that is a space, and why.
struct SpaceBox {
    place: GroundBox,
    height_m: f64,
    standing: String,
    label: Option<String>,
    probability: f64,
}

fn spaces(
    params: &ParkingSpacesParams,
    labels: Vec<PlacedLabel>,
    sides: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let site = labels[0].site.clone();
    let mut held = said(&labels, params, emit);
    let hypotheses: Vec<BoxHypothesis> = sides.rows("hypotheses")?;
    held.extend(found(hypotheses, params, emit));
    let lanes: Vec<Lane> = sides.rows("lanes")?;
    let lanes: Vec<LaneLine> = lanes.iter().map(lane_line).collect();
    let places: Vec<GroundBox> = held.iter().map(|one| one.place).collect();
    let numbered = numbered(&places, &lanes, params.lane_within_m);
    let space = |space: NumberedSpace| {
        let held = &held[space.index];
        ParkingSpace {
            site: site.clone(),
            space: space.number,
            row: space.row,
            place: space.in_row,
            standing: held.standing.clone(),
            label: held.label.clone(),
            probability: held.probability,
            map_from_space: pose(&space.place, held.height_m),
            length_m: space.place.length_m,
            width_m: space.place.width_m,
            lane: space.entry.map(|entry| entry.lane),
            lane_distance_m: space.entry.map(|entry| entry.distance_m),
            geometry: Wkb::polygon(&space.place.corners()),
        }
    };
    emit.rows(numbered.into_iter().map(space).collect())
}

/// Spaces that people drew or accepted; of several on one place the one said last.
fn said(
    labels: &[PlacedLabel],
    params: &ParkingSpacesParams,
    emit: &mut Emit<'_>,
) -> Vec<SpaceBox> {
    let ours = |label: &&PlacedLabel| label.kind == params.kind && label.standing != "rejected";
    let mut ones = Vec::new();
    for label in labels.iter().filter(ours) {
        let sides = label.length_m.zip(label.width_m);
        let place = sides
            .and_then(|(length_m, width_m)| ground_box(&label.map_from_label, length_m, width_m));
        match place {
            Some(place) => ones.push((place, label)),
            None => emit.skip("parking space is not a box", 1),
        }
    }
    let before = said_before(&ones);
    if !before.is_empty() {
        let count = before.len() as u64;
        emit.skip("parking space that lies on another one", count);
    }
    ones.retain(|(_, label)| !before.contains(label.label.as_str()));
    let held = |(place, label): (GroundBox, &PlacedLabel)| SpaceBox {
        place,
        height_m: label.map_from_label.z,
        standing: label.standing.clone(),
        label: Some(label.label.clone()),
        probability: 1.0,
    };
    ones.into_iter().map(held).collect()
}

/// Spaces that were found.
fn found(
    hypotheses: Vec<BoxHypothesis>,
    params: &ParkingSpacesParams,
    emit: &mut Emit<'_>,
) -> Vec<SpaceBox> {
    let ours =
        |one: &BoxHypothesis| one.kind == params.kind && one.probability >= params.probability;
    let mut held = Vec::new();
    for one in hypotheses.into_iter().filter(ours) {
        let Some(place) = ground_box(&one.map_from_label, one.length_m, one.width_m) else {
            emit.skip("hypothesis is not a box", 1);
            continue;
        };
        held.push(SpaceBox {
            place,
            height_m: one.map_from_label.z,
            standing: "found".to_owned(),
            label: None,
            probability: one.probability,
        });
    }
    held
}
