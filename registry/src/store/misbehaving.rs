//! Test double: stores that misbehave when asked to create an object only if there is none.
#![cfg(test)]

use std::fmt;
use std::sync::atomic::{AtomicUsize, Ordering};

use async_trait::async_trait;
use futures_util::stream::BoxStream;
use object_store::memory::InMemory;
use object_store::path::Path;
use object_store::{
    CopyOptions, Error, GetOptions, GetResult, ListResult, MultipartUpload, ObjectMeta, ObjectStore,
    ObjectStoreExt, PutMode, PutMultipartOptions, PutOptions, PutPayload, PutResult, Result,
};

/// How a store misbehaves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Misbehavior {
    /// It overwrites and reports success.
    IgnoresCondition,
    /// It reports that the object exists, and overwrites it.
    OverwritesAndDenies,
    /// It does not support the condition.
    LacksCondition,
    /// It always reports that the object exists.
    DeniesAll,
    /// Its response is lost. The retried request then reports that the object exists.
    LosesAnswers,
    /// It denies every other request without creating anything, as S3 may do with two simultaneous requests.
    DeniesEveryOther,
}

/// A store in memory that misbehaves.
#[derive(Debug)]
pub(crate) struct MisbehavingStore {
    pub(crate) misbehavior: Misbehavior,
    pub(crate) objects: InMemory,
    pub(crate) requests: AtomicUsize,
}

impl fmt::Display for MisbehavingStore {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.misbehavior)
    }
}

#[async_trait]
impl ObjectStore for MisbehavingStore {
    async fn put_opts(&self, key: &Path, payload: PutPayload, options: PutOptions) -> Result<PutResult> {
        if options.mode != PutMode::Create {
            return self.objects.put_opts(key, payload, options).await;
        }
        let taken = || Err(Error::AlreadyExists { path: key.to_string(), source: "taken".into() });
        let exists = self.objects.head(key).await.is_ok();
        match self.misbehavior {
            Misbehavior::IgnoresCondition => self.objects.put(key, payload).await,
            Misbehavior::OverwritesAndDenies => {
                let put = self.objects.put(key, payload).await;
                if exists { taken() } else { put }
            }
            Misbehavior::LacksCondition => Err(Error::NotImplemented {
                operation: "If-None-Match".into(),
                implementer: self.to_string(),
            }),
            Misbehavior::DeniesAll => taken(),
            Misbehavior::LosesAnswers => {
                self.objects.put_opts(key, payload, options).await?;
                taken()
            }
            Misbehavior::DeniesEveryOther if self.requests.fetch_add(1, Ordering::Relaxed) % 2 == 1 => {
                taken()
            }
            Misbehavior::DeniesEveryOther => self.objects.put_opts(key, payload, options).await,
        }
    }

    async fn put_multipart_opts(
        &self,
        key: &Path,
        options: PutMultipartOptions,
    ) -> Result<Box<dyn MultipartUpload>> {
        self.objects.put_multipart_opts(key, options).await
    }

    async fn get_opts(&self, key: &Path, options: GetOptions) -> Result<GetResult> {
        self.objects.get_opts(key, options).await
    }

    fn delete_stream(&self, keys: BoxStream<'static, Result<Path>>) -> BoxStream<'static, Result<Path>> {
        self.objects.delete_stream(keys)
    }

    fn list(&self, prefix: Option<&Path>) -> BoxStream<'static, Result<ObjectMeta>> {
        self.objects.list(prefix)
    }

    async fn list_with_delimiter(&self, prefix: Option<&Path>) -> Result<ListResult> {
        self.objects.list_with_delimiter(prefix).await
    }

    async fn copy_opts(&self, from: &Path, to: &Path, options: CopyOptions) -> Result<()> {
        self.objects.copy_opts(from, to, options).await
    }
}
