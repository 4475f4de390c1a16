//! Golden faults: `tests/faults/NAME.yaml` in, `tests/faults/NAME.txt` out, both the short
//! and the long form. `EVERMAP_BLESS=1 cargo test -p evermap-language` rewrites the latter.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod vocabulary;

use std::path::{Path, PathBuf};

use evermap_language::{PlanFaults, parse};

fn faults_of(path: &Path) -> PlanFaults {
    let text = std::fs::read_to_string(path).unwrap();
    let origin = path.file_name().unwrap().to_str().unwrap();
    // Options are written in the file itself, as comments.
    let settings: Vec<String> = text
        .lines()
        .filter_map(|line| line.strip_prefix("# --set "))
        .map(str::to_owned)
        .collect();
    let vocabulary = vocabulary::vocabulary();
    // What the others extend.
    let host = vocabulary::Plans(vec![
        ("base", include_str!("faults/base.plan")),
        ("faulty_base", include_str!("faults/faulty_base.plan")),
        ("circle", include_str!("faults/circle.yaml")),
        ("around", "plan: around\nextends: circle\n"),
    ]);
    let source = vocabulary::source(origin, &text);
    match parse(&source, &settings, &vocabulary, &host) {
        Ok(plan) => plan.warnings,
        Err(faults) => faults,
    }
}

#[test]
fn golden_faults() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/faults");
    let mut plans: Vec<PathBuf> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| {
            path.extension()
                .is_some_and(|extension| extension == "yaml")
        })
        .collect();
    plans.sort();
    assert!(plans.len() >= 8, "only {} plans", plans.len());
    for plan in plans {
        let faults = faults_of(&plan);
        let found = format!("{faults}\n{}", faults.pretty());
        let golden = plan.with_extension("txt");
        if std::env::var_os("EVERMAP_BLESS").is_some() {
            std::fs::write(&golden, &found).unwrap();
        }
        let expected = std::fs::read_to_string(&golden).unwrap_or_default();
        assert_eq!(found, expected, "{}", golden.display());
    }
}

#[test]
fn ten_different_faults_are_all_reported_where_they_are() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/faults/ten.yaml");
    let faults = faults_of(&path);
    let places: Vec<(usize, usize)> = faults
        .errors()
        .map(|fault| fault.location.position())
        .map(|position| (position.line, position.column))
        .collect();
    let expected = [
        (2, 1),
        (5, 9),
        (9, 18),
        (10, 24),
        (11, 13),
        (12, 3),
        (13, 29),
        (15, 3),
        (20, 22),
        (20, 28),
    ];
    assert_eq!(places, expected, "{faults}");
}
