//! A version of an object: what tells it from others of its name, and its blocks, as they are brought.

use bytes::Bytes;
use object_store::{Error as StoreError, GetOptions, GetRange, ObjectMeta};

use crate::failure::RequestFailure;
use crate::place::ObjectLocation;

/// Bytes of a block.
pub(crate) const BLOCK: u64 = 4 << 20;

/// Number of times that a block is asked for whose bytes stop too early, where the library does not see to
/// that itself.
const TRIES: usize = 4;

/// Version of an object, and the conditions of requests for it.
#[derive(Debug)]
pub(crate) struct ObjectVersion {
    place: ObjectLocation,
    bytes: u64,
    /// Tag that tells the version from others: the store's or, where the store gives none, the time of
    /// writing.
    tag: String,
    /// Condition of a request by which no other version answers it.
    only: GetOptions,
}

impl ObjectVersion {
    /// Version of an object by the store's description of it.
    pub fn from_meta(place: ObjectLocation, meta: &ObjectMeta) -> Self {
        Self { place, bytes: meta.size, tag: tag_of(meta), only: only(meta) }
    }

    /// An object without bytes.
    pub fn empty(place: ObjectLocation) -> Self {
        Self { place, bytes: 0, tag: "empty".to_owned(), only: GetOptions::default() }
    }

    /// The object's length in bytes.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// The object's name.
    pub fn name(&self) -> &str {
        &self.place.name
    }

    /// Tag that tells the version from others of the same name.
    pub fn tag(&self) -> &str {
        &self.tag
    }

    /// Number of blocks of the object.
    pub fn blocks(&self) -> u64 {
        self.bytes.div_ceil(BLOCK)
    }

    /// Brings a block from the store.
    pub async fn fetch(&self, number: u64) -> Result<Bytes, RequestFailure> {
        let range = number * BLOCK..self.bytes.min((number + 1) * BLOCK);
        let length = range.end - range.start;
        let wanted = GetOptions { range: Some(GetRange::Bounded(range)), ..self.only.clone() };
        let what = format!("cannot read {}", self.name());
        let mut failure = RequestFailure::broken(&what);
        for _ in 0..TRIES {
            let answer = match self.place.store.get_opts(&self.place.path, wanted.clone()).await {
                Ok(answer) => answer,
                Err(StoreError::Precondition { .. }) => return Err(RequestFailure::changed(self.name())),
                Err(e) => return Err(RequestFailure::new(&what, &e)),
            };
            // Some stores ignore the condition of the request.
            if tag_of(&answer.meta) != self.tag || answer.meta.size != self.bytes {
                return Err(RequestFailure::changed(self.name()));
            }
            match answer.bytes().await {
                Ok(bytes) if bytes.len() as u64 == length => return Ok(bytes),
                Ok(_) => {}
                Err(e) => failure = RequestFailure::new(&what, &e),
            }
        }
        Err(failure)
    }
}

fn tag_of(meta: &ObjectMeta) -> String {
    meta.e_tag.clone().unwrap_or_else(|| meta.last_modified.to_string())
}

/// Condition of a request by which no other version answers it.
fn only(meta: &ObjectMeta) -> GetOptions {
    // Weak ones never match.
    let tag = meta.e_tag.clone().filter(|tag| !tag.starts_with("W/"));
    let is_dated = tag.is_none() && meta.last_modified.timestamp() > 0;
    let if_unmodified_since = is_dated.then_some(meta.last_modified);
    GetOptions { if_match: tag, if_unmodified_since, ..GetOptions::default() }
}
