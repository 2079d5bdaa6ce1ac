//! Stores that do not do quite what they should, for tests.

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

/// What is odd about a store when it is asked to create an object only where there is none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Quirk {
    /// It overwrites and reports success.
    IgnoresCondition,
    /// It reports that there is an object and overwrites it.
    OverwritesAndDenies,
    /// It does not know the request.
    KnowsNoCondition,
    /// It says always that there is an object.
    DeniesAll,
    /// Its answer is lost, so that it is asked again and says that there is an object.
    LosesAnswers,
    /// Every other time it lets nobody have the key, as S3 does when two ask at the same moment.
    DeniesEveryOther,
}

/// A store in memory with a quirk.
#[derive(Debug)]
pub(crate) struct Quirky {
    pub(crate) quirk: Quirk,
    pub(crate) objects: InMemory,
    pub(crate) asked: AtomicUsize,
}

impl fmt::Display for Quirky {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.quirk)
    }
}

#[async_trait]
impl ObjectStore for Quirky {
    async fn put_opts(&self, key: &Path, payload: PutPayload, options: PutOptions) -> Result<PutResult> {
        if options.mode != PutMode::Create {
            return self.objects.put_opts(key, payload, options).await;
        }
        let taken = || Err(Error::AlreadyExists { path: key.to_string(), source: "taken".into() });
        let there = self.objects.head(key).await.is_ok();
        match self.quirk {
            Quirk::IgnoresCondition => self.objects.put(key, payload).await,
            Quirk::OverwritesAndDenies => {
                let put = self.objects.put(key, payload).await;
                if there { taken() } else { put }
            }
            Quirk::KnowsNoCondition => Err(Error::NotImplemented {
                operation: "If-None-Match".into(),
                implementer: self.to_string(),
            }),
            Quirk::DeniesAll => taken(),
            Quirk::LosesAnswers => {
                self.objects.put_opts(key, payload, options).await?;
                taken()
            }
            Quirk::DeniesEveryOther if self.asked.fetch_add(1, Ordering::Relaxed) % 2 == 1 => taken(),
            Quirk::DeniesEveryOther => self.objects.put_opts(key, payload, options).await,
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
