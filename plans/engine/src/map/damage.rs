//! What can be wrong with a file of a map, and how it is found: by its size wherever it is opened, by its content
//! before anything is built on it.

use std::fmt;

use evermap_schemas::Fault;
use object_store::{GetResult, GetResultPayload, ObjectStoreExt};

use crate::error::store_fault;
use crate::map::receipt::Artifact;
use crate::map::store::Store;

/// The last bytes of a Parquet file that was written to its end: how long its metadata is, and `PAR1`.
const PARQUET_END: usize = 8;

/// A file of a map that is not what was written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Damage {
    /// Its name in the map.
    pub file: String,
    /// What was expected.
    pub expected: String,
    /// What was found; `None` where there is no such file.
    pub found: Option<String>,
}

impl fmt::Display for Damage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let found = self.found.as_deref().unwrap_or("no file");
        write!(
            f,
            "{}: expected {}, found {found}",
            self.file, self.expected
        )
    }
}

impl From<Damage> for Fault {
    fn from(damage: Damage) -> Self {
        Fault::data(damage.to_string())
            .next("run the same plan again, which makes anew what is damaged; `evermap verify` lists it all")
    }
}

impl Artifact {
    /// What is wrong with it as far as its size tells.
    ///
    /// # Errors
    /// A resource fault when the store does not answer.
    pub async fn size_damage(&self, store: &Store) -> Result<Option<Damage>, Fault> {
        let found = store.meta(&self.name()).await?;
        Ok(self.size_differs(found.map(|found| found.size)))
    }

    /// As [`Artifact::size_damage`], given the size of the file that is there.
    pub fn size_differs(&self, found: Option<u64>) -> Option<Damage> {
        (found != Some(self.bytes)).then(|| Damage {
            file: self.name(),
            expected: format!("{} bytes", self.bytes),
            found: found.map(|size| format!("{size} bytes")),
        })
    }

    /// That its last bytes are not those that end a Parquet file.
    pub fn without_end(&self) -> Damage {
        Damage {
            file: self.name(),
            expected: "the end of a Parquet file".to_owned(),
            found: Some("other bytes".to_owned()),
        }
    }

    /// What is wrong with it as far as its content tells. Reads all of it.
    ///
    /// # Errors
    /// A resource fault when the store does not answer.
    pub async fn content_damage(&self, store: &Store) -> Result<Option<Damage>, Fault> {
        content_damage(store, &self.name(), self.content.clone()).await
    }
}

/// Whether a Parquet file was written to its end.
///
/// # Errors
/// A resource fault when the store does not answer.
pub async fn is_whole(store: &Store, name: &str, bytes: u64) -> Result<bool, Fault> {
    let Some(end) = bytes.checked_sub(PARQUET_END as u64) else {
        return Ok(false);
    };
    let path = store.path(name);
    let found = store.objects().get_range(&path, end..bytes).await;
    let found = found.map_err(|error| store_fault(&error, name))?;
    Ok(is_end(&found, end))
}

/// As [`is_whole`], of a file that was read.
pub fn has_end(file: &[u8]) -> bool {
    let end = file.len().checked_sub(PARQUET_END);
    end.is_some_and(|end| is_end(&file[end..], end as u64))
}

/// Whether a Parquet file ends with these bytes, behind so many others.
fn is_end(end: &[u8], before: u64) -> bool {
    let Some((length, mark)) = end.split_first_chunk::<4>() else {
        return false;
    };
    // What reads Parquet believes the length of what lies before these bytes.
    mark == b"PAR1" && u64::from(u32::from_le_bytes(*length)) <= before
}

/// Whether the file at a name has another content than this digest says.
///
/// # Errors
/// A resource fault when the store does not answer.
pub async fn content_damage(
    store: &Store,
    name: &str,
    content: String,
) -> Result<Option<Damage>, Fault> {
    let found = match store.no_file(name).await? {
        Some(other) => Some(other.to_owned()),
        None => found_digest(store, name).await?,
    };
    Ok((found.as_ref() != Some(&content)).then(|| Damage {
        file: name.to_owned(),
        expected: format!("the digest {content}"),
        found,
    }))
}

/// The digest of a file; `None` where there is none.
async fn found_digest(store: &Store, name: &str) -> Result<Option<String>, Fault> {
    match store.objects().get(&store.path(name)).await {
        Ok(found) => digest(found, name).await.map(Some),
        Err(object_store::Error::NotFound { .. }) => Ok(None),
        Err(error) => Err(store_fault(&error, name)),
    }
}

/// The BLAKE3 of an object, read in pieces.
async fn digest(object: GetResult, name: &str) -> Result<String, Fault> {
    use futures::TryStreamExt;
    if let GetResultPayload::File(file, _) = object.payload {
        let hashed = tokio::task::spawn_blocking(move || {
            let mut hasher = blake3::Hasher::new();
            hasher.update_reader(file).map(|hasher| hasher.finalize())
        });
        let hashed = hashed.await.map_err(std::io::Error::other).flatten();
        let hash = hashed.map_err(|error| Fault::resource(format!("{name}: {error}")))?;
        return Ok(hash.to_hex().to_string());
    }
    let mut hasher = blake3::Hasher::new();
    let mut pieces = object.into_stream();
    while let Some(piece) = pieces
        .try_next()
        .await
        .map_err(|error| store_fault(&error, name))?
    {
        hasher.update(&piece);
    }
    Ok(hasher.finalize().to_hex().to_string())
}
