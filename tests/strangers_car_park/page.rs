//! Its parking spaces, taught through the page by somebody who knows the truth, while the server is killed again and again.

use std::path::{Path, PathBuf};

use evermap_tests::park::finished;
use evermap_tests::recording::is_read_as_the_map_says;
use evermap_tests::server::{Server, script};
use evermap_tests::{Finished, text};
use serde_json::json;

use super::mapped::first_drive;
use super::parking::{found, spaces};
use super::world;

/// Spaces that are drawn, and questions that are answered, before the server is killed.
const ROUND: [&str; 2] = ["2", "20"];

#[test]
fn a_park_is_taught_through_the_page_and_no_saved_act_is_lost() {
    let Some(world) = world() else { return };
    let folder = tempfile::tempdir().unwrap();
    let map = first_drive(&world, folder.path());
    let truth = spaces(&world, &map);
    let corners: Vec<_> = truth.iter().map(|space| json!(space.corners())).collect();
    let boxes = folder.path().join("boxes.json");
    std::fs::write(&boxes, json!(corners).to_string()).unwrap();
    let labels = folder.path().join("labels");
    let mut saved = 0;
    for round in 0..4 {
        // What ends a server here is SIGKILL.
        let server = Server::start(&map, &["--teach", text(&labels)]);
        let page = format!("http://{}/", server.http);
        let known = saved.to_string();
        let arguments = [&page, text(&boxes), ROUND[0], ROUND[1], &known];
        let Some(mut person) = script("strangers_car_park/oracle.py", &arguments) else {
            return;
        };
        let taught = Finished::from(person.output().unwrap()).expect(0).json();
        eprintln!("round {round}: {taught}");
        saved = taught["labels"].as_u64().unwrap();
    }
    let logs = labels.join("map/park");
    let logs = std::fs::read_dir(logs).unwrap();
    let logs: Vec<_> = logs.map(|log| log.unwrap().path()).collect();
    assert_eq!(logs.len(), 4, "each server began a part");
    let logs: Vec<&Path> = logs.iter().map(PathBuf::as_path).collect();
    let run = finished("parking", &map, &logs, &[]).expect(3);
    assert!(run.stderr.contains("logs without an end"), "{}", run.stderr);
    let (precision, recall) = found(&map, &truth);
    eprintln!("{saved} labels: precision {precision:.3}, recall {recall:.3}");
    is_read_as_the_map_says(&map, folder.path());
    assert!(precision >= 0.97 && recall >= 0.95, "{precision}, {recall}");
}
