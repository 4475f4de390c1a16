//! What a server has done, as OpenMetrics.

use std::fmt::Write;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use axum::extract::{Request, State};
use axum::http::header;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use crate::serve::http::App;
use crate::sessions;

/// What was counted since the server began.
#[derive(Debug, Default)]
pub struct Counts {
    requests: AtomicU64,
    /// Those that ended with an error, ours or theirs.
    refused: AtomicU64,
    nanoseconds: AtomicU64,
}

/// Counts a request, and the time until its answer begins.
pub async fn counted(State(app): State<App>, request: Request, next: Next) -> Response {
    let begun = Instant::now();
    let response = next.run(request).await;
    let took = u64::try_from(begun.elapsed().as_nanos()).unwrap_or(u64::MAX);
    app.counts.requests.fetch_add(1, Ordering::Relaxed);
    app.counts.nanoseconds.fetch_add(took, Ordering::Relaxed);
    let status = response.status();
    if status.is_client_error() || status.is_server_error() {
        app.counts.refused.fetch_add(1, Ordering::Relaxed);
    }
    response
}

/// `GET /metrics`
pub async fn metrics(State(app): State<App>) -> Response {
    let counts = &app.counts;
    let mut text = String::new();
    let mut family = |name: &str, kind: &str, help: &str, samples: &[(String, String)]| {
        let _ = writeln!(text, "# TYPE {name} {kind}\n# HELP {name} {help}");
        for (labels, value) in samples {
            let _ = writeln!(text, "{labels} {value}");
        }
    };
    let total = |name: &str, counter: &AtomicU64| {
        let value = counter.load(Ordering::Relaxed).to_string();
        vec![(format!("{name}_total"), value)]
    };
    family(
        "evermap_http_requests",
        "counter",
        "Requests answered.",
        &total("evermap_http_requests", &counts.requests),
    );
    family(
        "evermap_http_refused",
        "counter",
        "Requests answered with an error.",
        &total("evermap_http_refused", &counts.refused),
    );
    let seconds = counts.nanoseconds.load(Ordering::Relaxed) as f64 / 1e9;
    family(
        "evermap_http_seconds",
        "counter",
        "Seconds until answers began, all requests together.",
        &[("evermap_http_seconds_total".to_owned(), seconds.to_string())],
    );
    let free = app.bounds.queries.available_permits().to_string();
    family(
        "evermap_queries_free",
        "gauge",
        "Queries that may begin at once.",
        &[("evermap_queries_free".to_owned(), free)],
    );
    let (mut versions, mut lost) = (Vec::new(), Vec::new());
    for map in app.maps.all() {
        if let Ok(newest) = map.newest().await {
            let name = map.name.replace('\\', "\\\\").replace('"', "\\\"");
            let sample = |family: &str| format!("{family}{{map=\"{name}\"}}");
            versions.push((sample("evermap_map_version"), newest.version().to_string()));
            let sums = sessions::lost(&newest.reader.map.logs().await).0;
            let sum: u64 = sums.values().sum();
            lost.push((sample("evermap_log_losses"), sum.to_string()));
        }
    }
    family(
        "evermap_log_losses",
        "gauge",
        "Messages and bytes that queries on logs of the newest version skipped or lost.",
        &lost,
    );
    family(
        "evermap_map_version",
        "gauge",
        "The newest version of a map.",
        &versions,
    );
    text.push_str("# EOF\n");
    let kind = "application/openmetrics-text; version=1.0.0; charset=utf-8";
    ([(header::CONTENT_TYPE, kind)], text).into_response()
}
