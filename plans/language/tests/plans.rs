//! What a sound plan becomes.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod vocabulary;

use evermap_language::{Body, Input, Plan, PlanFaults, Severity, parse, utf8};
use proptest::prelude::*;
use serde_json::{Value, json};

fn read(text: &str, settings: &[&str]) -> Result<Plan, PlanFaults> {
    read_with(text, settings, &[])
}

/// Reads a plan where there are others, by name.
fn read_with(text: &str, settings: &[&str], others: &[(&str, &str)]) -> Result<Plan, PlanFaults> {
    let settings: Vec<String> = settings.iter().map(|s| (*s).to_owned()).collect();
    let source = vocabulary::source("plan.yaml", text);
    let host = vocabulary::Plans(others.to_vec());
    parse(&source, &settings, &vocabulary::vocabulary(), &host)
}

const PLAN: &str = "\
plan: car_park
doc: Two lines
  of text.
needs: [odometry, frames]
sessions: datasets/manifests/car_park.yaml
steps:
  relabelled: { sql: 'SELECT * FROM tiles JOIN previous.more JOIN \"/odom\" JOIN tiles' }
  tiles:
    op: overhead_tiles
    in: &ports { patches: keys }
    with: { camera: { model: pinhole, fx_px: 1, fy_px: 2e2 }, grid: { square: { cell_m: .5 } } }
  more:
    op: overhead_tiles
    in: *ports
  keys:
    op: keyframes
    in: { odometry: odometry, frames: frames }
    with: { baseline_m: 1 }
write: [relabelled, more]
tests:
  - name: one
    given: { keys: [ { site: s, stamp: 0 } ], previous.more: [] }
    expect: { more: [ { site: s } ] }
    tolerance: 1e-6
";

#[test]
fn a_sound_plan_is_read_whole() {
    let plan = read(PLAN, &[]).unwrap();
    assert!(plan.warnings.is_empty(), "{}", plan.warnings);
    assert_eq!(plan.name, "car_park");
    assert_eq!(plan.doc.as_deref(), Some("Two lines of text."));
    assert_eq!(plan.needs, ["odometry", "frames"]);
    let sessions = plan.sessions.as_ref().unwrap();
    assert_eq!(sessions.path, "datasets/manifests/car_park.yaml");
    assert_eq!(sessions.origin, "plan.yaml");
    assert_eq!(plan.write, ["relabelled", "more"]);
    let order: Vec<&str> = plan.steps.iter().map(|step| step.name.as_str()).collect();
    assert_eq!(order, ["keys", "tiles", "relabelled", "more"]);
    let tiles = plan.step("tiles").unwrap();
    assert_eq!((tiles.position.line, tiles.position.column), (8, 3));
    let Body::Op { op, params } = &tiles.body else {
        panic!("{tiles:?}")
    };
    assert_eq!(op, "overhead_tiles");
    assert_eq!(tiles.inputs["patches"], Input::Step("keys".into()));
    let expected = json!({
        "camera": {"model": "pinhole", "fx_px": 1, "fy_px": 200.0},
        "grid": {"square": {"cell_m": 0.5}},
    });
    assert_eq!(params, &expected);
    let parameters: vocabulary::Tiles = serde_json::from_value(params.clone()).unwrap();
    assert_eq!(
        parameters.grid,
        Some(vocabulary::Grid::Square { cell_m: 0.5 })
    );
    let relabelled = &plan.step("relabelled").unwrap().inputs;
    assert_eq!(
        relabelled.values().collect::<Vec<_>>(),
        [
            &Input::Source("/odom".into()),
            &Input::Previous("more".into()),
            &Input::Step("tiles".into()),
        ]
    );
    let test = &plan.tests[0];
    assert_eq!(test.given[0].0, Input::Step("keys".into()));
    assert_eq!(test.expect[0].1[0]["site"], json!("s"));
    assert_eq!(test.tolerance, 1e-6);
}

#[test]
fn settings_replace_parameters_and_are_checked_like_them() {
    let settings = [
        "keys.baseline_m=0.5",
        "tiles.camera.fx_px=7",
        "more.zooms=[1, 2]",
        "keys.baseline_m=0.75",
    ];
    let plan = read(PLAN, &settings).unwrap();
    let value = |step: &str, pointer: &str| match &plan.step(step).unwrap().body {
        Body::Op { params, .. } => params.pointer(pointer).cloned().unwrap(),
        Body::Sql { .. } | Body::Python(_) => panic!("{step} is no operator"),
    };
    assert_eq!(value("keys", "/baseline_m"), json!(0.75));
    assert_eq!(value("tiles", "/camera/fx_px"), json!(7));
    assert_eq!(value("tiles", "/camera/fy_px"), json!(200.0));
    assert_eq!(value("more", "/zooms"), json!([1, 2]));
    let faults = read(PLAN, &["keys.baseline_m=-1"]).unwrap_err();
    assert_eq!(
        faults.to_string(),
        "--set keys.baseline_m=-1: expected `baseline_m` above 0, found -1\n"
    );
}

#[test]
fn bytes_that_are_not_utf8_are_a_fault_where_they_are() {
    let faults = utf8(b"plan: x\ndoc: \xc3\xa4\xff", "p.yaml").unwrap_err();
    assert_eq!(
        faults.to_string(),
        "p.yaml:2:7: not UTF-8 text; save the file as UTF-8\n"
    );
    assert_eq!(utf8("ä".as_bytes(), "p.yaml"), Ok("ä"));
}

