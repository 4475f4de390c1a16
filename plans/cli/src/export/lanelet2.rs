//! Lanes as a Lanelet2 map: OSM's XML in local metres, as Autoware's loader reads it with the projector `Local`.
//!
//! ```text
//! lane ─▶ relation type=lanelet subtype=road one_way=yes|no ─┬─ left  ─▶ way type=virtual ─▶ nodes local_x, local_y, ele
//!                                                            └─ right ─▶ way type=virtual ─▶ nodes
//! ```
//! The bounds lie half of the lane's width beside its centre line. A lane that was driven from its end to its start only is
//! turned round, one that was driven both ways is not one-way. Lanelets follow each other where they share the last and
//! first nodes of their bounds: where drives went on from one lane to the other, and only there. A local map has no place
//! on the globe: `lat` and `lon`, which OSM wants, are the metres around 0° N 0° E.
//!
//! Format: Lanelet2's pages `lanelet2_maps`, `LaneletAndAreaTagging` and `LinestringTagging`.

use std::collections::BTreeMap;

use arrow::array::RecordBatch;
use evermap_schemas::Fault;
use evermap_schemas::layers::Lane;

use crate::reader::{one_site, typed};

/// Metres of a degree on the equator.
const DEGREE_M: f64 = 111_319.490_793;

/// The map of the lanes of one site; `version` is the map's.
///
/// # Errors
/// A user fault for a layer that has no lanes, or lanes of several sites.
pub fn text(batches: &[RecordBatch], site: Option<&str>, version: u64) -> Result<String, Fault> {
    let mut lanes: Vec<Lane> = typed(batches).map_err(|fault| fault.next("export lanes"))?;
    one_site(lanes.iter().map(|lane| lane.site.as_str()), site)?;
    lanes.retain(|lane| lane.points.len() > 1);
    Ok(Drawing::of(&lanes).text(version))
}

/// A lane's end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct End {
    lane: usize,
    at_start: bool,
}

impl End {
    /// Which of the lane's points it is.
    fn place(self, lane: &Lane) -> usize {
        match self.at_start {
            true => 0,
            false => lane.points.len() - 1,
        }
    }
}

/// Two nodes across a lane, left and right of a direction.
#[derive(Debug, Clone, Copy)]
struct Gate {
    course: [f64; 2],
    nodes: [u64; 2],
}

#[derive(Default)]
struct Drawing {
    nodes: Vec<[f64; 3]>,
    ways: Vec<Vec<u64>>,
    /// Left and right way, and whether it is one-way.
    lanelets: Vec<([usize; 2], bool)>,
}

impl Drawing {
    fn of(lanes: &[Lane]) -> Self {
        let mut drawing = Self::default();
        let gates = drawing.gates(lanes);
        for (number, lane) in lanes.iter().enumerate() {
            let last = lane.points.len() - 1;
            let mut bounds: [Vec<u64>; 2] = [Vec::new(), Vec::new()];
            for at in 0..=last {
                let end = End {
                    lane: number,
                    at_start: at == 0,
                };
                let course = course(&lane.points, at);
                let gate = gates.get(&end).filter(|_| at == 0 || at == last);
                let sides = match gate {
                    Some(gate) if dot(gate.course, course) < 0.0 => [gate.nodes[1], gate.nodes[0]],
                    Some(gate) => gate.nodes,
                    None => drawing.across(&lane.points[at], course, lane.width_m),
                };
                for (bound, node) in bounds.iter_mut().zip(sides) {
                    bound.push(node);
                }
            }
            if lane.direction == "backward" {
                bounds.swap(0, 1);
                bounds.iter_mut().for_each(|bound| bound.reverse());
            }
            let ways = bounds.map(|bound| {
                drawing.ways.push(bound);
                drawing.ways.len() - 1
            });
            drawing.lanelets.push((ways, lane.direction != "both"));
        }
        drawing
    }

    /// Nodes to the left and right.
    fn across(&mut self, point: &[f64; 3], course: [f64; 2], width_m: f64) -> [u64; 2] {
        [0.5, -0.5].map(|side| {
            let [dx, dy] = [-course[1], course[0]].map(|d| side * width_m * d);
            self.nodes.push([point[0] + dx, point[1] + dy, point[2]]);
            self.nodes.len() as u64
        })
    }

    /// The nodes at the ends of all lanes, the same for those that drives went on between.
    fn gates(&mut self, lanes: &[Lane]) -> BTreeMap<End, Gate> {
        let mut gates = BTreeMap::new();
        for joined in joined(lanes) {
            let mut course = [0.0; 2];
            let mut width_m = 0.0;
            for end in &joined {
                let lane = &lanes[end.lane];
                let way = self::course(&lane.points, end.place(lane));
                let sign = if dot(course, way) < 0.0 { -1.0 } else { 1.0 };
                course = [0, 1].map(|k| course[k] + sign * way[k]);
                width_m += lane.width_m / joined.len() as f64;
            }
            let Some(first) = joined.first() else {
                continue;
            };
            let (lane, course) = (&lanes[first.lane], unit(course));
            let nodes = self.across(&lane.points[first.place(lane)], course, width_m);
            gates.extend(joined.into_iter().map(|end| (end, Gate { course, nodes })));
        }
        gates
    }

