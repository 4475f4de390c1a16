//! Why a request has no answer, as it is said: a status, and an object of JSON.

use axum::http::{StatusCode, header};
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
