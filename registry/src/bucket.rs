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
    connect(AmazonS3Builder::from_env().with_bucket_name(bucket), prefix, root)
}

fn connect(builder: AmazonS3Builder, prefix: &str, root: &str) -> Result<Arc<dyn ObjectStore>> {
    // Fails where the program has chosen a provider before, which is as good.
    let _ = rustls::crypto::ring::default_provider().install_default();
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

/// An operation on `place` that failed. Where the environment names no credentials, the machine is asked for those that a cloud
/// gave it, and elsewhere than in a cloud that error would say nothing of what is missing.
pub(crate) fn error(action: &'static str, place: String, source: object_store::Error) -> Error {
    let told = source.to_string();
    // Paths of Amazon's metadata service.
    if ["/latest/api/token", "/latest/meta-data/"].iter().any(|path| told.contains(path)) {
        return Error::Credentials { action, place, source };
    }
    Error::Store { action, place, source }
}

#[cfg(test)]
mod tests {
    use object_store::{BackoffConfig, RetryConfig};

    use super::*;
    use crate::location::Location;
    use crate::store::Store;

    #[test]
    fn without_credentials_it_is_said_which_variables_to_set() {
        let retry =
            RetryConfig { max_retries: 0, backoff: BackoffConfig::default(), ..RetryConfig::default() };
        let builder = AmazonS3Builder::new()
            .with_bucket_name("lab")
            .with_metadata_endpoint("http://127.0.0.1:1")
            .with_retry(retry);
        let root = "s3://lab/models";
        let objects = connect(builder, "models", root).unwrap();
        let location: Location = root.parse().unwrap();
        let store = Store::open(&location).unwrap().with_objects(objects);
        let refusal = store.read("registry.json").unwrap_err().to_string();
        assert!(refusal.contains("s3://lab/models/registry.json"), "{refusal}");
        assert!(refusal.contains("AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY"), "{refusal}");
    }
}