    fn text(&self, version: u64) -> String {
        let tag = |key: &str, value: &str| format!("    <tag k=\"{key}\" v=\"{value}\"/>\n");
        let nodes = (1..).zip(&self.nodes).map(|(id, [x, y, z])| {
            let [lat, lon] = [y, x].map(|metres| metres / DEGREE_M);
            let local = [("local_x", x), ("local_y", y), ("ele", z)];
            let local = local.map(|(key, value)| tag(key, &format!("{value:.4}")));
            let place = format!(" lat=\"{lat:.11}\" lon=\"{lon:.11}\"");
            element("node", id, &place, &local.concat())
        });
        let way_id = |way: usize| self.nodes.len() + way + 1;
        let ways = self.ways.iter().enumerate().map(|(way, nodes)| {
            let nodes = nodes
                .iter()
                .map(|node| format!("    <nd ref=\"{node}\"/>\n"));
            let within = nodes.collect::<String>() + &tag("type", "virtual");
            element("way", way_id(way), "", &within)
        });
        let lanelets = self.lanelets.iter().enumerate();
        let lanelets = lanelets.map(|(number, ([left, right], one_way))| {
            let members = [(left, "left"), (right, "right")].map(|(way, role)| {
                let id = way_id(*way);
                format!("    <member type=\"way\" ref=\"{id}\" role=\"{role}\"/>\n")
            });
            let tags = [
                ("type", "lanelet"),
                ("subtype", "road"),
                ("location", "urban"),
                ("one_way", if *one_way { "yes" } else { "no" }),
            ];
            let tags = tags.map(|(key, value)| tag(key, value));
            let id = way_id(self.ways.len() + number);
            element("relation", id, "", &(members.concat() + &tags.concat()))
        });
        let elements: String = nodes.chain(ways).chain(lanelets).collect();
        format!(
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<osm version=\"0.6\" generator=\"evermap\">\n  \
             <MetaInfo format_version=\"1\" map_version=\"{version}\"/>\n{elements}</osm>\n"
        )
    }
}

/// An element by its number, and what is in it.
fn element(kind: &str, id: usize, more: &str, within: &str) -> String {
    format!("  <{kind} id=\"{id}\"{more}>\n{within}  </{kind}>\n")
}

/// Ends of lanes that drives went through from one to the other; each end is in one group.
fn joined(lanes: &[Lane]) -> Vec<Vec<End>> {
    let index: BTreeMap<u32, usize> = lanes.iter().map(|lane| lane.lane).zip(0..).collect();
    let ends = |lane| [true, false].map(|at_start| End { lane, at_start });
    let mut group: BTreeMap<End, usize> = (0..lanes.len()).flat_map(ends).zip(0..).collect();
    let mut join = |a: End, b: End| {
        let (Some(&from), Some(&to)) = (group.get(&a), group.get(&b)) else {
            return;
        };
        for number in group.values_mut().filter(|number| **number == from) {
            *number = to;
        }
    };
    for (number, lane) in lanes.iter().enumerate() {
        if lane.start_kind == "loop" {
            let [start, end] = ends(number);
            join(start, end);
        }
        for (at_start, next) in [(false, &lane.next_lanes), (true, &lane.next_lanes_backward)] {
            let leaves = End {
                lane: number,
                at_start,
            };
            let node = if at_start {
                lane.start_node
            } else {
                lane.end_node
            };
            for &next in next.iter().filter_map(|next| index.get(next)) {
                let other = &lanes[next];
                // A lane that is a loop from the node and back was entered at its start unless it was driven backward.
                let both = other.start_node == other.end_node;
                let entered_at_start = if both {
                    other.direction != "backward"
                } else {
                    other.start_node == node
                };
                let enters = End {
                    lane: next,
                    at_start: entered_at_start,
                };
                join(leaves, enters);
            }
        }
    }
    let mut groups: BTreeMap<usize, Vec<End>> = BTreeMap::new();
    for (end, number) in group {
        groups.entry(number).or_default().push(end);
    }
    groups.into_values().collect()
}

/// Direction of a line at one of its points, from the one before to the one after.
fn course(points: &[[f64; 3]], at: usize) -> [f64; 2] {
    let (from, to) = (
        points[at.saturating_sub(1)],
        points[(at + 1).min(points.len() - 1)],
    );
    unit([to[0] - from[0], to[1] - from[1]])
}

fn unit([x, y]: [f64; 2]) -> [f64; 2] {
    let length = x.hypot(y);
    if length > 0.0 {
        [x / length, y / length]
    } else {
        [1.0, 0.0]
    }
}

fn dot(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

#[cfg(test)]
mod tests;
