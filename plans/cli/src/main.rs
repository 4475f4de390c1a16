//! The binary `evermap`.

/// Gives memory back when it is free: the C library's allocator keeps most of it, for each thread apart.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    // Huge pages hold a tenth more of a run's memory than is in use, and save no time. Where the kernel refuses, they stay.
    let _ = rustix::thread::disable_transparent_huge_pages(true);
    evermap::main()
}
