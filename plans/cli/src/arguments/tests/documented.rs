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
