//! Buckets on Amazon S3 and servers that speak its protocol.

use std::sync::Arc;

use object_store::aws::{AmazonS3Builder, AmazonS3ConfigKey};
use object_store::prefix::PrefixStore;
use object_store::{ClientConfigKey, ObjectStore};

use crate::error::{Error, Result};

/// What lies below `prefix` in `bucket`; `root` is the place for messages. Region, credentials and endpoint are taken from the
/// environment (`AWS_REGION`, `AWS_ACCESS_KEY_ID`, `AWS_SECRET_ACCESS_KEY`, `AWS_SESSION_TOKEN`, `AWS_ENDPOINT_URL`,
/// `AWS_ALLOW_HTTP`, ...).
pub(crate) fn open(bucket: &str, prefix: &str, root: &str) -> Result<Arc<dyn ObjectStore>> {
    // Fails where the program has chosen a provider before, which is as good.
    let _ = rustls::crypto::ring::default_provider().install_default();
    let builder = AmazonS3Builder::from_env().with_bucket_name(bucket);
    let may_be_http = builder.get_config_value(&AmazonS3ConfigKey::Client(ClientConfigKey::AllowHttp));
    let endpoint = builder.get_config_value(&AmazonS3ConfigKey::Endpoint).unwrap_or_default();
    if endpoint.starts_with("http://") && may_be_http.as_deref() != Some("true") {
        let reason = format!("{endpoint} is not encrypted; use https, or set AWS_ALLOW_HTTP=true");
        return Err(Error::Location { text: root.to_owned(), reason });
    }
    let built = builder.build();
    let objects =
        built.map_err(|source| Error::Store { action: "open the bucket", place: root.to_owned(), source })?;
    Ok(if prefix.is_empty() { Arc::new(objects) } else { Arc::new(PrefixStore::new(objects, prefix)) })
}
