use super::answers::Answer;
use super::facts::{MetricFacts, SessionFact};
use super::*;
use crate::draw::{Canvas, Scene, Trajectory, draw};
use crate::metric::Drift;
use evermap_engine::map::{LayerInfo, RunRow, VersionInfo};
use evermap_schemas::Stamp;
use std::collections::BTreeMap;

fn unit(step: &str, cached: bool, seconds: f64) -> RunRow {
    RunRow {
        version: 2,
        run: "r".into(),
        step: step.into(),
        session: Some("initial".into()),
        site: None,
        cached,
        rows: 10,
        bytes: 2048,
        seconds,
        started: Stamp(0),
        lost: 0,
        recipe: "ab".into(),
        content: "cd".into(),
        nodes: None,
    }
}

fn facts() -> Facts {
    let drive = Trajectory {
        session: "initial".into(),
        points: vec![[0.0, 0.0], [30.0, 10.0]],
    };
    let scene = Scene {
        trajectories: vec![drive],
        ..Scene::default()
    };
    let layer = LayerInfo {
        layer: "poses".into(),
        rows: 7,
        bytes: 100,
        artifacts: 1,
        operator: None,
        digest: "0123456789abcdef".into(),
    };
    let drift = Drift {
        session: "initial".into(),
        keyframes: 5,
        mapped: 4,
        driven_m: 31.6,
        end_m: 1.25,
        most_m: 1.5,
    };
    let answer = Answer {
        title: "Residuals".into(),
        query: "SELECT 1\nWHERE 1 < 2".into(),
        columns: vec![("camera".into(), false), ("rms_px".into(), true)],
        rows: vec![vec!["front".into(), "0.61".into()]],
    };
    let metric = MetricFacts {
        picture: None,
        drifts: vec![drift],
        answers: vec![answer],
    };
    let version = VersionInfo {
        version: 2,
        published: "now".into(),
        plan: "car_park".into(),
        sessions: vec!["initial".into()],
        layers: 1,
        lost: 3,
    };
    Facts {
        version: 2,
        site: "lot & more".into(),
        plan: "car_park <script>".into(),
        published: "2026-01-01T00:00:00Z".into(),
        evermap: "0.1.0".into(),
        picture: draw(&scene, Canvas::default()).map_err(|fault| fault.to_string()),
        metric: Some(metric),
        semantic: None,
        stable: None,
        sites: vec!["lot".into()],
        layers: vec![layer],
        sessions: vec![SessionFact {
            session: "initial".into(),
            site: "lot".into(),
            driven_m: Some(31.6),
            content: "ff".into(),
        }],
        units: (0..20)
            .map(|k| unit(&format!("step_{k}"), k > 10, 1.0 + f64::from(k)))
            .collect(),
        losses: BTreeMap::from([("dark frames".into(), 3)]),
        versions: vec![version],
    }
}

#[test]
fn the_page_says_everything_and_needs_nothing_else() {
    let page = facts().to_string();
    if let Ok(folder) = std::env::var("EVERMAP_LOOK") {
        let _ = std::fs::write(format!("{folder}/report.html"), &page);
    }
    for said in [
        "<svg ",
        "dark frames",
        "0123456789ab<",
        "31.6 m",
        "step_19",
        "5 more units",
        "11 / 20",
        "reused",
        "1.250 m",
        "0.61",
        "WHERE 1 &#60; 2",
        "prefers-color-scheme: dark",
        "viewport",
    ] {
        assert!(page.contains(said), "{said}");
    }
    assert!(page.contains("car_park &#60;script&#62;") && !page.contains("<script"));
    let link = "<a href=\"http://127.0.0.1:8760/#version=2&amp;site=lot%20%26%20more\">";
    assert!(page.contains(link));
    let page = page.replace(link, "");
    for reference in ["src=\"http", "href=\"http", "url(http", "@import", "<link"] {
        assert!(!page.contains(reference), "{reference}");
    }
}

#[test]
fn a_map_without_a_picture_or_runs_has_a_page_too() {
    let bare = Facts {
        picture: Err("no row to draw in `poses`".to_owned()),
        units: vec![],
        losses: BTreeMap::new(),
        ..facts()
    };
    let page = bare.to_string();
    assert!(page.contains("There is no picture: no row to draw in `poses`.</p>"));
    assert!(!page.contains("<svg") && !page.contains("Units") && !page.contains("Losses</h2>"));
}