#[test]
fn many_faults_are_counted_and_many_steps_are_quick() {
    let mut text = String::from("plan: many\nsteps:\n");
    for step in 0..4000 {
        text.push_str(&format!(
            "  s{step}: {{ sql: SELECT * FROM t{step}_missing }}\n"
        ));
    }
    text.push_str("write: [s0]\n");
    let faults = read(&text, &[]).unwrap_err();
    assert_eq!(faults.error_count(), 4000);
    assert!(faults.to_string().ends_with("… and 3000 more\n"));
}

/// A plan of queries in which step `i` reads the steps `reads[i]`.
fn queries(reads: &[Vec<usize>]) -> String {
    let mut text = String::from("plan: graph\nsteps:\n");
    for (step, inputs) in reads.iter().enumerate() {
        let inputs: Vec<String> = inputs.iter().map(|input| format!("s{input}")).collect();
        let query = match inputs.is_empty() {
            true => "SELECT 1".to_owned(),
            false => format!("SELECT * FROM {}", inputs.join(" JOIN ")),
        };
        text.push_str(&format!("  s{step}: {{ sql: {query} }}\n"));
    }
    text.push_str("write: [s0]\n");
    text
}

/// The order by definition: again and again the first written step whose inputs are done.
fn naive_order(reads: &[Vec<usize>]) -> Option<Vec<usize>> {
    let mut order = Vec::new();
    while order.len() < reads.len() {
        let ready = (0..reads.len()).find(|step| {
            !order.contains(step) && reads[*step].iter().all(|input| order.contains(input))
        });
        order.push(ready?);
    }
    Some(order)
}

proptest! {
    #[test]
    fn the_order_is_the_naive_one_and_cycles_are_cycles(
        reads in (1_usize..12).prop_flat_map(|steps| {
            prop::collection::vec(prop::collection::vec(0..steps, 0..3), steps)
        })
    ) {
        match (read(&queries(&reads), &[]), naive_order(&reads)) {
            (Ok(plan), Some(order)) => {
                let found: Vec<String> = plan.steps.iter().map(|s| s.name.clone()).collect();
                let expected: Vec<String> = order.iter().map(|s| format!("s{s}")).collect();
                prop_assert_eq!(found, expected);
                let warnings = plan.warnings.iter();
                prop_assert!(warnings.into_iter().all(|w| w.severity == Severity::Warning));
            }
            (Err(faults), None) => {
                prop_assert!(faults.error_count() > 0);
                for fault in faults.errors() {
                    let path = fault.message.strip_prefix("steps form a cycle: ").unwrap();
                    let steps: Vec<usize> = path
                        .split(" reads ")
                        .map(|name| name.trim_matches('`')[1..].parse().unwrap())
                        .collect();
                    prop_assert_eq!(steps.first(), steps.last());
                    for pair in steps.windows(2) {
                        prop_assert!(reads[pair[0]].contains(&pair[1]));
                    }
                }
            }
            (found, expected) => prop_assert!(false, "{:?} but {:?}", found, expected),
        }
    }
}

#[test]
fn the_schema_for_editors_knows_operators_ports_and_parameters() {
    let schema = evermap_language::json_schema(&vocabulary::vocabulary());
    let step = &schema["$defs"]["step"];
    assert_eq!(
        step["properties"]["op"]["oneOf"][0],
        json!({"const": "keyframes", "description": "A frame every so many metres."})
    );
    let tiles = &step["allOf"][1];
    assert_eq!(tiles["if"]["properties"]["op"]["const"], "overhead_tiles");
    let ports = &tiles["then"]["properties"]["in"]["properties"];
    assert_eq!(ports["patches"], json!({"$ref": "#/$defs/input"}));
    let with = &schema["$defs"]["keyframes.with"];
    assert_eq!(with["properties"]["baseline_m"]["default"], json!(0.2));
    assert_eq!(with["additionalProperties"], json!(false));
    assert_eq!(
        schema["$defs"]["road_network.with"]["required"],
        json!(["connect_m"])
    );
    check_references(&schema, &schema);
    if let Some(path) = std::env::var_os("EVERMAP_SCHEMA_OUT") {
        std::fs::write(path, schema.to_string()).unwrap();
    }
}

fn check_references(value: &Value, root: &Value) {
    if let Some(reference) = value.get("$ref").and_then(Value::as_str) {
        assert!(root.pointer(&reference[1..]).is_some(), "{reference}");
    }
    match value {
        Value::Array(items) => items.iter().for_each(|item| check_references(item, root)),
        Value::Object(object) => object
            .values()
            .for_each(|item| check_references(item, root)),
        _ => {}
    }
}

#[test]
fn of_a_faulty_plan_the_steps_that_are_sound_are_read() {
    let lines = [
        "plan: faulty",
        "steps:",
        "  a: { sql: SELECT 1 FROM odometry }",
        "  b: { op: no_such_operator }",
        "  c: { sql: SELECT 1 FROM b }",
        "  d: { sql: SELECT 1 FROM previous.c }",
        "  e: { sql: SELECT 1 FROM a JOIN f }",
        "  f: { sql: SELECT 1 FROM e }",
        "  g: { sql: SELECT 1 FROM a }",
        "  h: { sql: SELECT 1 FROM nowhere }",
        "write: [a]",
    ];
    let source = vocabulary::source("plan.yaml", &lines.join("\n"));
    let host = vocabulary::Plans(Vec::new());
    let (plan, faults) = evermap_language::read(&source, &[], &vocabulary::vocabulary(), &host);
    assert_eq!(faults.error_count(), 3, "{faults}");
    let plan = plan.unwrap();
    let names: Vec<&str> = plan.steps.iter().map(|step| step.name.as_str()).collect();
    assert_eq!(names, ["a", "g"]);
}
