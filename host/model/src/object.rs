//! Objects: models that are no files but are in a store behind a network, and named by a URL. The code that
//! talks to stores is a crate of its own, which a program [installs](install) if it was built with it; this
//! module has the interface that the other crates need.
//!
//! Secrets in a URL, as the signature of one that was signed beforehand, never are part of a path: they are
//! [taken out](admit) where a URL comes in, and remembered by this process for the store alone. So neither
//! messages nor files can have them.

use std::collections::BTreeMap;
use std::ffi::{OsStr, OsString};
use std::fmt::Debug;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use crate::{Error, Result};

/// Schemes of the URLs of objects.
const SCHEMES: [&str; 7] = ["s3", "gs", "az", "abfs", "abfss", "https", "http"];

/// Store that opens objects and begins uploads, for all threads.
pub trait Store: Send + Sync {
    /// Opens the object of a URL to read it; `None` where there is none.
    ///
    /// # Errors
    /// The store cannot be reached, or refuses.
    fn open(&self, url: &str) -> Result<Option<Arc<dyn Object>>>;

    /// Begins an object in parts, which cannot be seen until it is [complete](Upload::complete).
    ///
    /// # Errors
    /// As of [`open`](Self::open); the store takes no parts.
    fn begin(&self, url: &str) -> Result<Box<dyn Upload>>;

    /// Goes on with an upload that was begun before, perhaps by another machine, by its [id](Upload::id).
    ///
    /// # Errors
    /// As of [`begin`](Self::begin); whether there is such an upload is told when a part is sent.
    fn go_on(&self, url: &str, id: &str) -> Result<Box<dyn Upload>>;
}

/// An object that is read, in the version that was there when it was opened.
pub trait Object: Debug + Send + Sync {
    /// The object's length in bytes.
    fn bytes(&self) -> u64;

    /// Version of the object, which differs from that of another object that has its name later.
    fn version(&self) -> &str;

    /// Fills a buffer from the byte `offset` on; the whole range has to lie in the object.
    ///
    /// # Errors
    /// The store cannot be reached, or another version has the name by now.
    fn read_at(&self, buffer: &mut [u8], offset: u64) -> Result<()>;
}

/// An object in the making.
pub trait Upload: Send {
    /// Name of the upload in the store, by which another process can go on with it.
    fn id(&self) -> &str;

    /// Sends a part, while the caller goes on; waits first where too many bytes are on their way. All parts
    /// but the one of the highest number are of 5 MiB or more. A part that is sent again replaces the former
    /// one.
    ///
    /// # Errors
    /// This part, or one that was sent before, did not arrive.
    fn send(&mut self, number: usize, bytes: Vec<u8>) -> Result<()>;

    /// Waits until all parts have arrived; the number of each that was sent here, and its tag, by which the
    /// store knows it.
    ///
    /// # Errors
    /// One did not arrive.
    fn sent(&mut self) -> Result<BTreeMap<usize, String>>;

    /// Puts the object in its place, of parts with these tags, from number 0 on, which have so many bytes
    /// together.
    ///
    /// # Errors
    /// The store cannot be reached, has other parts, or knows no such upload (any more).
    fn complete(&mut self, tags: Vec<String>, bytes: u64) -> Result<()>;

    /// Removes the upload and all its parts. This takes some seconds at most.
    ///
    /// # Errors
    /// The store cannot be reached.
    fn abort(&mut self) -> Result<()>;
}

/// Store that opens objects in this process.
static STORE: OnceLock<Box<dyn Store>> = OnceLock::new();

/// Installs the store that opens objects, once, before any object is opened.
pub fn install(store: Box<dyn Store>) {
    let _ = STORE.set(store);
}

/// Whether a path is the URL of an object.
pub fn is_object(path: &Path) -> bool {
    path.to_str().is_some_and(is_url)
}

fn is_url(text: &str) -> bool {
    text.split_once("://").is_some_and(|(scheme, _)| SCHEMES.contains(&scheme))
}

/// Whole URLs of objects, with their secrets, by the names without secrets.
static WHOLE: Mutex<BTreeMap<String, String>> = Mutex::new(BTreeMap::new());

/// Name of an object: its URL without user, password and query, which this process remembers. A name that is
/// no URL stays as it is.
pub fn admit(name: impl AsRef<OsStr>) -> OsString {
    let name = name.as_ref();
    let Some(url) = name.to_str().filter(|text| is_url(text)) else { return name.to_owned() };
    let plain = without_secrets(url);
    if plain != url {
        WHOLE.lock().unwrap_or_else(PoisonError::into_inner).insert(plain.clone(), url.to_owned());
    }
    plain.into()
}

fn without_secrets(url: &str) -> String {
    let url = url.split(['?', '#']).next().unwrap_or(url);
    let Some((scheme, rest)) = url.split_once("://") else { return url.to_owned() };
    let (host, path) = rest.split_at(rest.find('/').unwrap_or(rest.len()));
    // The text before the host in Azure's URLs is the container.
    let host = if scheme.starts_with("http") { host.rsplit('@').next().unwrap_or(host) } else { host };
    format!("{scheme}://{host}{path}")
}

/// The URL that a store is asked for.
fn whole(path: &Path) -> String {
    let plain = path.to_string_lossy().into_owned();
    WHOLE.lock().unwrap_or_else(PoisonError::into_inner).get(&plain).cloned().unwrap_or(plain)
}

/// Store, and the whole URL of the path.
fn store(action: &str, path: &Path) -> Result<(&'static dyn Store, String)> {
    let store = STORE.get().ok_or_else(|| {
        Error::argument(
            format!("cannot {action} {}: this build reads and writes files alone", path.display()),
            "build it with `cargo build --release --features object-storage`, or copy the model to a file",
        )
    })?;
    Ok((&**store, whole(path)))
}

