//! An object that is written: parts of one upload, several of them on their way at a time.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use object_store::multipart::{MultipartStore, PartId};
use object_store::{Error as StoreError, ObjectStoreExt, PutPayload};
use simod_model::object::Upload;
use simod_model::{Error, Result};
use tokio::task::JoinSet;

use crate::failure::{RequestFailure, TRIES, is_cut};
use crate::place::ObjectLocation;
use crate::runtime::{runtime, wait};

/// Most bytes on their way, and most parts; but one part may be, however long.
const MOST_BYTES: usize = 64 << 20;
const MOST_PARTS: usize = 8;

/// Longest time of an abortion.
const ABORTION: Duration = Duration::from_secs(10);

/// An upload.
///
/// Memory: the parts on their way, 64 MiB at most, or one part if that is longer.
pub(crate) struct PartsUpload {
    place: ObjectLocation,
    parts: Arc<dyn MultipartStore>,
    id: String,
    on_way: JoinSet<(usize, usize, Result<PartId, StoreError>)>,
    bytes_on_way: usize,
    tags: BTreeMap<usize, String>,
}

impl PartsUpload {
    /// Begins one.
    ///
    /// # Errors
    /// The store cannot be reached, refuses, or takes no parts.
    pub fn begin(place: ObjectLocation) -> Result<Self> {
        let mut this = Self::go_on(place, "")?;
        let mut tries = 1..TRIES;
        loop {
            match wait(this.parts.create_multipart(&this.place.path))? {
                Ok(id) => this.id = id,
                Err(e) if is_cut(&e) && tries.next().is_some() => continue,
                Err(e) => return Err(this.failed(&e)),
            }
            return Ok(this);
        }
    }

    /// Goes on with an upload that was begun.
    ///
    /// # Errors
    /// The store takes no parts.
    pub fn go_on(place: ObjectLocation, id: &str) -> Result<Self> {
        let parts = place.parts.clone().ok_or_else(|| {
            let (operation, implementer) = ("parts".to_owned(), "HttpStore".to_owned());
            let error = StoreError::NotImplemented { operation, implementer };
            Error::from(RequestFailure::new(&format!("cannot write {}", place.name), &error))
        })?;
        let (on_way, tags) = (JoinSet::new(), BTreeMap::new());
        Ok(Self { place, parts, id: id.to_owned(), on_way, bytes_on_way: 0, tags })
    }

    fn failed(&self, error: &StoreError) -> Error {
        RequestFailure::new(&format!("cannot write {}", self.place.name), error).into()
    }

    /// Waits until one more part has arrived.
    fn take_one(&mut self) -> Result<()> {
        let Some(arrived) = wait(self.on_way.join_next())? else { return Ok(()) };
        let (number, bytes, answer) = arrived.map_err(|e| self.failed(&e.into()))?;
        self.bytes_on_way -= bytes;
        let part = answer.map_err(|e| self.failed(&e))?;
        self.tags.insert(number, part.content_id);
        Ok(())
    }

    /// Object in the upload's place, if there is one: its tag, its time of writing, and its length.
    fn in_place(&self) -> Result<Option<(Option<String>, String, u64)>> {
        match wait(self.place.store.head(&self.place.path))? {
            Ok(meta) => Ok(Some((meta.e_tag, meta.last_modified.to_string(), meta.size))),
            Err(StoreError::NotFound { .. }) => Ok(None),
            Err(e) => Err(self.failed(&e)),
        }
    }
}

impl Upload for PartsUpload {
    fn id(&self) -> &str {
        &self.id
    }

    fn send(&mut self, number: usize, bytes: Vec<u8>) -> Result<()> {
        while !self.on_way.is_empty()
            && (self.on_way.len() >= MOST_PARTS || self.bytes_on_way + bytes.len() > MOST_BYTES)
        {
            self.take_one()?;
        }
        let (parts, path, id) = (self.parts.clone(), self.place.path.clone(), self.id.clone());
        let length = bytes.len();
        self.bytes_on_way += length;
        let sent = async move {
            let answer = parts.put_part(&path, &id, number, PutPayload::from(bytes)).await;
            (number, length, answer)
        };
        self.on_way.spawn_on(sent, runtime()?.handle());
        Ok(())
    }

    fn sent(&mut self) -> Result<BTreeMap<usize, String>> {
        while !self.on_way.is_empty() {
            self.take_one()?;
        }
        Ok(std::mem::take(&mut self.tags))
    }

    fn complete(&mut self, tags: Vec<String>, bytes: u64) -> Result<()> {
        let before = self.in_place()?;
        let parts: Vec<PartId> = tags.into_iter().map(|content_id| PartId { content_id }).collect();
        let mut tries = 1..TRIES;
        loop {
            let completed = wait(self.parts.complete_multipart(&self.place.path, &self.id, parts.clone()))?;
            let Err(e) = completed else { return Ok(()) };
            // The answer may have been lost, and a second request is told that there is no such upload.
            let now = self.in_place().ok().flatten();
            let is_ours = |(_, _, length): &(Option<String>, String, u64)| *length == bytes;
            if now.as_ref().is_some_and(is_ours) && now != before {
                return Ok(());
            }
            if !is_cut(&e) || tries.next().is_none() {
                return Err(self.failed(&e));
            }
        }
    }

    fn abort(&mut self) -> Result<()> {
        self.on_way.abort_all();
        let aborted = async {
            let abortion = self.parts.abort_multipart(&self.place.path, &self.id);
            tokio::time::timeout(ABORTION, abortion).await
        };
        match wait(aborted)? {
            Ok(Ok(()) | Err(StoreError::NotFound { .. })) => Ok(()),
            Ok(Err(e)) => Err(self.failed(&e)),
            Err(_) => {
                Err(RequestFailure::broken(&format!("cannot abort the upload of {}", self.place.name)).into())
            }
        }
    }
}
