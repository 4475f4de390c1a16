//! Why a request has no answer, as it is said: a status, and an object of JSON.

use axum::extract::rejection::{JsonRejection, PathRejection, QueryRejection};
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::{FromRequestParts, OriginalUri};
use axum::http::request::Parts;
use axum::http::{Method, StatusCode, header};
use axum::response::{IntoResponse, Response};
use evermap_schemas::{Fault, Kind};
use serde_json::json;

use crate::ending::Failure;

/// Why a request has no answer.
pub struct Refusal {
    status: StatusCode,
    fault: Fault,
}

impl Refusal {
    /// One of a status of its own.
    pub fn new(status: StatusCode, fault: Fault) -> Self {
        Self { status, fault }
    }
}

impl From<Fault> for Refusal {
    fn from(fault: Fault) -> Self {
        let status = match fault.kind {
            Kind::User => StatusCode::BAD_REQUEST,
            Kind::Data => StatusCode::UNPROCESSABLE_ENTITY,
            Kind::Resource => StatusCode::SERVICE_UNAVAILABLE,
            Kind::Bug => StatusCode::INTERNAL_SERVER_ERROR,
        };
        Self { status, fault }
    }
}

impl From<Failure> for Refusal {
    fn from(failure: Failure) -> Self {
        let fault = match failure {
            Failure::Fault(fault) => fault,
            Failure::Plan(text) => Fault::user(text),
            Failure::Said | Failure::Closed => Fault::bug("nothing was written"),
        };
        fault.into()
    }
}

/// What an address says, read by an extractor of axum's: where that refuses it, as all else is refused.
pub struct Asks<E>(pub E);

impl<E, S> FromRequestParts<S> for Asks<E>
where
    E: FromRequestParts<S>,
    Refusal: From<E::Rejection>,
    S: Send + Sync,
{
    type Rejection = Refusal;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Refusal> {
        Ok(Self(E::from_request_parts(parts, state).await?))
    }
}

impl From<QueryRejection> for Refusal {
    fn from(rejection: QueryRejection) -> Self {
        Self::new(rejection.status(), Fault::user(rejection.body_text()))
    }
}

impl From<PathRejection> for Refusal {
    fn from(rejection: PathRejection) -> Self {
        Self::new(rejection.status(), Fault::user(rejection.body_text()))
    }
}

impl From<WebSocketUpgradeRejection> for Refusal {
    fn from(rejection: WebSocketUpgradeRejection) -> Self {
        Self::new(rejection.status(), Fault::user(rejection.body_text()))
    }
}

impl From<JsonRejection> for Refusal {
    fn from(rejection: JsonRejection) -> Self {
        Fault::user(rejection.body_text()).into()
    }
}

/// What is answered to an address that there is not.
pub async fn unknown(OriginalUri(address): OriginalUri) -> Refusal {
    let fault = Fault::user(format!("there is nothing at {}", address.path()));
    let fault = fault.next("docs/serving.md lists the addresses; /maps the maps");
    Refusal::new(StatusCode::NOT_FOUND, fault)
}

/// What is answered to a method that an address does not have.
pub async fn other_method(method: Method, OriginalUri(address): OriginalUri) -> Refusal {
    let fault = Fault::user(format!(
        "expected another method for {}, found {method}",
        address.path()
    ));
    let fault = fault.next("the header Allow says which");
    Refusal::new(StatusCode::METHOD_NOT_ALLOWED, fault)
}

impl IntoResponse for Refusal {
    fn into_response(self) -> Response {
        let Self { status, fault } = self;
        let place = (!fault.place.is_empty()).then_some(&fault.place);
        let next = (!fault.next.is_empty()).then_some(&fault.next);
        let body = json!({ "error": fault.message, "place": place, "next": next });
        let answer = (status, axum::Json(body));
        match status {
            // Nobody knows where the next request would begin.
            StatusCode::REQUEST_TIMEOUT => {
                ([(header::CONNECTION, "close")], answer).into_response()
            }
            _ => answer.into_response(),
        }
    }
}
