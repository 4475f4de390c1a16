//! Every text that the program can say, in one file: `tests/messages.txt`. A new or changed message shows there in a
//! review, beside those that say similar things. `EVERMAP_BLESS=1 cargo test --test end_to_end messages` rewrites it.
//!
//! Plain English, short and exact: "expected …, found …".

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use evermap_tests::repository;

/// A text of fewer words is no sentence: a name, a unit, a word of SQL.
const FEWEST_WORDS: usize = 3;

/// The Rust files of the program, without tests, benches and examples.
fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    let entries = std::fs::read_dir(folder).unwrap();
    for path in entries.map(|entry| entry.unwrap().path()) {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let is_apart = ["tests", "benches", "examples", "target"].contains(&name.as_str());
        match path.is_dir() {
            true if !is_apart => sources(&path, found),
            false if name.ends_with(".rs") && name != "tests.rs" => found.push(path),
            _ => {}
        }
    }
}

/// The literals of a source, up to its unit tests.
fn literals(source: &str) -> Vec<String> {
    let code = source.split("#[cfg(test)]\nmod tests {").next().unwrap();
    let (mut rest, mut found) = (code, Vec::new());
    while let Some(at) = rest.find(['/', '"', '\'', '#']) {
        let token = &rest[at..];
        rest = if token.starts_with("//") {
            &token[token.find('\n').unwrap_or(token.len())..]
        } else if token.starts_with("#[") || token.starts_with("#![") {
            &token[token.find("]\n").unwrap_or(1)..]
        } else if let Some(text) = token.strip_prefix('"') {
            let end = end_of_literal(text);
            found.push(text[..end].to_owned());
            &text[end + 1..]
        } else if token.starts_with("'\"'") || token.starts_with("'\\\"'") {
            &token[token[1..].find('\'').map_or(1, |end| end + 2)..]
        } else if let Some(after) = token.strip_prefix("'\\''") {
            after
        } else {
            &token[1..]
        };
    }
    found
}

fn end_of_literal(text: &str) -> usize {
    let mut escaped = false;
    let end = text.bytes().position(|byte| {
        let ends = byte == b'"' && !escaped;
        escaped = byte == b'\\' && !escaped;
        ends
    });
    end.expect("a literal ends")
}

/// The literal as it is said: lines that go on are one, values are their names.
fn said(literal: &str) -> String {
    let lines: Vec<&str> = literal.split("\\\n").collect();
    let mut text = lines[0].to_owned();
    lines[1..]
        .iter()
        .for_each(|line| text.push_str(line.trim_start()));
    text.replace("\\\"", "\"").replace('\n', "\\n")
}

fn is_sentence(text: &str) -> bool {
    let starts = ["SELECT", "CREATE", "WITH ", "EXPLAIN", "<", "#version"];
    let is_code = starts
        .iter()
        .any(|start| text.trim_start().starts_with(start));
    let is_word = |word: &&str| word.chars().filter(|c| c.is_alphabetic()).count() > 1;
    !is_code && text.split_whitespace().filter(is_word).count() >= FEWEST_WORDS
}

#[test]
fn every_text_is_in_the_golden_file() {
    let mut files = Vec::new();
    for folder in ["schemas", "operators", "datasets", "plans"] {
        sources(&repository().join(folder), &mut files);
    }
    files.sort();
    let mut all = String::new();
    for file in files {
        let source = std::fs::read_to_string(&file).unwrap();
        let texts: BTreeSet<String> = literals(&source).iter().map(|text| said(text)).collect();
        let texts: Vec<_> = texts.into_iter().filter(|text| is_sentence(text)).collect();
        if texts.is_empty() {
            continue;
        }
        let name = file.strip_prefix(repository()).unwrap().display();
        all.push_str(&format!("{name}\n"));
        texts
            .iter()
            .for_each(|text| all.push_str(&format!("    {text}\n")));
    }
    let golden = repository().join("tests/messages.txt");
    if std::env::var_os("EVERMAP_BLESS").is_some() {
        std::fs::write(&golden, &all).unwrap();
    }
    let expected = std::fs::read_to_string(&golden).unwrap_or_default();
    let [before, now] = [&expected, &all].map(|text| text.lines().collect::<BTreeSet<_>>());
    let gone: Vec<_> = before.difference(&now).collect();
    let new: Vec<_> = now.difference(&before).collect();
    assert!(
        expected == all,
        "texts changed; read them again, then run with EVERMAP_BLESS=1\ngone: {gone:#?}\nnew: {new:#?}"
    );
}

/// Phrases that a reader has to think about, with what is said instead.
const UNCLEAR: [(&str, &str); 4] = [
    ("makes no sense", "invalid, and why"),
    ("make no sense", "invalid, and why"),
    ("is nowhere", "is not there"),
    ("is no place for", "cannot hold"),
];

#[test]
fn no_text_is_unclear() {
    let texts = std::fs::read_to_string(repository().join("tests/messages.txt")).unwrap();
    for (phrase, instead) in UNCLEAR {
        let line = texts.lines().find(|line| line.contains(phrase));
        assert!(line.is_none(), "{phrase:?} ({instead}): {line:?}");
    }
}
