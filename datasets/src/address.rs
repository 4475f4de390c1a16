//! Addresses of files and maps, as people write them.

use evermap_schemas::Fault;
use url::Url;

/// The URL that an address is; `None` for a path. In a store of objects, and on a disk, `#` and `?` are letters of names as a
/// space is: they would begin what belongs to no name, and another file would be meant.
///
/// # Errors
/// A user fault for what begins as a URL and is none, or has a query or a fragment on the web, which nobody would be sent.
pub fn url_of(address: &str) -> Result<Option<Url>, Fault> {
    let Some((scheme, _)) = address.split_once("://") else {
        return Ok(None);
    };
    let is_web = ["http", "https"].contains(&scheme.to_ascii_lowercase().as_str());
    let parsed = match is_web {
        true => Url::parse(address),
        false => Url::parse(&address.replace('#', "%23").replace('?', "%3F")),
    };
    let url = parsed.map_err(|error| Fault::user(format!("{address} is not a URL: {error}")))?;
    if url.query().is_some() || url.fragment().is_some() {
        return Err(Fault::user(format!(
            "expected an address without ? and #, found {address}"
        ))
        .next("write %3F and %23 where they belong to a name"));
    }
    Ok(Some(url))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use object_store::path::Path;

    use super::*;

    /// What is asked for in a store.
    fn key(address: &str) -> String {
        let url = url_of(address).unwrap().unwrap();
        Path::from_url_path(url.path()).unwrap().to_string()
    }

    #[test]
    fn signs_that_mean_something_in_urls_are_letters_of_names_in_stores() {
        assert_eq!(key("s3://lot/drive_1.mcap#other"), "drive_1.mcap#other");
        assert_eq!(key("s3://lot/y202?/*.mcap"), "y202?/*.mcap");
        assert_eq!(key("gs://lot/a b+ä%23.mcap"), "a b+ä#.mcap");
        let local = url_of("file:///maps/lot#2?").unwrap().unwrap();
        let path = local.to_file_path().unwrap();
        assert_eq!(path, std::path::Path::new("/maps/lot#2?"));
        assert_eq!(url_of("maps/lot#2").unwrap(), None);
    }

    #[test]
    fn what_would_not_be_sent_is_refused() {
        for address in ["https://lot.org/a.mcap?key=1", "http://lot.org/a.mcap#b"] {
            let fault = url_of(address).unwrap_err();
            assert!(fault.next.contains("%3F"), "{fault}");
        }
        assert_eq!(key("https://lot.org/a%3F.mcap"), "a?.mcap");
        assert!(url_of("s3://a b/c").is_err());
    }
}
