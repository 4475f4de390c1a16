//! Maps by HTTP. `docs/serving.md` lists the addresses.

mod answer_body;
mod boxes;
mod conversation;
mod formats;
pub mod live;
mod metrics;
pub mod page;
mod pictures;
mod refusal;
mod request_body;
mod rows;
mod teach;

use std::collections::BTreeMap;
use std::sync::Arc;

use axum::Router;
use axum::extract::{FromRequestParts, RawPathParams, Request, State};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::middleware::{Next, from_fn, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::{any, get};
use evermap_schemas::Fault;
use tokio::net::TcpListener;
use tokio::sync::Semaphore;

use crate::serve::access::{Access, Who};
use crate::serve::answer::Bounds;
use crate::serve::flight;
use crate::serve::http::conversation::{Door, converse};
use crate::serve::http::metrics::Counts;
pub use crate::serve::http::refusal::{Asks, Refusal};
use crate::serve::maps::{Maps, ServedMap};
use crate::serve::patience::{Exchanges, TOLD, accept};
use crate::serve::permits::Permits;
use crate::serve::teach::Teaching;

/// What handlers answer from.
#[derive(Clone)]
pub struct App {
    maps: Maps,
    bounds: Bounds,
    counts: Arc<Counts>,
    /// `None` where the server is only read.
    teaching: Option<Arc<Teaching>>,
    /// Permits of those who watch a map live.
    viewers: Arc<Semaphore>,
}

impl App {
    /// What work says, as one of the queries that run.
    async fn within<T>(&self, work: impl Future<Output = Result<T, Fault>>) -> Result<T, Fault> {
        self.bounds.turn().await?.within(work).await?
    }
}

/// Serves maps for ever.
pub async fn serve(
    listener: TcpListener,
    permits: Permits,
    maps: Maps,
    access: Access,
    bounds: Bounds,
    teaching: Option<Arc<Teaching>>,
) {
    let longest = bounds.timeout;
    let door = Door {
        tls: access.tls(&["h2", "http/1.1"]),
        access: access.clone(),
        router: router(maps, access, bounds, teaching),
    };
    let answered = move |socket, asked, refused: Option<Fault>| {
        let mut door = door.clone();
        let mut exchanges = Exchanges::new(longest);
        if let Some(fault) = refused {
            door.router = refusing(fault);
            exchanges = Exchanges::resting(TOLD, TOLD);
        }
        converse(socket, door, asked, exchanges)
    };
    accept(listener, permits, answered).await;
}

/// Answers every request with what is wrong.
fn refusing(fault: Fault) -> Router {
    let told = move || std::future::ready(Refusal::from(fault.clone()));
    Router::new().fallback(told)
}

fn router(maps: Maps, access: Access, bounds: Bounds, teaching: Option<Arc<Teaching>>) -> Router {
    let flight = flight::service(maps.clone(), bounds.clone());
    let app = App {
        maps,
        bounds,
        counts: Arc::default(),
        teaching,
        viewers: live::viewers(),
    };
    Router::new()
        .merge(of_map())
        .nest("/maps/{map}", of_map())
        .route("/maps/{map}/", get(page::page))
        .route("/maps", get(rows::maps))
        .route("/health", get(|| async { "ok\n" }))
        .route("/metrics", get(metrics::metrics))
        .fallback(refusal::unknown)
        .method_not_allowed_fallback(refusal::other_method)
        .layer(from_fn(request_body::whole))
        .route_service(flight::PATH, flight)
        .layer(from_fn_with_state(app.clone(), metrics::counted))
        .layer(from_fn_with_state(access, guarded))
        .with_state(app)
}

/// What there is of each map: under its name, and at the root where it is the only one.
fn of_map() -> Router<App> {
    Router::new()
        .route("/", get(page::page))
        .route("/page/{*file}", get(page::file))
        .route("/sql", get(rows::get_sql).post(rows::post_sql))
        .route("/layers", get(rows::layers))
        .route("/layers/{layer}", get(rows::layer))
        .route("/versions", get(rows::versions))
        .route(
            "/tiles/{site}/{version}/{zoom}/{x}/{y}",
            get(pictures::tile),
        )
        .route("/images", get(pictures::image))
        .route("/foxglove", any(live::watch))
        .route("/teach", get(teach::may))
        .route("/teach/{site}", get(teach::labels).post(teach::say))
        .route("/teach/{site}/{kind}", get(teach::hypotheses))
        .route(
            "/teach/{site}/{kind}/boxes",
            get(boxes::on_image).post(boxes::draw),
        )
}

/// Answers nothing to those who may not come in, and adds what keeps a browser careful.
async fn guarded(State(access): State<Access>, mut request: Request, next: Next) -> Response {
    let Some(who) = who(&access, &request) else {
        let asks = [(header::WWW_AUTHENTICATE, "Basic realm=\"evermap\"")];
        if access.users().is_some() && authorization(&request).is_some() {
            access.hold_up().await;
        }
        return match access.users() {
            Some(_) => (StatusCode::UNAUTHORIZED, asks).into_response(),
            None => StatusCode::FORBIDDEN.into_response(),
        };
    };
    request.extensions_mut().insert(who);
    let mut response = next.run(request).await;
    for (name, value) in CAREFUL {
        response
            .headers_mut()
            .insert(name, HeaderValue::from_static(value));
    }
    response
}

fn who<B>(access: &Access, request: &axum::http::Request<B>) -> Option<Who> {
    // Of HTTP/2, the host is part of the address.
    let host =
        text(request, header::HOST).or_else(|| request.uri().authority().map(|host| host.as_str()));
    access.lets_in(authorization(request).as_deref(), host)
}

/// How who asks says that they may: by a header, or a token in the address of a door that has no headers.
fn authorization<B>(request: &axum::http::Request<B>) -> Option<String> {
    let token = live::token(request.uri()).map(|token| format!("Bearer {token}"));
    token.or_else(|| text(request, header::AUTHORIZATION).map(str::to_owned))
}

fn text<B>(request: &axum::http::Request<B>, name: header::HeaderName) -> Option<&str> {
    request.headers().get(name)?.to_str().ok()
}

const CAREFUL: [(header::HeaderName, &str); 4] = [
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::X_FRAME_OPTIONS, "DENY"),
    (header::REFERRER_POLICY, "no-referrer"),
    (
        header::CONTENT_SECURITY_POLICY,
        "default-src 'self'; img-src 'self' data: blob:; style-src 'self' 'unsafe-inline'; worker-src 'self' blob:",
    ),
];

