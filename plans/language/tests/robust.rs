//! No text makes the reader panic, and every fault is in the text.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod vocabulary;

use evermap_language::{Location, PlanFaults, parse};
use proptest::prelude::*;

const PLANS: [&str; 6] = [
    include_str!("faults/ten.yaml"),
    include_str!("faults/parameters.yaml"),
    include_str!("faults/tests.yaml"),
    include_str!("faults/warnings.yaml"),
    include_str!("faults/base.plan"),
    include_str!("faults/extends.yaml"),
];

/// Pieces that mean something to YAML or to plans.
const PIECES: [&str; 37] = [
    "plan: ",
    "steps:",
    "write: ",
    "tests:",
    "extends: base",
    "drop: [",
    "defaults: ",
    "op: ",
    "in: ",
    "with: ",
    "sql: ",
    "\n",
    "\n  ",
    "\n    ",
    "- ",
    "? ",
    ": ",
    "{",
    "}",
    "[",
    "]",
    ", ",
    "'",
    "\"",
    "&a ",
    "*a",
    "!!int ",
    "!t ",
    "|\n",
    ">-\n",
    "# c\n",
    "---\n",
    "...\n",
    "<<: ",
    "\t",
    "%YAML 1.2\n",
    "1e999",
];

fn check(text: &str, settings: &[String]) {
    let vocabulary = vocabulary::vocabulary();
    let host = vocabulary::Plans(vec![("base", PLANS[4])]);
    let source = vocabulary::source("x", text);
    let result = parse(&source, settings, &vocabulary, &host);
    let faults = match result {
        Ok(plan) => {
            let printed = plan.to_string();
            let again = parse(&vocabulary::source("x", &printed), &[], &vocabulary, &host);
            assert_eq!(again.unwrap().to_string(), printed);
            plan.warnings
        }
        Err(faults) => {
            assert!(faults.error_count() > 0);
            faults
        }
    };
    check_places(text, &faults);
}

fn check_places(text: &str, faults: &PlanFaults) {
    // YAML counts a lone carriage return as a line break.
    let lines_of = |text: &str| 2 + text.matches(['\n', '\r']).count();
    let (lines, base_lines) = (lines_of(text), lines_of(PLANS[4]));
    for fault in faults.iter() {
        if let Location::Text(position) = fault.location {
            let lines = if position.source == 0 {
                lines
            } else {
                base_lines
            };
            assert!((1..=lines).contains(&position.line), "{fault:?}");
            assert!(position.column >= 1);
        }
        assert!(!fault.message.contains('\n'), "{fault:?}");
    }
    assert!(faults.pretty().len() < 1_000_000);
}

/// A plan with parts replaced, repeated or taken out.
fn mutated() -> impl Strategy<Value = String> {
    let edit = (
        any::<prop::sample::Index>(),
        0_usize..12,
        prop::sample::select(&PIECES[..]),
    );
    let edits = prop::collection::vec(edit, 1..6);
    (prop::sample::select(&PLANS[..]), edits).prop_map(|(plan, edits)| {
        let mut text: Vec<char> = plan.chars().collect();
        for (at, removed, piece) in edits {
            let from = at.index(text.len());
            let to = (from + removed).min(text.len());
            text.splice(from..to, piece.chars());
        }
        text.into_iter().collect()
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1500))]

    #[test]
    fn any_text(text in any::<String>()) {
        check(&text, &[]);
    }

    #[test]
    fn text_of_pieces(pieces in prop::collection::vec(prop::sample::select(&PIECES[..]), 0..40)) {
        check(&pieces.concat(), &[]);
    }

    #[test]
    fn mutated_plans(text in mutated()) {
        check(&text, &[]);
    }

    #[test]
    fn any_setting(setting in any::<String>(), value in any::<String>()) {
        let settings = [setting, format!("lanes.connect_m={value}"), format!("lanes.{value}=1")];
        check(PLANS[3], &settings);
    }
}

#[test]
fn large_and_deep_texts() {
    for text in [
        "[", "- ", "{a: ", "a: ", "? ", "&a ", "*", "\"", "|", "- - ", "a:\n ", "[a, ",
    ] {
        check(&text.repeat(50_000), &[]);
    }
    let mut stairs = String::new();
    for depth in 0..2000 {
        stairs.push_str(&format!("{}a:\n", " ".repeat(depth)));
    }
    check(&stairs, &[]);
}
