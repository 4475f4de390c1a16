//! Plans that build on plans, defaults, ports that are not named, and plans as printed.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod vocabulary;

use std::collections::BTreeMap;

use evermap_language::{Body, Input, Plan, PlanFaults, parse};
use proptest::prelude::*;
use serde_json::{Value, json};

const BASE: &str = include_str!("faults/base.plan");

fn read(text: &str, others: &[(&str, &str)]) -> Result<Plan, PlanFaults> {
    read_set(text, others, &[])
}

fn read_set(text: &str, others: &[(&str, &str)], settings: &[&str]) -> Result<Plan, PlanFaults> {
    let settings: Vec<String> = settings.iter().map(|s| (*s).to_owned()).collect();
    let host = vocabulary::Plans(others.to_vec());
    let source = vocabulary::source("plan.yaml", text);
    parse(&source, &settings, &vocabulary::vocabulary(), &host)
}

fn params(plan: &Plan, step: &str) -> Value {
    match &plan.step(step).unwrap().body {
        Body::Op { params, .. } => params.clone(),
        Body::Sql { .. } | Body::Python(_) => panic!("{step} is no operator"),
    }
}

fn inputs(plan: &Plan, step: &str) -> BTreeMap<String, Input> {
    plan.step(step).unwrap().inputs.clone()
}

#[test]
fn a_plan_takes_all_of_another_but_its_name_and_its_tests() {
    let plan = read("plan: same\nextends: base\n", &[("base", BASE)]).unwrap();
    let base = read(BASE, &[]).unwrap();
    assert_eq!((plan.name.as_str(), base.name.as_str()), ("same", "base"));
    assert_eq!(base.tests.len(), 1);
    assert!(plan.tests.is_empty());
    assert_eq!(plan.doc, base.doc);
    assert_eq!(plan.write, base.write);
    let body = |plan: &Plan| -> Vec<Body> { plan.steps.iter().map(|s| s.body.clone()).collect() };
    assert_eq!(body(&plan), body(&base));
}

#[test]
fn steps_are_added_replaced_changed_and_dropped() {
    let text = "\
plan: changed
extends: base
doc: Own.
sessions: own.yaml
defaults: { most_frames: 7 }
drop: [count]
steps:
  keys: { with: { baseline_m: 0.5 }, in: }
  lanes:
    in: { lanes: previous.lanes, poses: smooth }
    with: { connect_m: 2 }
  smooth: { sql: SELECT * FROM poses }
write: [smooth, lanes]
tests:
  - { name: own, expect: { lanes: [] } }
";
    let plan = read_set(text, &[("base", BASE)], &["lanes.prune_loops=5"]).unwrap();
    assert!(plan.warnings.is_empty(), "{}", plan.warnings);
    assert_eq!(plan.doc.as_deref(), Some("Own."));
    assert_eq!(plan.write, ["keys", "lanes", "smooth"]);
    assert_eq!(plan.tests.len(), 1);
    assert!(plan.step("count").is_none());
    assert_eq!(
        params(&plan, "keys"),
        json!({"most_frames": 7, "baseline_m": 0.5})
    );
    assert_eq!(
        params(&plan, "lanes"),
        json!({"prune_loops": 5, "connect_m": 2})
    );
    let expected = [
        ("lanes".to_owned(), Input::Previous("lanes".to_owned())),
        ("poses".to_owned(), Input::Step("smooth".to_owned())),
    ];
    assert_eq!(inputs(&plan, "lanes"), BTreeMap::from(expected));
    let position = |step: &str| plan.step(step).unwrap().position;
    assert_eq!((position("keys").source, position("keys").line), (1, 5));
    assert_eq!(
        (position("smooth").source, position("smooth").line),
        (0, 12)
    );

    let text = "plan: replaced\nextends: base\nsteps:\n  lanes: { sql: SELECT * FROM poses }\n";
    let plan = read(text, &[("base", BASE)]).unwrap();
    let query = "SELECT * FROM poses".to_owned();
    let lanes = plan.step("lanes").unwrap();
    assert_eq!(lanes.body, Body::Sql { query });
    assert_eq!(lanes.inputs["poses"], Input::Source("poses".to_owned()));
}