/// The map that a path names, or the only one.
pub struct MapOf(Arc<ServedMap>);

impl FromRequestParts<App> for MapOf {
    type Rejection = Refusal;

    async fn from_request_parts(parts: &mut Parts, app: &App) -> Result<Self, Refusal> {
        let params = RawPathParams::from_request_parts(parts, app).await;
        let params = params.map_err(|error| Fault::user(error.to_string()))?;
        let named = params.iter().find(|(name, _)| *name == "map");
        let map = match named {
            Some((_, name)) => app.maps.get(name)?,
            None => app
                .maps
                .only()
                .ok_or_else(|| Fault::user("there are several maps here").next("see /maps"))?,
        };
        Ok(Self(Arc::clone(map)))
    }
}

/// A name that a path has. Browsers take `.` and `..` for folders, however they are encoded, so a `~` stands before these; before
/// `~.` too, which would be read as `.`.
pub fn named<'p>(path: &'p BTreeMap<String, String>, part: &str) -> &'p str {
    let written = path.get(part).map_or("", String::as_str);
    let plain = written.strip_prefix('~');
    let plain = plain.filter(|plain| matches!(plain.trim_start_matches('~'), "." | ".."));
    plain.unwrap_or(written)
}

/// An answer that a browser keeps, and asks for again by its tag: it stays right when a map is made anew.
pub fn tagged(headers: &HeaderMap, tag: &str, kind: &'static str, body: Vec<u8>) -> Response {
    match has(headers, tag) {
        true => unchanged(tag),
        false => (kept(tag), [(header::CONTENT_TYPE, kind)], body).into_response(),
    }
}

/// Whether who asks has what this tag is of.
pub fn has(headers: &HeaderMap, tag: &str) -> bool {
    let known = headers.get(header::IF_NONE_MATCH);
    known.is_some_and(|known| known.as_bytes() == format!("\"{tag}\"").as_bytes())
}

/// The answer to who has it.
pub fn unchanged(tag: &str) -> Response {
    (StatusCode::NOT_MODIFIED, kept(tag)).into_response()
}

/// The head of what is kept under a tag.
pub fn kept(tag: &str) -> [(header::HeaderName, String); 2] {
    [
        (header::ETAG, format!("\"{tag}\"")),
        (header::CACHE_CONTROL, "private, no-cache".to_owned()),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_browsers_take_for_folders_are_written_otherwise() {
        for (written, name) in [
            ("lot", "lot"),
            ("~lot", "~lot"),
            ("~", "~"),
            ("~.", "."),
            ("~..", ".."),
            ("~~.", "~."),
            ("~...", "~..."),
            ("..", ".."),
        ] {
            let path = BTreeMap::from([("site".to_owned(), written.to_owned())]);
            assert_eq!(named(&path, "site"), name, "{written}");
        }
        assert_eq!(named(&BTreeMap::new(), "site"), "");
    }
}
