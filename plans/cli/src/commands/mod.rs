//! One file a command.

pub mod annotate;
pub mod changes;
pub mod check;
#[cfg(feature = "cluster")]
pub mod cluster;
pub mod explain;
pub mod functions;
pub mod import;
pub mod inspect;
pub mod layers;
pub mod operators;
pub mod render;
pub mod report;
pub mod run;
pub mod simulate;
pub mod sql;

use clap::CommandFactory;
use evermap_engine::run::runner::Unfinished;

use crate::arguments::{Arguments, Command};
use crate::ending::{DONE, Ending};

/// Does what the command line says. `unfinished` is held by what goes on where the command was stopped.
///
/// # Errors
/// Why it failed.
pub async fn dispatch(command: &Command, unfinished: &Unfinished) -> Ending {
    match command {
        Command::Run(args) => run::run(args, unfinished).await,
        Command::Check(args) => check::check(args).await,
        Command::Test(args) => check::test(args).await,
        Command::Explain(args) => explain::explain(args).await,
        Command::Schema { of } => check::schema(*of),
        Command::Sql(args) => sql::sql(args, unfinished).await,
        Command::Inspect(args) => inspect::inspect(args).await,
        Command::Operators(args) => operators::operators(args).await,
        Command::Layers(args) => layers::layers(args).await,
        Command::Versions(args) => layers::versions(args).await,
        Command::Functions(args) => functions::functions(args).await,
        Command::Diff(args) => changes::diff(args).await,
        Command::Gc(args) => changes::gc(args).await,
        Command::Verify(args) => changes::verify(args).await,
        Command::Export(args) => crate::export::export(args).await,
        Command::Annotate(args) => annotate::annotate(args).await,
        Command::Render(args) => render::render(args).await,
        Command::Report(args) => report::report(args).await,
        Command::Serve(args) => crate::serve::serve(args).await,
        Command::Simulate(args) => simulate::simulate(args).await,
        Command::Import(args) => import::import(args).await,
        #[cfg(feature = "cluster")]
        Command::Scheduler(args) => cluster::scheduler(args).await,
        #[cfg(feature = "cluster")]
        Command::Executor(args) => cluster::executor(args).await,
        Command::Completions { shell } => completions(*shell),
    }
}

fn completions(shell: clap_complete::Shell) -> Ending {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut Arguments::command(), "evermap", &mut script);
    std::io::Write::write_all(&mut std::io::stdout(), &script)?;
    DONE
}
