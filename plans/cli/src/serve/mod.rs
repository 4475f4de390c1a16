//! Maps by network: one process beside them, for people and programs.
//!
//! ```text
//!   access ── who may come in, and by which door
//!      │
//!   http ──── the page, tiles, pictures, rows as JSON, CSV, Arrow, Parquet, GeoJSON; live to Foxglove; metrics
//!   flight ── Flight SQL, at the same address
//!   postgres ─ the protocol of Postgres
//!      │
//!   answer ── queries that only read, within time, rows and memory
//!   maps ──── the versions of maps that are open
//!   permits ── how many connections there may be, and how many of them of one address
//!   patience ─ how long a connection may say nothing; that the network is heard while queries compute
//!   teach ──── what people say of maps, in logs of their own; only where it is asked for
//! ```
//! A server only reads maps. What a run publishes is in the answer to the next query, whole or not at all, as versions are.

mod access;
mod answer;
mod aside;
mod flight;
mod http;
mod maps;
mod patience;
mod permits;
mod postgres;
mod teach;

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use evermap_engine::sql::{Limits, runtime};
use evermap_schemas::Fault;
use tokio::net::TcpListener;
use tokio::sync::Semaphore;

use crate::arguments::ServeArgs;
use crate::ending::{DONE, Ending};
use crate::progress::line;
use crate::serve::access::Access;
use crate::serve::answer::Bounds;
use crate::serve::http::page::encoded;
use crate::serve::maps::Maps;
use crate::serve::patience::waiting;
use crate::serve::permits::Permits;
use crate::serve::teach::Teaching;

/// Serves maps until it is stopped.
///
/// # Errors
/// A user fault for maps or files that are not there, or a door that would stand open; a resource fault for an address
/// that is taken.
pub async fn serve(args: &ServeArgs) -> Ending {
    let access = Access::new(args)?;
    let limits = Limits {
        memory_bytes: args.memory,
        ..Limits::default()
    };
    let runtime = runtime(limits)?;
    let maps = Maps::open(&args.maps, limits, &runtime).await?;
    let bounds = Bounds {
        timeout: Duration::from_secs(args.timeout_s),
        rows: args.rows,
        queries: Arc::new(Semaphore::new(args.queries as usize)),
        memory: Arc::clone(&runtime.memory_pool),
    };
    let no_thread = |error| Fault::resource(format!("cannot start a thread: {error}"));
    patience::keep_attending(tokio::runtime::Handle::current()).map_err(no_thread)?;
    let teaching = args.teach.as_deref().map(Teaching::new).transpose()?;
    let teaching = teaching.map(Arc::new);
    let (web, web_address) = listen(args.http).await?;
    let (postgres, postgres_address) = listen(args.postgres).await?;
    let [scheme, calls, live] = match access.needs_tls() {
        true => ["https", "grpc+tls", "wss"],
        false => ["http", "grpc", "ws"],
    };
    let names = maps.all().map(|map| map.name.as_str());
    let names = names.collect::<Vec<_>>().join(", ");
    let served = match &args.teach {
        Some(folder) => format!(
            "read-only; what people teach goes into {}",
            folder.display()
        ),
        None => "read-only".to_owned(),
    };
    line(&format!("serving {names}, {served}"));
    line(&format!("page and HTTP: {scheme}://{web_address}/"));
    line(&format!("Flight SQL:    {calls}://{web_address}"));
    line(&format!("Foxglove:      {live}://{web_address}/foxglove"));
    let first = maps
        .all()
        .next()
        .map_or_else(String::new, |map| encoded(&map.name));
    line(&format!(
        "Postgres:      postgresql://{postgres_address}/{first}"
    ));
    let (waiting, connections) = (waiting(), args.connections as usize);
    let permits = Permits::new(waiting, waiting, args.per_address);
    let spoken = postgres::serve(
        postgres,
        Permits::new(waiting, connections, args.per_address),
        maps.clone(),
        access.clone(),
        bounds.clone(),
        connections,
    );
    let tidied = async {
        match &teaching {
            Some(teaching) => teaching.tidied().await,
            None => std::future::pending().await,
        }
    };
    tokio::select! {
        () = http::serve(web, permits, maps, access, bounds, teaching.clone()) => {}
        () = spoken => {}
        () = tidied => {}
    }
    DONE
}

/// Listens; the address with the port that the system chose, where 0 is asked for.
async fn listen(address: SocketAddr) -> Result<(TcpListener, SocketAddr), Fault> {
    let taken = |error: std::io::Error| {
        Fault::resource(format!("cannot listen on {address}: {error}"))
            .next("choose another one with --http or --postgres")
    };
    let listener = TcpListener::bind(address).await.map_err(taken)?;
    let bound = listener.local_addr().map_err(taken)?;
    Ok((listener, bound))
}
