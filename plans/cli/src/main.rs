//! The binary `evermap`.

/// Gives memory back when it is free: the C library's allocator keeps most of it, for each thread apart.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    evermap::main()
}
