//! The example does what it says: its operator is listed, checked and run beside those of the catalog.

#![allow(clippy::unwrap_used)]

use std::path::Path;
use std::process::Command;

fn own(arguments: &[&str]) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_own-operator"));
    let command = command
        .args(arguments)
        .current_dir(env!("CARGO_MANIFEST_DIR"));
    let output = command.output().unwrap();
    let said = [output.stdout, output.stderr].map(|said| String::from_utf8(said).unwrap());
    assert!(output.status.success(), "{}", said.concat());
    said.concat()
}

#[test]
fn its_operator_is_one_like_any_other() {
    assert!(own(&["operators", "stops"]).contains("duration_s"));
    assert!(own(&["test", "stops.yaml"]).contains("a stop of a second is none of two"));
    let schema = own(&["schema"]);
    assert!(schema.contains("\"stops.with\"") && schema.contains("\"speeds.with\""));
}

#[test]
fn the_manifest_in_the_docs_has_the_versions_of_the_workspace() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..");
    let read = |name: &str| std::fs::read_to_string(root.join(name)).unwrap();
    let page = read("docs/adding-an-operator.md");
    let shown = page.split("```toml\n").nth(1).unwrap();
    let shown = shown.split("```").next().unwrap();
    let shown = shown.replace("../evermap/", "");
    let workspace = read("Cargo.toml");
    let said = shown.lines().filter(|line| line.contains(" = "));
    let said: Vec<&str> = said.filter(|line| !line.starts_with("name = ")).collect();
    for line in &said {
        assert!(workspace.lines().any(|ours| ours == *line), "{line}");
    }
    // And it leaves nothing out that this example needs.
    let own = read("tests/examples/own_operator/Cargo.toml");
    let own = own.split("[dependencies]\n").nth(1).unwrap();
    for line in own.lines() {
        let name = line.trim_end_matches(".workspace = true");
        let found = said
            .iter()
            .any(|said| said.starts_with(&format!("{name} = ")));
        assert!(found, "the page has no {name}");
    }
}
