//! The command line as the documentation has it: all of it on a page of its own, and what the pages say to run.

use std::path::PathBuf;

use clap::{CommandFactory, Parser};

use crate::arguments::Arguments;

fn repository() -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}

/// The beginning of docs/commands.md.
const COMMANDS: &str = "\
# Commands

What `evermap COMMAND -h` prints, of each command; `--help` says more, such as what each value of `--format` is. A test of \
the program (`plans/cli/src/arguments/tests/documented.rs`) writes this page, with `EVERMAP_BLESS=1`, and fails where it \
is not what the program says.
";

/// `EVERMAP_BLESS=1 cargo test -p evermap --lib commands` rewrites the page.
#[test]
fn the_page_of_commands_is_what_the_program_says() {
    fn tell(command: &mut clap::Command, page: &mut String) {
        let name = command.get_bin_name().unwrap_or("evermap").to_owned();
        let help = command.render_help();
        page.push_str(&format!("\n## {name}\n\n```text\n{help}```\n"));
        let commands = command.get_subcommands_mut();
        let commands = commands.filter(|command| command.get_name() != "help");
        commands.for_each(|command| tell(command, page));
    }
    let mut program = Arguments::command().term_width(100);
    program.build();
    let mut said = COMMANDS.to_owned();
    tell(&mut program, &mut said);
    let path = repository().join("docs/commands.md");
    if std::env::var_os("EVERMAP_BLESS").is_some() {
        std::fs::write(&path, &said).unwrap();
    }
    let page = std::fs::read_to_string(&path).unwrap();
    let [page, said] = [&page, &said].map(|text| text.lines().collect::<Vec<_>>());
    let first = page.iter().zip(&said).find(|(page, said)| page != said);
    assert!(
        page == said,
        "read the options again, then run with EVERMAP_BLESS=1: {first:?}"
    );
}

/// The commands of a script of a shell, each as its words.
fn commands(script: &str) -> Vec<Vec<String>> {
    let (mut commands, mut words) = (Vec::new(), Vec::new());
    let (mut word, mut quote) = (None::<String>, None);
    let mut letters = script.chars().peekable();
    while let Some(letter) = letters.next() {
        match (quote, letter) {
            (None | Some('"'), '\\') => {
                // A line that ends so goes on.
                if let Some(next) = letters.next().filter(|next| *next != '\n') {
                    word.get_or_insert_default().push(next);
                }
            }
            (Some(open), _) if open == letter => quote = None,
            (None, '"' | '\'') => {
                quote = Some(letter);
                word = Some(word.unwrap_or_default());
            }
            (None, '#') if word.is_none() => {
                while letters.next_if(|next| *next != '\n').is_some() {}
            }
            (None, '\n' | '|' | '>' | ';' | '&') => {
                words.extend(word.take());
                commands.push(std::mem::take(&mut words));
            }
            (None, _) if letter.is_whitespace() => words.extend(word.take()),
            _ => word.get_or_insert_default().push(letter),
        }
    }
    commands
}

#[test]
fn what_the_pages_say_to_run_is_understood() {
    let entries = std::fs::read_dir(repository().join("docs")).unwrap();
    let paths = entries.map(|entry| entry.unwrap().path());
    let pages = paths.filter(|path| path.extension().is_some_and(|ending| ending == "md"));
    let mut found = 0;
    for path in pages.chain([repository().join("README.md")]) {
        let page = std::fs::read_to_string(&path).unwrap();
        let parts = page.split("```sh\n").skip(1);
        let scripts = parts.map(|part| part.split("```").next().unwrap());
        let ours = |words: &Vec<String>| words.first().is_some_and(|word| word == "evermap");
        for words in scripts.flat_map(commands).filter(ours) {
            if let Err(error) = Arguments::try_parse_from(&words) {
                panic!("{}: {words:?}: {error}", path.display());
            }
            found += 1;
        }
    }
    assert!(found > 60, "{found}");
}
