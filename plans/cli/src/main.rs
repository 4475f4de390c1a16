//! The binary `evermap`.

use libmimalloc_sys::{mi_option_set, mi_option_t};

/// Gives memory back when it is free: the C library's allocator keeps most of it, for each thread apart.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Of `mi_option_e` in mimalloc 3: for how long it keeps memory that is free.
const PURGE_DELAY: mi_option_t = 15;

/// Milliseconds, as in mimalloc 2. With the second of mimalloc 3 a plan holds half as much again, and takes as long.
const KEPT_MS: std::ffi::c_long = 10;

fn main() -> std::process::ExitCode {
    // With huge pages a run holds a sixth more memory, and takes as long. Where the kernel refuses, they stay.
    let _ = rustix::thread::disable_transparent_huge_pages(true);
    keep_less();
    evermap::main()
}

#[expect(
    unsafe_code,
    reason = "the allocator's options can be set from C alone"
)]
fn keep_less() {
    // SAFETY: it writes a number into a table, which any thread may do at any time.
    unsafe { mi_option_set(PURGE_DELAY, KEPT_MS) }
}
