//! Files that parameters name by their paths.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use evermap_language::{
    Body, Host, OperatorSpec, ParameterFault, Plan, PlanFaults, QueryFault, Source, Vocabulary,
    parse,
};
use serde_json::{Value, json};

/// A session manifest, and one file.
struct Folder(&'static str);

fn source(origin: &str, text: &str) -> Source {
    Source {
        origin: origin.to_owned(),
        text: text.to_owned(),
    }
}

impl Host for Folder {
    fn tables(&self, _: &str) -> Result<Vec<String>, QueryFault> {
        Ok(Vec::new())
    }

    fn parameter_faults(&self, _: &str, _: &Value) -> Vec<ParameterFault> {
        Vec::new()
    }

    fn plan(&self, name: &str, _: &str) -> Result<Source, String> {
        Err(format!("there is no plan {name}"))
    }

    fn file(&self, path: &str, named_by: &str) -> Result<Value, String> {
        match path {
            "body.png" => Ok(json!({ "read": path, "named_by": named_by })),
            _ => Err(format!("nothing at {path}")),
        }
    }

    fn manifest(&self) -> Option<Source> {
        (!self.0.is_empty()).then(|| source("drives/lot.yaml", self.0))
    }
}

/// The parameters of the steps of a plan in which `see` may have a file, and `name` none.
fn read(manifest: &'static str, settings: &[&str]) -> Result<Vec<Value>, PlanFaults> {
    let properties =
        json!({ "mask": { "type": "object", "x-files": true }, "names": { "type": "object" } });
    let see = OperatorSpec {
        name: "see".into(),
        ports: vec![],
        params: json!({ "properties": properties }),
    };
    let vocabulary = Vocabulary {
        operators: vec![see],
        ..Vocabulary::default()
    };
    let text = "plan: seen\nsteps:\n  one: { op: see, with: { names: { a: body.png } } }\n  two: { op: see }\nwrite: [one, two]\n";
    let settings: Vec<String> = settings.iter().map(|text| (*text).to_owned()).collect();
    let plan = parse(
        &source("plans/seen.yaml", text),
        &settings,
        &vocabulary,
        &Folder(manifest),
    );
    let params = |plan: Plan| {
        let steps = plan.steps.into_iter();
        let params = steps.map(|step| match step.body {
            Body::Op { params, .. } => params,
            other => panic!("{other:?}"),
        });
        params.collect()
    };
    plan.map(params)
}

#[test]
fn a_file_stands_in_the_place_of_its_path_for_each_step() {
    let rings = json!([[[0, 0], [1, 0], [1, 1]]]);
    let manifest = "defaults:\n  mask: { front: body.png, rear: [[[0, 0], [1, 0], [1, 1]]] }\n";
    let file = |named_by: &str| json!({ "read": "body.png", "named_by": named_by });
    let mask = json!({ "front": file("drives/lot.yaml"), "rear": rings });
    let names = json!({ "a": "body.png" });
    let found = read(manifest, &[]).unwrap();
    assert_eq!(
        found,
        [
            json!({ "mask": mask, "names": names }),
            json!({ "mask": mask })
        ]
    );

    let found = read("", &["two.mask.front=body.png"]).unwrap();
    let mask = json!({ "front": file("") });
    assert_eq!(found, [json!({ "names": names }), json!({ "mask": mask })]);
}

#[test]
fn a_file_that_cannot_be_read_is_told_once_where_it_is_named() {
    let manifest = "defaults:\n  mask:\n    front: body.png\n    rear: bodi.png\n";
    let faults = read(manifest, &[]).unwrap_err();
    let said = "drives/lot.yaml:4:11: expected a file for `rear`, found nothing at bodi.png\n";
    assert_eq!(faults.to_string(), said);
    let faults = read("", &["two.mask.rear=bodi.png"]).unwrap_err();
    let said =
        "--set two.mask.rear=bodi.png: expected a file for `rear`, found nothing at bodi.png\n";
    assert_eq!(faults.to_string(), said);
}
