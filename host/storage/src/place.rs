//! The place that a URL names: a store, and the object in it.

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use object_store::aws::{AmazonS3Builder, AmazonS3ConfigKey};
use object_store::azure::{AzureConfigKey, MicrosoftAzureBuilder};
use object_store::gcp::{GoogleCloudStorageBuilder, GoogleConfigKey};
use object_store::http::HttpBuilder;
use object_store::multipart::MultipartStore;
use object_store::path::Path;
use object_store::{ClientConfigKey, ObjectStore, RetryConfig};
use simod_model::{Error, Result, object};

use crate::failure::RequestFailure;

/// Longest time since a request began in which it is repeated.
const PATIENCE: Duration = Duration::from_secs(120);

/// Longest time of a request, unless the environment sets another: of one that fetches a block, and of one
/// that sends a part.
const READING: &str = "60 seconds";
const WRITING: &str = "300 seconds";

/// Object by its store, and its name there.
#[derive(Clone)]
pub(crate) struct ObjectLocation {
    /// The object's URL, without what may be secret.
    pub name: String,
    pub store: Arc<dyn ObjectStore>,
    /// The store that takes objects in parts, if it does.
    pub parts: Option<Arc<dyn MultipartStore>>,
    pub path: Path,
}

impl fmt::Debug for ObjectLocation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // The store itself would show credentials.
        f.debug_struct("ObjectLocation").field("name", &self.name).finish_non_exhaustive()
    }
}

impl ObjectLocation {
    /// The place of an object that is read.
    ///
    /// # Errors
    /// The text is no URL of an object, or settings in the environment make no sense.
    pub fn to_read(url: &str) -> Result<Self> {
        Self::from_url(url, READING)
    }

    /// The place of an object that is written.
    ///
    /// # Errors
    /// As of [`to_read`](Self::to_read).
    pub fn to_write(url: &str) -> Result<Self> {
        Self::from_url(url, WRITING)
    }

    fn from_url(url: &str, timeout: &str) -> Result<Self> {
        let name = object::admit(url).to_string_lossy().into_owned();
        let refused =
            |e: object_store::Error| Error::from(RequestFailure::new(&format!("cannot open {name}"), &e));
        // No other provider is linked, so that the installed one is this or an equal one.
        let _ = rustls::crypto::ring::default_provider().install_default();
        let (scheme, rest) = url.split_once("://").unwrap_or((url, ""));
        let (host, path) = rest.split_once('/').unwrap_or((rest, ""));
        let path = path.split(['?', '#']).next().unwrap_or(path);
        let path = if scheme.starts_with("http") { Path::from_url_path(path) } else { Path::parse(path) };
        let path = path.map_err(|e| refused(e.into()))?;
        if host.is_empty() || path.as_ref().is_empty() {
            let hint = "name an object as s3://bucket/folder/model.ply or https://host/model.ply";
            return Err(Error::argument(format!("{name} names no object"), hint));
        }
        let (store, parts) = store(url, (scheme, host), timeout).map_err(refused)?;
        Ok(Self { name, store, parts, path })
    }
}

/// A store by both traits: by the one for whole objects, and by that for objects in parts where it takes any.
type SharedStore = (Arc<dyn ObjectStore>, Option<Arc<dyn MultipartStore>>);

/// The store of a URL with this scheme and host. A request may take `timeout`, unless the environment says
/// otherwise.
fn store(url: &str, (scheme, host): (&str, &str), timeout: &str) -> object_store::Result<SharedStore> {
    let retry = RetryConfig { retry_timeout: PATIENCE, ..RetryConfig::default() };
    // Timeouts that are set in the environment are left as they are.
    let is_unset = |prefix: &str| std::env::var_os(format!("{prefix}_TIMEOUT")).is_none();
    let of_client = ClientConfigKey::Timeout;
    Ok(match scheme {
        "s3" => {
            let mut builder = AmazonS3Builder::from_env().with_bucket_name(host).with_retry(retry);
            if is_unset("AWS") {
                builder = builder.with_config(AmazonS3ConfigKey::Client(of_client), timeout);
            }
            both(builder.build()?)
        }
        "gs" => {
            let mut builder = GoogleCloudStorageBuilder::from_env().with_bucket_name(host).with_retry(retry);
            if is_unset("GOOGLE") {
                builder = builder.with_config(GoogleConfigKey::Client(of_client), timeout);
            }
            both(builder.build()?)
        }
        "az" | "abfs" | "abfss" => {
            let container = format!("{scheme}://{host}");
            let mut builder = MicrosoftAzureBuilder::from_env().with_url(container).with_retry(retry);
            if is_unset("AZURE") {
                builder = builder.with_config(AzureConfigKey::Client(of_client), timeout);
            }
            both(builder.build()?)
        }
        _ => {
            // Each request has the query of the base that it is made from, as of a URL that was signed.
            let query = url.split_once('?').map_or("", |(_, query)| query.split('#').next().unwrap_or(query));
            let base = format!("{scheme}://{host}/{}{query}", if query.is_empty() { "" } else { "?" });
            let mut builder = HttpBuilder::new().with_url(base).with_retry(retry);
            builder = builder.with_config(ClientConfigKey::Timeout, timeout);
            // A user who writes http:// means it.
            builder = builder.with_config(ClientConfigKey::AllowHttp, (scheme == "http").to_string());
            (Arc::new(builder.build()?), None)
        }
    })
}

/// One store by both traits.
fn both<S: ObjectStore + MultipartStore>(store: S) -> SharedStore {
    let store = Arc::new(store);
    (store.clone(), Some(store))
}