/// Opens an object to read it.
///
/// # Errors
/// There is none, the store cannot be reached or refuses, or this program was built without any.
pub fn open(path: &Path) -> Result<Arc<dyn Object>> {
    find(path)?.ok_or_else(|| {
        Error::system(
            format!("cannot open {}: there is no such object", path.display()),
            "check the bucket and the name",
        )
    })
}

/// Opens an object of a store to read it; `None` where there is none.
///
/// # Errors
/// As of [`open`].
pub fn find(path: &Path) -> Result<Option<Arc<dyn Object>>> {
    let (store, url) = store("open", path)?;
    store.open(&url)
}

/// An upload that this process has begun. Dropped before it is [complete](Self::complete), it leaves nothing
/// in the store.
pub struct BegunUpload {
    upload: Box<dyn Upload>,
    path: PathBuf,
    keeps: bool,
}

/// Begins to write an object: see [`Store::begin`].
///
/// # Errors
/// As of [`Store::begin`], or this program was built without any store.
pub fn begin(path: &Path) -> Result<BegunUpload> {
    let (store, url) = store("write", path)?;
    let upload = store.begin(&url)?;
    begun().push((path.to_owned(), upload.id().to_owned()));
    Ok(BegunUpload { upload, path: path.to_owned(), keeps: false })
}

/// Goes on with an object that was begun: see [`Store::go_on`]. When the returned upload is dropped, the
/// object stays as it is.
///
/// # Errors
/// As of [`begin`].
pub fn go_on(path: &Path, id: &str) -> Result<BegunUpload> {
    let (store, url) = store("write", path)?;
    Ok(BegunUpload { upload: store.go_on(&url, id)?, path: path.to_owned(), keeps: true })
}

impl BegunUpload {
    /// The upload.
    pub fn upload(&mut self) -> &mut dyn Upload {
        &mut *self.upload
    }

    /// Leaves the upload to other processes; returns the id by which they go on with it.
    pub fn leave(mut self) -> String {
        self.forget();
        self.upload.id().to_owned()
    }

    /// Puts the object in its place: see [`Upload::complete`].
    ///
    /// # Errors
    /// As of [`Upload::complete`].
    pub fn complete(&mut self, tags: Vec<String>, bytes: u64) -> Result<()> {
        self.upload.complete(tags, bytes)?;
        self.forget();
        Ok(())
    }

    /// Takes the upload off the list of those that this process removes.
    fn forget(&mut self) {
        self.keeps = true;
        begun().retain(|(path, id)| (path, &**id) != (&self.path, self.upload.id()));
    }
}

impl Drop for BegunUpload {
    fn drop(&mut self) {
        if !self.keeps {
            // Parts in a store that cannot be reached stay there: nothing can be done about them.
            let _ = self.upload.abort();
            self.forget();
        }
    }
}

/// Uploads that this process has begun and nobody would go on with: objects, and the ids of their uploads.
static BEGUN: Mutex<Vec<(PathBuf, String)>> = Mutex::new(Vec::new());

fn begun() -> MutexGuard<'static, Vec<(PathBuf, String)>> {
    BEGUN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Removes all uploads that this process has begun, as the process ends at once.
pub(crate) fn abandon_all() {
    let all = std::mem::take(&mut *begun());
    for (path, id) in all {
        let _ = go_on(&path, &id).and_then(|mut begun| begun.upload.abort());
    }
}

/// An error unless an object can be written; whether the store lets it be is told later.
///
/// # Errors
/// As of [`begin`].
pub fn check_output(path: &Path) -> Result<()> {
    go_on(path, "").map(drop)
}

/// An error where an object is named and only a file will do; `action` completes "cannot …".
///
/// # Errors
/// The path names an object.
pub fn check_file(action: &str, path: &Path) -> Result<()> {
    if !is_object(path) {
        return Ok(());
    }
    Err(Error::argument(
        format!("cannot {action} {}: it is an object, and here a file is needed", path.display()),
        "give the path of a file or folder; in a store are models alone, which `run`, `reconstruct` and `convert` write there",
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_are_told_from_files() {
        for name in ["s3://bucket/a.ply", "https://example.org/a.ply", "abfss://c@a.dfs.example.org/x"] {
            assert!(is_object(Path::new(name)), "{name}");
        }
        for name in ["a.ply", "/a/s3:/b", "ftp://example.org/a", "c://x", "S3/a", "models/s3://b/a"] {
            assert!(!is_object(Path::new(name)), "{name}");
        }
    }

    #[test]
    fn secrets_are_no_part_of_names() {
        for (url, name) in [
            ("https://h.org/a/b.ply?X-Amz-Signature=1/2@3#x", "https://h.org/a/b.ply"),
            ("https://me:word@h.org:1/b.ply", "https://h.org:1/b.ply"),
            ("http://h.org/a@b.ply", "http://h.org/a@b.ply"),
            ("abfss://box@h.org/b.ply?sig=1", "abfss://box@h.org/b.ply"),
            ("s3://bucket/b.ply", "s3://bucket/b.ply"),
        ] {
            assert_eq!(admit(url), name);
            assert_eq!(whole(Path::new(name)), url);
        }
        assert_eq!(admit("what?.ply"), "what?.ply");
    }

    #[test]
    fn without_a_store_the_build_is_named_that_has_one() {
        let error = open(Path::new("s3://bucket/a.ply")).unwrap_err();
        assert!(error.to_string().contains("s3://bucket/a.ply") && error.hint().contains("object-storage"));
    }
}
