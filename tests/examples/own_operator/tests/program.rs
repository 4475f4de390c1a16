//! The example does what it says: its operator is listed, checked and run beside those of the catalog.

#![allow(clippy::unwrap_used)]

use std::collections::{BTreeMap, BTreeSet};
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

/// The entries of a manifest's section, by name, as they are written; none where it has no such section.
fn section<'m>(manifest: &'m str, name: &str) -> BTreeMap<&'m str, &'m str> {
    let heading = format!("[{name}]");
    let lines = manifest.lines().skip_while(|line| *line != heading).skip(1);
    let lines = lines.take_while(|line| !line.starts_with('['));
    let entries = lines.filter_map(|line| line.split_once(" = "));
    entries.map(|(name, value)| (name.trim(), value)).collect()
}

/// The sections of a manifest, but for those that only say how the workspace is kept.
fn headings(manifest: &str) -> BTreeSet<&str> {
    let headings = manifest.lines().filter(|line| line.starts_with('['));
    headings.filter(|line| *line != "[lints]").collect()
}

/// Outside of the workspace nothing is inherited: what the page shows is what the example has from there.
#[test]
fn the_manifest_in_the_docs_is_that_of_the_example_with_nothing_inherited() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..");
    let read = |name: &str| std::fs::read_to_string(root.join(name)).unwrap();
    let page = read("docs/adding-an-operator.md");
    let shown = page.split("```toml\n").nth(1).unwrap();
    let shown = shown.split("```").next().unwrap();
    assert!(!shown.contains("workspace"), "{shown}");
    let own = read("tests/examples/own_operator/Cargo.toml");
    assert_eq!(headings(shown), headings(&own));

    let workspace = read("Cargo.toml");
    let shared = section(&workspace, "workspace.dependencies");
    let inherited = section(&own, "dependencies").into_keys().map(|entry| {
        let name = entry.strip_suffix(".workspace").unwrap();
        let value = shared[name].replace("path = \"", "path = \"../evermap/");
        (name, value)
    });
    let inherited: BTreeMap<&str, String> = inherited.collect();
    let said = section(shown, "dependencies").into_iter();
    let said: BTreeMap<&str, String> = said.map(|(name, value)| (name, value.to_owned())).collect();
    assert!(
        said.len() > 3 && said == inherited,
        "{said:?} {inherited:?}"
    );

    let kept = section(&workspace, "workspace.package");
    let said = section(shown, "package");
    for key in ["edition", "rust-version"] {
        assert_eq!(said[key], kept[key], "{key}");
    }
    assert_eq!(said["name"], section(&own, "package")["name"]);
}

/// The page has the folder copied: what it says holds anywhere.
#[test]
fn what_the_docs_copy_beside_the_manifest_is_there_and_names_no_place_within_the_clone() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..");
    let page = std::fs::read_to_string(root.join("docs/adding-an-operator.md")).unwrap();
    for copied in [".ci/packages", ".cargo", "Cargo.lock"] {
        assert!(page.contains(&format!("../evermap/{copied}")), "{copied}");
        assert!(root.join(copied).exists(), "{copied}");
    }
    let settings = std::fs::read_to_string(root.join(".cargo/config.toml")).unwrap();
    let settings = section(&settings, "env");
    assert!(settings.contains_key("OPENCV_LINK_LIBS"), "{settings:?}");
    for name in ["OPENCV_LINK_PATHS", "OPENCV_INCLUDE_PATHS"] {
        let mut paths = settings[name].trim_matches('"').split(',');
        assert!(paths.all(|path| path.starts_with('/')), "{settings:?}");
    }
}
