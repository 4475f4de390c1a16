//! Embeds the plans of `plans/library`, so that `evermap run car_park` needs no file.

use std::fmt::Write;
use std::path::{Path, PathBuf};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = Path::new(&std::env::var("CARGO_MANIFEST_DIR")?).join("../library");
    println!("cargo::rerun-if-changed={}", folder.display());
    let mut plans: Vec<PathBuf> = match std::fs::read_dir(&folder) {
        Ok(entries) => entries
            .filter_map(|entry| Some(entry.ok()?.path()))
            .collect(),
        Err(_) => Vec::new(),
    };
    plans.retain(|path| {
        path.extension()
            .is_some_and(|extension| extension == "yaml")
    });
    plans.sort();
    let mut list = String::from("&[\n");
    for path in plans {
        let name = path
            .file_stem()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        writeln!(
            list,
            "({name:?}, include_str!({:?})),",
            path.canonicalize()?.display().to_string()
        )?;
    }
    list.push_str("]\n");
    std::fs::write(Path::new(&std::env::var("OUT_DIR")?).join("plans.rs"), list)?;
    link_small();
    Ok(())
}

/// Makes the program smaller. Rust links with LLD on this target, which knows both options.
fn link_small() {
    let is = |name, value| std::env::var(name).is_ok_and(|found| found == value);
    if !is("PROFILE", "release") || !is("TARGET", "x86_64-unknown-linux-gnu") {
        return;
    }
    // Functions that compile to the same instructions, as those of many generic types do, are linked once.
    println!("cargo::rustc-link-arg-bins=-Wl,--icf=all");
    // What is relocated at start is a list of bits, not of 24 bytes each.
    if loads_packed_relocations() {
        println!("cargo::rustc-link-arg-bins=-Wl,-z,pack-relative-relocs");
    }
}

/// Whether the C library of this machine, for which the program is built, is glibc 2.36 or newer.
fn loads_packed_relocations() -> bool {
    let Ok(asked) = std::process::Command::new("getconf")
        .arg("GNU_LIBC_VERSION")
        .output()
    else {
        return false;
    };
    let version = String::from_utf8_lossy(&asked.stdout);
    let mut numbers = version
        .trim()
        .trim_start_matches("glibc ")
        .split('.')
        .map_while(|part| part.parse::<u32>().ok());
    matches!((numbers.next(), numbers.next()), (Some(major), Some(minor)) if (major, minor) >= (2, 36))
}