#[test]
fn a_preset_is_laid_over_steps_where_it_is_named() {
    let base = format!(
        "{BASE}presets:\n  fast:\n    keys: {{ baseline_m: 2.0 }}\n    lanes: {{ prune_loops: 5, connect_m: 4.0 }}\n"
    );
    let others = [("base", base.as_str())];
    let text = "\
plan: own
extends: base
drop: [count]
presets:
  fast: { lanes: { connect_m: 3.0 } }
  far: { keys: { baseline_m: 9.0 } }
";
    let set = |settings: &[&str]| {
        let plan = read_set(text, &others, settings).unwrap();
        (params(&plan, "keys"), params(&plan, "lanes"))
    };
    let plain = json!({"prune_loops": 2, "connect_m": 1.0});
    assert_eq!(set(&[]), (json!({}), plain));
    let fast = json!({"prune_loops": 5, "connect_m": 3.0});
    assert_eq!(set(&["fast"]), (json!({"baseline_m": 2.0}), fast.clone()));
    // A later setting wins.
    assert_eq!(set(&["fast", "far"]).0, json!({"baseline_m": 9.0}));
    assert_eq!(
        set(&["fast", "keys.baseline_m=1"]).0,
        json!({"baseline_m": 1})
    );
    assert_eq!(
        set(&["keys.baseline_m=1", "fast"]).0,
        json!({"baseline_m": 2.0})
    );
    // A preset of the base may be of a step that is dropped.
    let dropped = text
        .replace("[count]", "[lanes, count]")
        .replace("fast: { lanes: { connect_m: 3.0 } }", "slow: {}");
    let plan = read_set(&dropped, &others, &["fast"]).unwrap();
    assert_eq!(params(&plan, "keys"), json!({"baseline_m": 2.0}));
}

#[test]
fn the_manifest_of_an_extended_plan_stays_relative_to_it() {
    let base = "plan: base\nsessions: logs.yaml\nsteps: { a: { sql: SELECT 1 } }\nwrite: [a]\n";
    let plan = read("plan: p\nextends: base\n", &[("base", base)]).unwrap();
    let sessions = plan.sessions.unwrap();
    assert_eq!(
        (sessions.path.as_str(), sessions.origin.as_str()),
        ("logs.yaml", "base.yaml")
    );
    assert_eq!(sessions.from_plan, "logs.yaml");
    let plan = read("plan: p\nextends: ours/base\n", &[("ours/base", base)]).unwrap();
    let sessions = plan.sessions.unwrap();
    assert_eq!(
        (sessions.path.as_str(), sessions.from_plan.as_str()),
        ("logs.yaml", "ours/logs.yaml")
    );
}

#[test]
fn plans_extend_plans_that_extend_plans_up_to_a_limit() {
    let others: Vec<(String, String)> = (0..20)
        .map(|n| (format!("p{n}"), format!("plan: p\nextends: p{}\n", n + 1)))
        .collect();
    let mut others: Vec<(&str, &str)> = others
        .iter()
        .map(|(name, text)| (name.as_str(), text.as_str()))
        .collect();
    others[9].1 = BASE;
    let plan = read("plan: p\nextends: p0\nwrite: [lanes]\n", &others).unwrap();
    assert_eq!(plan.step("keys").unwrap().position.source, 10);
    others[9].1 = "plan: p\nextends: p10\n";
    let faults = read("plan: p\nextends: p0\n", &others).unwrap_err();
    assert_eq!(faults.error_count(), 1);
    assert!(
        faults
            .to_string()
            .starts_with("p14.yaml:2:10: plans extend each other"),
        "{faults}"
    );
}

