//! An object store in which an artifact is a file or nothing. DataFusion takes a name without a file for a folder, and reads
//! what is in it: an artifact that `gc` took from under a reader had no rows then, and not a word was said.

use std::fmt::{self, Display, Formatter};
use std::ops::Range;
use std::sync::Arc;

use async_trait::async_trait;
use bytes::Bytes;
use evermap_schemas::Fault;
use futures::future::ready;
use futures::stream::{self, BoxStream, StreamExt};
use object_store::path::Path;
use object_store::{
    CopyOptions, Error, GetOptions, GetResult, ListResult, MultipartUpload, ObjectMeta,
    ObjectStore, PutMultipartOptions, PutOptions, PutPayload, PutResult, RenameOptions, Result,
};

/// The folder of a map that has artifacts.
pub const ARTIFACTS: &str = "artifacts";

/// An object store beneath maps.
#[derive(Debug)]
pub struct Files(pub Arc<dyn ObjectStore>);

impl Display for Files {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// Whether a path is that of an artifact of a map.
fn is_artifact(path: &Path) -> bool {
    let mut parts = path.as_ref().rsplit('/');
    let is_file = parts.next().is_some_and(|name| name.ends_with(".parquet"));
    is_file && parts.next() == Some(ARTIFACTS)
}

/// That an artifact is gone, for whose rows somebody asks.
pub fn gone(path: &Path) -> Fault {
    let fault = Fault::data(format!("{path}: expected rows of a version, found no file"));
    fault.next(
        "ask another version, where `evermap gc` has forgotten this one; otherwise run the same plan again",
    )
}

/// The same, as a store says it.
fn not_found(path: &Path) -> Error {
    Error::NotFound {
        path: path.to_string(),
        source: Box::new(gone(path)),
    }
}

#[async_trait]
impl ObjectStore for Files {
    fn list(&self, prefix: Option<&Path>) -> BoxStream<'static, Result<ObjectMeta>> {
        match prefix.filter(|prefix| is_artifact(prefix)) {
            Some(artifact) => stream::once(ready(Err(not_found(artifact)))).boxed(),
            None => self.0.list(prefix),
        }
    }

    async fn put_opts(
        &self,
        location: &Path,
        payload: PutPayload,
        options: PutOptions,
    ) -> Result<PutResult> {
        self.0.put_opts(location, payload, options).await
    }

    async fn put_multipart_opts(
        &self,
        location: &Path,
        options: PutMultipartOptions,
    ) -> Result<Box<dyn MultipartUpload>> {
        self.0.put_multipart_opts(location, options).await
    }

    async fn get_opts(&self, location: &Path, options: GetOptions) -> Result<GetResult> {
        self.0.get_opts(location, options).await
    }

    async fn get_ranges(&self, location: &Path, ranges: &[Range<u64>]) -> Result<Vec<Bytes>> {
        self.0.get_ranges(location, ranges).await
    }

    fn delete_stream(
        &self,
        locations: BoxStream<'static, Result<Path>>,
    ) -> BoxStream<'static, Result<Path>> {
        self.0.delete_stream(locations)
    }

    fn list_with_offset(
        &self,
        prefix: Option<&Path>,
        offset: &Path,
    ) -> BoxStream<'static, Result<ObjectMeta>> {
        self.0.list_with_offset(prefix, offset)
    }

    async fn list_with_delimiter(&self, prefix: Option<&Path>) -> Result<ListResult> {
        self.0.list_with_delimiter(prefix).await
    }

    async fn copy_opts(&self, from: &Path, to: &Path, options: CopyOptions) -> Result<()> {
        self.0.copy_opts(from, to, options).await
    }

    async fn rename_opts(&self, from: &Path, to: &Path, options: RenameOptions) -> Result<()> {
        self.0.rename_opts(from, to, options).await
    }
}
