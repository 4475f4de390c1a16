//! Read back with an XML parser and held against the pages of Lanelet2 field by field.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use super::*;
use evermap_schemas::{Wkb, batch};
use roxmltree::{Document, Node};

fn lane(
    lane: u32,
    direction: &str,
    nodes: [u32; 2],
    points: Vec<[f64; 3]>,
    next: [&[u32]; 2],
) -> Lane {
    Lane {
        site: "lot".into(),
        lane,
        start_node: nodes[0],
        end_node: nodes[1],
        start_kind: "intersection".into(),
        end_kind: "intersection".into(),
        direction: direction.into(),
        forward_passes: 1,
        backward_passes: 0,
        length_m: 10.0,
        width_m: 2.5,
        next_lanes: next[0].to_vec(),
        next_lanes_backward: next[1].to_vec(),
        sources: vec![],
        geometry: Wkb::line_string(&points),
        points,
    }
}

/// A trunk into a fork, one branch of it listed from its end, and a lane across that nobody turned into.
fn fork() -> Vec<Lane> {
    let east = |x: f64| [x, 0.0, 0.1];
    vec![
        lane(
            0,
            "forward",
            [0, 1],
            vec![east(0.0), east(5.0), east(10.0)],
            [&[1, 2], &[]],
        ),
        lane(
            1,
            "forward",
            [1, 2],
            vec![east(10.0), east(15.0), east(20.0)],
            [&[], &[]],
        ),
        lane(
            2,
            "backward",
            [3, 1],
            vec![[20.0, 6.0, 0.1], [14.0, 2.0, 0.1], east(10.0)],
            [&[], &[]],
        ),
        lane(
            3,
            "both",
            [1, 4],
            vec![east(10.0), [10.0, 8.0, 0.1]],
            [&[4], &[]],
        ),
        lane(
            4,
            "both",
            [4, 5],
            vec![[10.0, 8.0, 0.1], [10.0, 16.0, 0.1]],
            [&[], &[3]],
        ),
    ]
}

fn tags<'a>(node: Node<'a, '_>) -> BTreeMap<&'a str, &'a str> {
    let tags = node.children().filter(|child| child.has_tag_name("tag"));
    tags.map(|tag| (tag.attribute("k").unwrap(), tag.attribute("v").unwrap()))
        .collect()
}

/// What a loader makes of the file: nodes by id, bounds by id, lanelets.
struct Loaded {
    nodes: BTreeMap<u64, [f64; 3]>,
    lanelets: Vec<([Vec<u64>; 2], bool)>,
}

fn number<T: std::str::FromStr>(text: &str) -> T {
    text.parse()
        .unwrap_or_else(|_| panic!("expected a number, found {text}"))
}

fn load(text: &str) -> Loaded {
    let document = Document::parse(text).unwrap();
    let osm = document.root_element();
    assert_eq!(
        (osm.tag_name().name(), osm.attribute("version")),
        ("osm", Some("0.6"))
    );
    let elements =
        |name: &'static str| osm.children().filter(move |child| child.has_tag_name(name));
    let id = |node: &Node<'_, '_>| -> u64 { number(node.attribute("id").unwrap()) };
    let mut ids = std::collections::BTreeSet::new();
    for element in osm
        .children()
        .filter(|child| child.attribute("id").is_some())
    {
        assert!(
            id(&element) > 0 && ids.insert(id(&element)),
            "ids are positive and unique"
        );
    }
    let nodes = elements("node").map(|node| {
        let [lat, lon] = ["lat", "lon"].map(|name| number::<f64>(node.attribute(name).unwrap()));
        assert!(lat.abs() <= 90.0 && lon.abs() <= 180.0);
        let tags = tags(node);
        let place = ["local_x", "local_y", "ele"].map(|key| number::<f64>(tags[key]));
        assert_eq!(tags.len(), 3);
        assert!(
            (lon * DEGREE_M - place[0]).abs() < 1e-3 && (lat * DEGREE_M - place[1]).abs() < 1e-3
        );
        (id(&node), place)
    });
    let nodes: BTreeMap<u64, [f64; 3]> = nodes.collect();
    let ways = elements("way").map(|way| {
        assert_eq!(tags(way), BTreeMap::from([("type", "virtual")]));
        let refs = way.children().filter(|child| child.has_tag_name("nd"));
        let refs: Vec<u64> = refs
            .map(|nd| number(nd.attribute("ref").unwrap()))
            .collect();
        assert!(refs.len() > 1 && refs.iter().all(|node| nodes.contains_key(node)));
        (id(&way), refs)
    });
    let ways: BTreeMap<u64, Vec<u64>> = ways.collect();
    let lanelets = elements("relation").map(|relation| {
        let tags = tags(relation);
        assert_eq!(
            (tags["type"], tags["subtype"], tags["location"]),
            ("lanelet", "road", "urban")
        );
        assert_eq!(tags.len(), 4);
        let members: Vec<_> = relation
            .children()
            .filter(|child| child.has_tag_name("member"))
            .collect();
        assert_eq!(members.len(), 2, "a lanelet with other members is an error");
        let bound = |role: &str| {
            let member = members
                .iter()
                .find(|m| m.attribute("role") == Some(role))
                .unwrap();
            assert_eq!(member.attribute("type"), Some("way"));
            ways[&number(member.attribute("ref").unwrap())].clone()
        };
        let one_way = match tags["one_way"] {
            "yes" => true,
            "no" => false,
            other => panic!("{other}"),
        };
        ([bound("left"), bound("right")], one_way)
    });
    Loaded {
        lanelets: lanelets.collect(),
        nodes,
    }
}