#[test]
fn defaults_are_below_what_a_step_says_and_of_the_nearest_plan() {
    let base = "\
plan: base
defaults: { connect_m: 1, prune_loops: 1 }
steps:
  a: { op: road_network }
  b: { op: road_network, with: { connect_m: 5 } }
  keys: { op: keyframes }
write: [a, b, keys]
";
    let plan = read(base, &[]).unwrap();
    assert_eq!(
        params(&plan, "a"),
        json!({"connect_m": 1, "prune_loops": 1})
    );
    assert_eq!(
        params(&plan, "b"),
        json!({"prune_loops": 1, "connect_m": 5})
    );
    assert_eq!(params(&plan, "keys"), json!({}));
    let text = "plan: p\nextends: base\ndefaults: { connect_m: 2 }\n";
    let plan = read_set(text, &[("base", base)], &["a.prune_loops=9"]).unwrap();
    assert_eq!(
        params(&plan, "a"),
        json!({"connect_m": 2, "prune_loops": 9})
    );
    assert_eq!(
        params(&plan, "b"),
        json!({"prune_loops": 1, "connect_m": 5})
    );
}

#[test]
fn a_port_that_is_not_named_takes_the_table_of_its_name_unless_it_is_optional() {
    let text = "\
plan: p
steps:
  tiles: { op: overhead_tiles, in: { patches: ~ } }
  patches: { op: keyframes }
  lanes: { op: road_network, with: { connect_m: 1 } }
  again: { op: road_network, in: { lanes: lanes }, with: { connect_m: 1 } }
write: [tiles, again]
";
    let plan = read(text, &[]).unwrap();
    let one = |port: &str, input| BTreeMap::from([(port.to_owned(), input)]);
    let step = |name: &str| Input::Step(name.to_owned());
    let source = |name: &str| Input::Source(name.to_owned());
    // Neither `calibration`, a source, nor `lanes`, the step itself: these ports are optional.
    assert_eq!(inputs(&plan, "tiles"), one("patches", step("patches")));
    assert_eq!(inputs(&plan, "lanes"), one("poses", source("poses")));
    assert_eq!(inputs(&plan, "patches").len(), 2);
    assert_eq!(inputs(&plan, "again").len(), 2);
    assert_eq!(inputs(&plan, "again")["lanes"], step("lanes"));

    // The step itself is never meant.
    let text = "plan: p\nsteps:\n  patches: { op: overhead_tiles }\nwrite: [patches]\n";
    let faults = read(text, &[]).unwrap_err().to_string();
    let expected =
        "plan.yaml:3:18: port `patches` is not connected, and no other table has its name\n";
    assert_eq!(faults, expected);
}

/// What a random plan says of one step: nothing, its drop, or a new query.
#[derive(Debug, Clone)]
enum Change {
    None,
    Drop,
    Query(usize),
}

/// A plan of the queries `SELECT number`, all written.
fn written(name: &str, queries: &BTreeMap<String, usize>, head: &str) -> String {
    let mut text = format!("plan: {name}\n{head}");
    if !queries.is_empty() {
        text.push_str("steps:\n");
    }
    for (step, number) in queries {
        text.push_str(&format!("  {step}: {{ sql: SELECT {number} }}\n"));
    }
    if !queries.is_empty() {
        let steps: Vec<&str> = queries.keys().map(String::as_str).collect();
        text.push_str(&format!("write: [{}]\n", steps.join(", ")));
    }
    text
}

fn changes() -> impl Strategy<Value = Vec<Change>> {
    let change = prop_oneof![
        Just(Change::None),
        Just(Change::Drop),
        (0_usize..100).prop_map(Change::Query),
    ];
    prop::collection::vec(change, 6)
}

