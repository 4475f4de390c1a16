#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| evermap_fuzz::run("geometries", bytes));
