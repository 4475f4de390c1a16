//! The page: files that are part of the program.

use std::collections::BTreeMap;

use axum::extract::Path;
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use include_dir::{Dir, include_dir};

use crate::serve::http::{MapOf, tagged};

static FILES: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/page");

/// `GET /`: the page.
pub async fn page(_: MapOf, headers: HeaderMap) -> Response {
    served("index.html", &headers)
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
