//! Lanes as a graph for Nav2's route server, which drives straight from node to node: every point of a centre line is one.
//!
//! ```text
//! point  { id, frame: map }
//! line   { id, startid, endid, cost: length in m, metadata: { speed_limit: the lane's lowest, in per cent of the map's highest } }
//! ```
//! A lane that was driven one way has edges that way alone; where nobody knows how it is driven, both.
//!
//! Format: `geojson_graph_file_loader` and `adjust_speed_limit` of `nav2_route`.

use std::collections::BTreeMap;

use arrow::array::RecordBatch;
use evermap_schemas::Fault;
use evermap_schemas::layers::Lane;
use serde_json::{Value, json};

use crate::reader::{MapReader, one_site, typed};
use crate::shown::{LaneSpeed, SpeedCell};

/// The graph of the lanes of one site.
///
/// # Errors
/// A user fault for a layer that has no lanes, or lanes of several sites.
pub async fn text(
    reader: &MapReader,
    batches: &[RecordBatch],
    site: Option<&str>,
) -> Result<String, Fault> {
    let lanes: Vec<Lane> = typed(batches).map_err(|fault| fault.next("export lanes"))?;
    let site = one_site(lanes.iter().map(|lane| lane.site.as_str()), site)?;
    let cells: Vec<SpeedCell> = reader.rows(Some(&site)).await?;
    let most_mps = cells.iter().map(|cell| cell.max_mps).fold(0.0, f64::max);
    let speeds: Vec<LaneSpeed> = reader.rows(Some(&site)).await?;
    let limit = |row: LaneSpeed| Some((row.lane, 100.0 * row.speed_mps? / most_mps));
    let limits: BTreeMap<u32, f64> = match most_mps > 0.0 {
        true => speeds.into_iter().filter_map(limit).collect(),
        false => BTreeMap::new(),
    };
    let lanes = lanes.iter().filter(|lane| lane.site == site);
    Ok(Graph::of(lanes, &limits).json().to_string())
}

#[derive(Default)]
struct Graph {
    nodes: Vec<[f64; 2]>,
    /// From, to, and what is known of it.
    edges: Vec<(usize, usize, Option<f64>)>,
}

