//! Arguments of `serve`.

use std::net::SocketAddr;
use std::path::PathBuf;

use clap::Args;

use crate::quantity;

/// Address of the page, of HTTP and of Flight SQL, unless another one is given.
pub const HTTP: &str = "127.0.0.1:8760";

/// Arguments of `serve`.
#[derive(Debug, Args)]
pub struct ServeArgs {
    /// Folders or URLs of maps; each is served under the last part of its name.
    #[arg(long = "map", value_name = "DIR", required = true, num_args = 1..)]
    pub maps: Vec<String>,
    /// Address of the page, of HTTP and of Flight SQL.
    #[arg(long, value_name = "HOST:PORT", default_value = HTTP)]
    pub http: SocketAddr,
    /// Address of the Postgres protocol.
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:5433")]
    pub postgres: SocketAddr,
    /// Who may come in (YAML): `users`, a list of `name`, `password` and `token`. Without it, everybody on this machine.
    #[arg(long, value_name = "FILE")]
    pub users: Option<PathBuf>,
    /// Certificate and those above it (PEM); with it nobody gets in without TLS.
    #[arg(long, value_name = "FILE", requires = "key")]
    pub certificate: Option<PathBuf>,
    /// Private key of the certificate (PEM).
    #[arg(long, value_name = "FILE", requires = "certificate")]
    pub key: Option<PathBuf>,
    /// Folder of annotation logs: people draw and answer on the page, and what they say is written there. Without it, the
    /// server is only read.
    #[arg(long, value_name = "DIR")]
    pub teach: Option<PathBuf>,
    /// Memory for sorts, joins and hashes, all queries together.
    #[arg(long, value_name = "BYTES", default_value = "2GiB", value_parser = quantity::bytes)]
    pub memory: usize,
    /// Seconds that a query may take, its answer read.
    #[arg(long, value_name = "SECONDS", default_value_t = 60, value_parser = clap::value_parser!(u64).range(1..=86_400))]
    pub timeout_s: u64,
    /// Rows that an answer may have.
    #[arg(long, value_name = "N", default_value_t = 10_000_000)]
    pub rows: u64,
    /// Queries that run side by side; more wait.
    #[arg(long, value_name = "N", default_value_t = 32, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub queries: u32,
    /// Connections of the Postgres protocol at once; more are refused.
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub connections: u32,
    /// Connections of one address at once, of HTTP and of the Postgres protocol each; more are refused [default: half of them;
    /// of this machine, any number].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub per_address: Option<u32>,
}
