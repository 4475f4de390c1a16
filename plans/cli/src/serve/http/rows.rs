//! Rows of maps: queries, layers, versions.

use axum::extract::{Path, Query, State};
use axum::http::HeaderMap;
use axum::response::{IntoResponse, Response};
use axum::{Json, body::Bytes};
use datafusion::common::TableReference;
use evermap_engine::sql::{TABLES, catalog, no_table};
use evermap_schemas::layers::Georeference;
use evermap_schemas::{Fault, LayerRow};
use serde::Deserialize;
use serde_json::{Value, json};

use crate::earth::Earth;
use crate::serve::answer::answer;
use crate::serve::http::formats::{Form, body};
use crate::serve::http::page::address_of;
use crate::serve::http::{App, Asks, MapOf, Refusal, has, kept, unchanged};
use crate::serve::maps::{Opened, ServedMap};

/// What is asked, of which version, and how it is sent.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct QueryArguments {
    #[serde(default)]
    query: Option<String>,
    #[serde(default)]
    version: Option<u64>,
    #[serde(default)]
    format: Form,
    /// GeoJSON in the map's metres, wherever on earth it lies.
    #[serde(default)]
    local: bool,
}

impl QueryArguments {
    /// Where on earth the sites of a version lie, if that is asked.
    async fn earth(&self, of: &Opened) -> Result<Earth, Fault> {
        match self.format {
            Form::Geojson if !self.local => Earth::of(&of.reader).await,
            _ => Ok(Earth::default()),
        }
    }
}

/// `GET /maps`: names and paths.
pub async fn maps(State(app): State<App>) -> Json<Vec<Value>> {
    let maps = app.maps.all();
    let listed = maps.map(|map| json!({ "name": map.name, "path": address_of(&map.name) }));
    Json(listed.collect())
}

/// `GET /sql?query=…`
///
/// # Errors
/// What is wrong with the query.
pub async fn get_sql(
    State(app): State<App>,
    MapOf(map): MapOf,
    Asks(Query(asked)): Asks<Query<QueryArguments>>,
) -> Result<Response, Refusal> {
    let query = asked.query.as_deref().unwrap_or_default();
    answered(&app, &map, query, &asked).await
}

/// `POST /sql` with the query as its body.
///
/// # Errors
/// What is wrong with the query.
pub async fn post_sql(
    State(app): State<App>,
    MapOf(map): MapOf,
    Asks(Query(asked)): Asks<Query<QueryArguments>>,
    query: Bytes,
) -> Result<Response, Refusal> {
    let query = std::str::from_utf8(&query)
        .map_err(|_| Fault::user("expected a query in UTF-8, found other bytes"))?;
    answered(&app, &map, query, &asked).await
}

async fn answered(
    app: &App,
    map: &ServedMap,
    query: &str,
    asked: &QueryArguments,
) -> Result<Response, Refusal> {
    if query.trim().is_empty() {
        return Err(Fault::user("expected a query, found none")
            .next("/sql?query=SELECT …")
            .into());
    }
    let opened = map.version(asked.version).await?;
    let earth = asked.earth(&opened).await?;
    let answer = answer(&opened, query, &app.bounds).await?;
    body(answer, asked.format, None, &earth).await
}

/// `GET /layers`: the layers of a version.
///
/// # Errors
/// For a version that is not there.
pub async fn layers(
    State(app): State<App>,
    MapOf(map): MapOf,
    Asks(Query(asked)): Asks<Query<QueryArguments>>,
) -> Result<Response, Refusal> {
    answered(&app, &map, "SELECT * FROM layers ORDER BY layer", &asked).await
}

/// `GET /versions`: the versions there are.
///
/// # Errors
/// When the map is not there.
pub async fn versions(
    State(app): State<App>,
    MapOf(map): MapOf,
    Asks(Query(asked)): Asks<Query<QueryArguments>>,
) -> Result<Response, Refusal> {
    answered(
        &app,
        &map,
        "SELECT * FROM versions ORDER BY version",
        &asked,
    )
    .await
}

/// `GET /layers/{layer}`: all rows of a layer, for who does not have them yet: they are tagged by their content.
///
/// # Errors
/// For a layer or version that is not there.
pub async fn layer(
    State(app): State<App>,
    MapOf(map): MapOf,
    Asks(Path(path)): Asks<Path<std::collections::BTreeMap<String, String>>>,
    Asks(Query(asked)): Asks<Query<QueryArguments>>,
    headers: HeaderMap,
) -> Result<Response, Refusal> {
    let name = path.get("layer").map_or("", String::as_str);
    let opened = map.version(asked.version).await?;
    let tag = tag(&opened, name, &asked);
    if let Some(tag) = tag.as_deref().filter(|tag| has(&headers, tag)) {
        return Ok(unchanged(tag));
    }
    let tables = catalog(&opened.context)?.schema(TABLES);
    if !tables.is_some_and(|tables| tables.table_exist(name)) {
        return Err(no_layer(&opened, name).into());
    }
    let quoted = name.replace('"', "\"\"");
    let query = format!("SELECT * FROM \"{quoted}\"");
    let answer = answer(&opened, &query, &app.bounds).await?;
    let declared = opened.reader.declaration(name);
    let earth = asked.earth(&opened).await?;
    let body = body(answer, asked.format, declared.as_ref(), &earth).await?;
    Ok((tag.as_deref().map(kept), body).into_response())
}

/// That a version does not have a layer, with the one that may be meant.
fn no_layer(opened: &Opened, name: &str) -> Fault {
    let fault = no_table(&opened.context, &TableReference::bare(name));
    let fault = Fault {
        message: format!("there is no layer `{name}`"),
        ..fault
    };
    match fault.next.is_empty() {
        true => fault.next("/layers lists those that there are"),
        false => fault,
    }
}

/// What the body of a layer depends on; `None` for a table that is no layer.
fn tag(opened: &Opened, layer: &str, asked: &QueryArguments) -> Option<String> {
    let layers = opened.reader.map.layers();
    let digest = |name: &str| {
        let found = layers.iter().find(|info| info.layer == name);
        found.map(|info| info.digest.clone())
    };
    let earth = digest(Georeference::NAME).unwrap_or_default();
    let program = env!("CARGO_PKG_VERSION");
    let QueryArguments { format, local, .. } = asked;
    let all = format!("{program} {} {earth} {format:?} {local}", digest(layer)?);
    Some(blake3::hash(all.as_bytes()).to_hex().to_string())
}