impl Graph {
    fn of<'l>(lanes: impl Iterator<Item = &'l Lane>, limits: &BTreeMap<u32, f64>) -> Self {
        let mut graph = Self::default();
        let mut shared: BTreeMap<u32, usize> = BTreeMap::new();
        for lane in lanes {
            let [Some(first), Some(last)] = [lane.points.first(), lane.points.last()] else {
                continue;
            };
            let mut end = |node: u32, at: &[f64; 3], graph: &mut Self| {
                *shared.entry(node).or_insert_with(|| graph.node(at))
            };
            let start = end(lane.start_node, first, &mut graph);
            let inner = lane.points.iter().skip(1);
            let inner = inner.take(lane.points.len().saturating_sub(2));
            let mut way = vec![start];
            way.extend(inner.map(|point| graph.node(point)));
            way.push(end(lane.end_node, last, &mut graph));
            let limit = limits.get(&lane.lane).copied();
            for pair in way.windows(2) {
                if lane.direction != "backward" {
                    graph.edges.push((pair[0], pair[1], limit));
                }
                if lane.direction != "forward" {
                    graph.edges.push((pair[1], pair[0], limit));
                }
            }
        }
        graph
    }

    fn node(&mut self, [x, y, _]: &[f64; 3]) -> usize {
        self.nodes.push([*x, *y]);
        self.nodes.len() - 1
    }

    fn json(&self) -> Value {
        let node = |(id, at): (usize, &[f64; 2])| {
            json!({
                "type": "Feature",
                "properties": { "id": id, "frame": "map" },
                "geometry": { "type": "Point", "coordinates": at },
            })
        };
        let edge = |(id, (from, to, limit)): (usize, &(usize, usize, Option<f64>))| {
            let [a, b] = [*from, *to].map(|node| self.nodes[node]);
            let length_m = (a[0] - b[0]).hypot(a[1] - b[1]);
            let mut properties =
                json!({ "id": id, "startid": from, "endid": to, "cost": length_m });
            if let Some(limit) = limit {
                properties["metadata"] = json!({ "speed_limit": limit });
            }
            json!({
                "type": "Feature",
                "properties": properties,
                "geometry": { "type": "MultiLineString", "coordinates": [[a, b]] },
            })
        };
        let nodes = self.nodes.iter().enumerate().map(node);
        // Numbers of nodes and edges are told apart.
        let edges = (self.nodes.len()..).zip(&self.edges).map(edge);
        json!({
            "type": "FeatureCollection",
            "name": "graph",
            "features": nodes.chain(edges).collect::<Vec<_>>(),
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use evermap_schemas::Wkb;
    use std::collections::BTreeSet;

    fn lane(lane: u32, nodes: [u32; 2], direction: &str, points: &[[f64; 3]]) -> Lane {
        Lane {
            site: "lot".into(),
            lane,
            start_node: nodes[0],
            end_node: nodes[1],
            start_kind: "intersection".into(),
            end_kind: "dead_end".into(),
            direction: direction.into(),
            forward_passes: 1,
            backward_passes: 0,
            length_m: 1.0,
            width_m: 2.0,
            next_lanes: Vec::new(),
            next_lanes_backward: Vec::new(),
            points: points.to_vec(),
            sources: Vec::new(),
            geometry: Wkb::point([0.0; 3]),
        }
    }

    #[test]
    fn a_route_goes_on_where_lanes_share_a_node_and_only_the_way_they_are_driven() {
        let lanes = [
            lane(
                0,
                [7, 9],
                "forward",
                &[[0.0, 0.0, 1.0], [3.0, 4.0, 1.0], [6.0, 4.0, 1.0]],
            ),
            lane(1, [9, 8], "both", &[[6.0, 4.0, 1.0], [6.0, 9.0, 1.0]]),
        ];
        let graph = Graph::of(lanes.iter(), &[(1, 50.0)].into()).json();
        let features = graph["features"].as_array().unwrap();
        let of = |kind: &str| -> Vec<&Value> {
            let all = features.iter();
            all.filter(|one| one["geometry"]["type"] == kind).collect()
        };
        let (nodes, edges) = (of("Point"), of("MultiLineString"));
        assert_eq!((nodes.len(), edges.len()), (4, 4));
        let ids: BTreeSet<u64> = features
            .iter()
            .map(|one| one["properties"]["id"].as_u64().unwrap())
            .collect();
        assert_eq!(ids.len(), features.len(), "no number is used twice");
        let place = |id: &Value| {
            let node = nodes.iter().find(|node| node["properties"]["id"] == *id);
            node.unwrap()["geometry"]["coordinates"].clone()
        };
        for edge in &edges {
            let line = &edge["geometry"]["coordinates"][0];
            let known = &edge["properties"];
            assert_eq!(line[0], place(&known["startid"]));
            assert_eq!(line[1], place(&known["endid"]));
        }
        assert_eq!(edges[0]["properties"]["cost"], 5.0);
        assert_eq!(edges[0]["properties"].get("metadata"), None);
        assert_eq!(edges[3]["properties"]["metadata"]["speed_limit"], 50.0);
        // From the start to the far end, and from there back to where the lanes meet, no farther.
        let reached = |from: &Value| {
            let mut found = vec![from.clone()];
            let mut at = 0;
            while at < found.len() {
                let here = found[at].clone();
                for edge in edges
                    .iter()
                    .filter(|edge| edge["properties"]["startid"] == here)
                {
                    let next = edge["properties"]["endid"].clone();
                    if !found.contains(&next) {
                        found.push(next);
                    }
                }
                at += 1;
            }
            found.len()
        };
        assert_eq!(reached(&json!(0)), 4);
        assert_eq!(reached(&json!(3)), 2);
    }
}