proptest! {
    /// A chain of plans does what the plan does that has all their changes applied by hand.
    #[test]
    fn a_composed_plan_is_the_plan_written_whole(chain in prop::collection::vec(changes(), 1..5)) {
        let mut whole = BTreeMap::from([("kept".to_owned(), 0)]);
        let mut plans = vec![("p0".to_owned(), written("p0", &whole, ""))];
        for (number, changes) in chain.iter().enumerate() {
            let mut dropped = Vec::new();
            let mut queries = BTreeMap::new();
            for (step, change) in changes.iter().enumerate() {
                let step = format!("s{step}");
                match change {
                    Change::Drop if whole.remove(&step).is_some() => dropped.push(step),
                    Change::None | Change::Drop => {}
                    Change::Query(query) => {
                        whole.insert(step.clone(), *query);
                        queries.insert(step, *query);
                    }
                }
            }
            let head = format!("extends: p{number}\ndrop: [{}]\n", dropped.join(", "));
            let name = format!("p{}", number + 1);
            plans.push((name.clone(), written(&name, &queries, &head)));
        }
        let others: Vec<(&str, &str)> = plans.iter().map(|(n, t)| (n.as_str(), t.as_str())).collect();
        let composed = read(&plans.last().unwrap().1, &others).unwrap();
        let naive = read(&written("whole", &whole, ""), &[]).unwrap();
        let bodies = |plan: &Plan| -> BTreeMap<String, Body> {
            let body = |step: &evermap_language::Step| (step.name.clone(), step.body.clone());
            plan.steps.iter().map(body).collect()
        };
        prop_assert_eq!(bodies(&composed), bodies(&naive));
        let mut write = composed.write.clone();
        write.sort();
        let mut expected = naive.write.clone();
        expected.sort();
        prop_assert_eq!(write, expected);
    }

    /// Printing loses nothing: whatever texts a plan has, the print reads as the same plan.
    #[test]
    fn a_printed_plan_is_the_same_plan(
        doc in any::<String>(), query in "[ \\n]{0,2}[a-z:#'\"{|> \\n\t-]{0,40}", long in "( ?[a-z:#'-]{1,9}){0,60}", camera in any::<String>(),
        number in any::<f64>(), whole in any::<i64>(),
    ) {
        let text = json!({
            "plan": "p", "doc": doc, "sessions": camera,
            "steps": {
                "keys": {"op": "keyframes", "once": whole % 2 == 0, "with": {"cameras": [camera, whole, null, {"a b": {}}], "baseline_m": 1}},
                "tiles": {"op": "overhead_tiles", "in": {"patches": "/odom-etry"}, "with": {"zooms": [number]}},
                "query": {"sql": format!("SELECT {query}"), "once": whole % 3 == 0},
                "more": {"sql": format!("SELECT {long}")},
                "made": {
                    "python": "steps.py:whole", "in": {"keys": "keys", "tiles": "previous.tiles"}, "grain": "site",
                    "with": {"number": number, "text": camera}, "pixels": {"keys": camera},
                    "output": {"x": camera, "y": {"z": "f64"}}, "once": whole % 5 == 0,
                },
            },
            "needs": ["odometry"],
            "write": ["keys", "tiles", "query", "more", "made"],
        });
        let Ok(plan) = read(&text.to_string(), &[]) else {
            return Err(TestCaseError::reject("not YAML"));
        };
        let printed = plan.to_string();
        let mut again = read(&printed, &[]).unwrap();
        // What is said of places is said of other ones.
        again.warnings = plan.warnings.clone();
        for (again, step) in again.steps.iter_mut().zip(&plan.steps) {
            (again.position, again.body_location) = (step.position, step.body_location);
        }
        prop_assert_eq!(&again, &plan, "{}", printed);
    }
}

#[test]
fn a_plan_is_printed_for_people() {
    let text = "\
plan: tidy
extends: base
steps:
  lanes: { with: { prune_loops: 4 } }
  tiles:
    op: overhead_tiles
    in: { patches: previous.keys }
    with: { grid: { square: { cell_m: .5 } }, weighting: 'true' }
  both:
    sql: |
      SELECT * FROM lanes
        JOIN tiles
write: [both]
";
    let plan = read(text, &[("base", BASE)]).unwrap();
    let expected = "\
plan: tidy
doc: |-
  What other plans extend.
steps:
  keys:
    op: keyframes
    in: { frames: frames, odometry: odometry }
  lanes:
    op: road_network
    in: { poses: poses }
    with: { connect_m: 1.0, prune_loops: 4 }
  count:
    sql: |-
      SELECT * FROM lanes
  tiles:
    op: overhead_tiles
    in: { patches: previous.keys }
    with: { grid: { square: { cell_m: 0.5 } }, weighting: \"true\" }
  both:
    sql: |
      SELECT * FROM lanes
        JOIN tiles
write: [keys, lanes, count, both]
";
    assert_eq!(plan.to_string(), expected);
    assert_eq!(read(expected, &[]).unwrap().to_string(), expected);
}
