//! Stores of objects that a test looks at while they are read.

use std::fmt::{self, Debug, Display, Formatter};
use std::ops::Range;
use std::sync::Arc;

use async_trait::async_trait;
use bytes::Bytes;
use futures::stream::BoxStream;
use object_store::path::Path;
use object_store::{
    CopyOptions, GetOptions, GetResult, ListResult, MultipartUpload, ObjectMeta, ObjectStore,
    PutMultipartOptions, PutOptions, PutPayload, PutResult, Result,
};

/// What a test does where a store is read; what it leaves out is done by the store alone.
#[async_trait]
pub trait Reads: Debug + Send + Sync + 'static {
    /// A file, or a part of it.
    ///
    /// # Errors
    /// The store's, and what the test wants.
    async fn file(
        &self,
        store: &dyn ObjectStore,
        location: &Path,
        options: GetOptions,
    ) -> Result<GetResult> {
        store.get_opts(location, options).await
    }

    /// Parts of a file.
    ///
    /// # Errors
    /// The store's, and what the test wants.
    async fn parts(
        &self,
        store: &dyn ObjectStore,
        location: &Path,
        ranges: &[Range<u64>],
    ) -> Result<Vec<Bytes>> {
        store.get_ranges(location, ranges).await
    }
}

/// A store that is read as a test wants, and is another one in all else.
#[derive(Debug)]
pub struct Watched<R> {
    /// The other one.
    pub store: Arc<dyn ObjectStore>,
    /// What the test does.
    pub reads: R,
}

impl<R> Display for Watched<R> {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str("watched")
    }
}

#[async_trait]
impl<R: Reads> ObjectStore for Watched<R> {
    async fn get_opts(&self, location: &Path, options: GetOptions) -> Result<GetResult> {
        let store = self.store.as_ref();
        self.reads.file(store, location, options).await
    }

    async fn get_ranges(&self, location: &Path, ranges: &[Range<u64>]) -> Result<Vec<Bytes>> {
        let store = self.store.as_ref();
        self.reads.parts(store, location, ranges).await
    }

    async fn put_opts(&self, l: &Path, p: PutPayload, o: PutOptions) -> Result<PutResult> {
        self.store.put_opts(l, p, o).await
    }

    async fn put_multipart_opts(
        &self,
        l: &Path,
        o: PutMultipartOptions,
    ) -> Result<Box<dyn MultipartUpload>> {
        self.store.put_multipart_opts(l, o).await
    }

    fn delete_stream(
        &self,
        l: BoxStream<'static, Result<Path>>,
    ) -> BoxStream<'static, Result<Path>> {
        self.store.delete_stream(l)
    }

    fn list(&self, prefix: Option<&Path>) -> BoxStream<'static, Result<ObjectMeta>> {
        self.store.list(prefix)
    }

    async fn list_with_delimiter(&self, prefix: Option<&Path>) -> Result<ListResult> {
        self.store.list_with_delimiter(prefix).await
    }

    async fn copy_opts(&self, from: &Path, to: &Path, o: CopyOptions) -> Result<()> {
        self.store.copy_opts(from, to, o).await
    }
}
