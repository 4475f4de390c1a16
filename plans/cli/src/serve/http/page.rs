//! The page: files that are part of the program.

use std::collections::BTreeMap;

use axum::extract::{OriginalUri, Path, RawPathParams, State};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Redirect, Response};
use include_dir::{Dir, include_dir};

use crate::serve::http::{App, Refusal, tagged};

static FILES: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/page");

/// `GET /`: the page of the only map, or the way to that of the first one.
pub async fn page(
    State(app): State<App>,
    path: RawPathParams,
    OriginalUri(address): OriginalUri,
    headers: HeaderMap,
) -> Result<Response, Refusal> {
    let named = path.iter().find(|(name, _)| *name == "map");
    let named = named.map(|(_, name)| app.maps.get(name)).transpose()?;
    if named.is_some() && !address.path().ends_with('/') {
        return Ok(Redirect::permanent(&format!("{}/", address.path())).into_response());
    }
    let first = app.maps.all().next();
    match first.filter(|_| named.is_none() && app.maps.only().is_none()) {
        Some(first) => Ok(Redirect::temporary(&address_of(&first.name)).into_response()),
        None => Ok(served("index.html", &headers)),
    }
}

/// The address of a map's page.
fn address_of(map: &str) -> String {
    let plain = |byte: &u8| byte.is_ascii_alphanumeric() || b"-._~".contains(byte);
    let encoded = map.as_bytes().iter().map(|byte| match plain(byte) {
        true => char::from(*byte).to_string(),
        false => format!("%{byte:02X}"),
    });
    format!("/maps/{}/", encoded.collect::<String>())
}

/// `GET /page/{file}`: what it is made of.
pub async fn file(Path(path): Path<BTreeMap<String, String>>, headers: HeaderMap) -> Response {
    served(path.get("file").map_or("", String::as_str), &headers)
}

fn served(name: &str, headers: &HeaderMap) -> Response {
    let (Some(file), Some(kind)) = (FILES.get_file(name), kind_of(name)) else {
        return StatusCode::NOT_FOUND.into_response();
    };
    let bytes = file.contents();
    tagged(headers, &blake3::hash(bytes).to_hex(), kind, bytes.to_vec())
}

fn kind_of(name: &str) -> Option<&'static str> {
    Some(match name.rsplit_once('.')?.1 {
        "html" => "text/html; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        "js" => "text/javascript; charset=utf-8",
        "svg" => "image/svg+xml",
        "png" => "image/png",
        _ => return None,
    })
}
