//! evermap with an operator of one's own: `own-operator run stops.yaml --map lot --sessions monday.mcap`.
//!
//! The program has all that `evermap` has. What it adds is one line here, and the files of the operator.

mod stops;

use evermap_contract::Entry;

fn main() -> std::process::ExitCode {
    evermap::main_with([Entry::of::<stops::Stops>()])
}
