//! The binary `evermap`.

fn main() -> std::process::ExitCode {
    evermap::main()
}
