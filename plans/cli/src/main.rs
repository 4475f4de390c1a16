//! The binary `evermap`.

/// Gives memory back when it is free: the C library's allocator keeps most of it, for each thread apart.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    // With huge pages a run holds a sixth more memory, and takes as long. Where the kernel refuses, they stay.
    let _ = rustix::thread::disable_transparent_huge_pages(true);
    evermap::main()
}
