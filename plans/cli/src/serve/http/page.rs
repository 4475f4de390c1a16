//! The page: files that are part of the program.

use std::collections::BTreeMap;

use axum::extract::{OriginalUri, Path, RawPathParams, State};
use axum::http::HeaderMap;
use axum::response::{IntoResponse, Redirect, Response};
use include_dir::{Dir, include_dir};

use crate::serve::http::refusal::unknown;
use crate::serve::http::{App, Asks, Refusal, tagged};

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
        None => match served("index.html", &headers) {
            Some(page) => Ok(page),
            None => Err(unknown(OriginalUri(address)).await),
        },
    }
}

/// The address of a map's page.
pub fn address_of(map: &str) -> String {
    format!("/maps/{}/", encoded(map))
}

/// The name of a map as a part of a URL.
pub fn encoded(map: &str) -> String {
    let plain = |byte: &u8| byte.is_ascii_alphanumeric() || b"-._~".contains(byte);
    let encoded = map.as_bytes().iter().map(|byte| match plain(byte) {
        true => char::from(*byte).to_string(),
        false => format!("%{byte:02X}"),
    });
    encoded.collect()
}

/// `GET /page/{file}`: what it is made of.
///
/// # Errors
/// For a file that there is not.
pub async fn file(
    Asks(Path(path)): Asks<Path<BTreeMap<String, String>>>,
    address: OriginalUri,
    headers: HeaderMap,
) -> Result<Response, Refusal> {
    match served(path.get("file").map_or("", String::as_str), &headers) {
        Some(file) => Ok(file),
        None => Err(unknown(address).await),
    }
}

fn served(name: &str, headers: &HeaderMap) -> Option<Response> {
    let (file, kind) = (FILES.get_file(name)?, kind_of(name)?);
    let bytes = file.contents();
    let tag = blake3::hash(bytes).to_hex();
    Some(tagged(headers, &tag, kind, bytes.to_vec()))
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
