//! Buckets on Amazon S3 and compatible servers.

use std::sync::Arc;

use object_store::aws::{AmazonS3Builder, AmazonS3ConfigKey};
use object_store::prefix::PrefixStore;
use object_store::{ClientConfigKey, ObjectStore};

use crate::error::{Error, Result};

/// Opens `BUCKET` or `BUCKET/PREFIX`. `root` is the location for messages. Region, credentials and endpoint come from the environment
/// (`AWS_REGION`, `AWS_ACCESS_KEY_ID`, `AWS_SECRET_ACCESS_KEY`, `AWS_SESSION_TOKEN`, `AWS_ENDPOINT_URL`,
/// `AWS_ALLOW_HTTP`, ...).
pub(super) fn open(place: &str, root: &str) -> Result<Arc<dyn ObjectStore>> {
    let (bucket, prefix) = place.split_once('/').unwrap_or((place, ""));
    connect(AmazonS3Builder::from_env().with_bucket_name(bucket), prefix, root)
}

fn connect(builder: AmazonS3Builder, prefix: &str, root: &str) -> Result<Arc<dyn ObjectStore>> {
    // Fails if the program has installed a provider already, which serves as well.
    let _ = rustls::crypto::ring::default_provider().install_default();
    let allows_http = builder.get_config_value(&AmazonS3ConfigKey::Client(ClientConfigKey::AllowHttp));
    let endpoint = builder.get_config_value(&AmazonS3ConfigKey::Endpoint).unwrap_or_default();
    if endpoint.starts_with("http://") && allows_http.as_deref() != Some("true") {
        let reason = format!("{endpoint} is not encrypted; use https, or set AWS_ALLOW_HTTP=true");
        return Err(Error::refused(&root, reason));
    }
    let objects = builder.build().map_err(|source| error("open the bucket", root.to_owned(), source))?;
    Ok(if prefix.is_empty() { Arc::new(objects) } else { Arc::new(PrefixStore::new(objects, prefix)) })
}

/// Wraps a failed operation on `place`. Without credentials in the environment, the client asks the metadata service of a cloud.
/// Outside a cloud, that service's error would not tell the user what is missing.
pub(super) fn error(action: &'static str, place: String, source: object_store::Error) -> Error {
    let message = source.to_string();
    // Paths of Amazon's metadata service.
    let asked_cloud = ["/latest/api/token", "/latest/meta-data/"].iter().any(|path| message.contains(path));
    if !asked_cloud {
        return Error::Failed { action, place, source: source.into() };
    }
    let reason = format!(
        "cannot {action}: no credentials. Set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY in the environment (and \
         AWS_SESSION_TOKEN for temporary ones). The cloud's metadata service has none either: {source}"
    );
    Error::refused(&place, reason)
}

#[cfg(test)]
mod tests {
    use object_store::{BackoffConfig, RetryConfig};

    use super::*;
    use crate::store::Store;
    use crate::store::location::Location;

    #[test]
    fn missing_credentials_are_reported_with_the_variables_to_set() {
        let retry =
            RetryConfig { max_retries: 0, backoff: BackoffConfig::default(), ..RetryConfig::default() };
        let builder = AmazonS3Builder::new()
            .with_bucket_name("lab")
            .with_metadata_endpoint("http://127.0.0.1:1")
            .with_retry(retry);
        let root = "s3://lab/models";
        let objects = connect(builder, "models", root).unwrap();
        let location: Location = root.parse().unwrap();
        let store = Store { objects, ..Store::open(&location).unwrap() };
        let refusal = store.read("registry.json").unwrap_err().to_string();
        assert!(refusal.contains("s3://lab/models/registry.json"), "{refusal}");
        assert!(refusal.contains("AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY"), "{refusal}");
    }
}
