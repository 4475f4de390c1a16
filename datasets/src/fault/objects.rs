//! What stores of objects say when they fail.

use evermap_schemas::Fault;

/// Where a machine in a cloud is given credentials, which is asked when nobody gave any.
const ASKED_FOR_CREDENTIALS: &str = "169.254.169.254";

/// An object store's error as a fault.
pub fn store_fault(error: &object_store::Error) -> Fault {
    match error {
        object_store::Error::NotFound { path, .. } => {
            Fault::user(format!("expected a file, found nothing at {path}"))
        }
        object_store::Error::Precondition { .. } => changed(),
        other => with_credentials(Fault::resource(other.to_string())),
    }
}

/// That a file is another one than was opened.
pub fn changed() -> Fault {
    Fault::resource(
        "expected the file as it was opened, found another: the file changed while it was read",
    )
    .next("try again when nothing writes to it")
}

/// What a store said, with what to do next where it says that nobody gave credentials.
#[must_use]
pub fn with_credentials(said: Fault) -> Fault {
    advised(said, std::env::var_os("AWS_ACCESS_KEY_ID").is_some())
}

fn advised(said: Fault, given: bool) -> Fault {
    let of_s3 = said.message.contains("S3") && said.message.contains(ASKED_FOR_CREDENTIALS);
    match of_s3 && !given {
        true => said.next("set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY (README)"),
        false => said,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_gave_no_credentials_is_told_which_to_give() {
        let next = |text: &str, given| advised(Fault::resource(text), given).next;
        let asked =
            "Generic S3 error: Error performing PUT http://169.254.169.254/latest/api/token in 5s";
        let told = next(asked, false);
        assert!(told.contains("AWS_SECRET_ACCESS_KEY"), "{told}");
        assert_eq!(next(asked, true), "");
        assert_eq!(next("Generic S3 error: 503 Slow Down", false), "");
        let azure = "Generic MicrosoftAzure error: GET http://169.254.169.254/metadata/identity";
        assert_eq!(next(azure, false), "");
    }
}