/// Whether one lanelet follows the other: it begins with the nodes that the other ends with.
fn follows(before: &[Vec<u64>; 2], after: &[Vec<u64>; 2]) -> bool {
    (0..2).all(|side| before[side].last() == after[side].first())
}

#[test]
fn a_loader_finds_lanelets_their_bounds_and_what_follows() {
    let text = text(&[batch(fork()).unwrap()], None, 7).unwrap();
    let loaded = load(&text);
    assert_eq!(loaded.lanelets.len(), 5);
    assert!(text.contains("map_version=\"7\""));
    let one_way: Vec<bool> = loaded.lanelets.iter().map(|lanelet| lanelet.1).collect();
    assert_eq!(one_way, [true, true, true, false, false]);
    let bounds: Vec<&[Vec<u64>; 2]> = loaded.lanelets.iter().map(|lanelet| &lanelet.0).collect();
    let mut following = Vec::new();
    for (a, before) in bounds.iter().enumerate() {
        for (b, after) in bounds.iter().enumerate() {
            if follows(before, after) {
                following.push((a, b));
            }
        }
    }
    // The lane across shares no bound with the others, though it begins at the same node.
    assert_eq!(following, [(0, 1), (0, 2), (3, 4)]);
    for (lane, [left, right]) in fork().iter().zip(&bounds) {
        let mut points = lane.points.clone();
        if lane.direction == "backward" {
            points.reverse();
        }
        assert_eq!((left.len(), right.len()), (points.len(), points.len()));
        for ((left, right), at) in left.iter().zip(right).zip(0..) {
            let [left, right] = [left, right].map(|id| loaded.nodes[id]);
            let middle = [0, 1, 2].map(|k| 0.5 * (left[k] + right[k]));
            assert!(
                (0..3).all(|k| (middle[k] - points[at][k]).abs() < 1e-3),
                "{middle:?}"
            );
            let across = [left[0] - right[0], left[1] - right[1]];
            assert!((across[0].hypot(across[1]) - 2.5).abs() < 1e-3);
            // Left is left of the way that it is driven.
            let way = course(&points, at);
            assert!(way[0] * across[1] - way[1] * across[0] > 0.0);
        }
    }
}

#[test]
fn a_ring_closes_and_several_sites_need_a_choice() {
    let corner = |k: f64| [20.0 * k.cos(), 20.0 * k.sin(), 0.0];
    let points = (0..=40)
        .map(|k| corner(std::f64::consts::TAU * f64::from(k) / 40.0))
        .collect();
    let mut ring = lane(0, "forward", [0, 0], points, [&[], &[]]);
    ring.start_kind = "loop".into();
    ring.end_kind = "loop".into();
    let loaded = load(&text(&[batch(vec![ring.clone()]).unwrap()], None, 1).unwrap());
    let bounds = &loaded.lanelets[0].0;
    assert!(follows(bounds, bounds));
    let other = Lane {
        site: "elsewhere".into(),
        ..ring.clone()
    };
    assert!(text(&[batch(vec![ring, other]).unwrap()], None, 1).is_err());
}
