//! The example does what it says: its operator is listed, checked and run beside those of the catalog.

#![allow(clippy::unwrap_used)]

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
