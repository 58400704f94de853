//! An object that is read: always the version that was there when it was opened.

use std::sync::Arc;

use object_store::{Error as StoreError, GetOptions, GetRange};
use simod_model::object::Object;
use simod_model::{Error, Result};

use crate::blocks::BlockCache;
use crate::failure::{RequestFailure, TRIES, broke_off, is_beyond_end};
use crate::place::ObjectLocation;
use crate::runtime::wait;
use crate::version::{BLOCK, ObjectVersion};

/// An object that is open.
#[derive(Debug)]
pub(crate) struct StoredObject {
    version: Arc<ObjectVersion>,
}

impl StoredObject {
    /// Opens the object; `None` where there is none.
    ///
    /// # Errors
    /// The store cannot be reached, or refuses.
    pub fn open(place: ObjectLocation) -> Result<Option<Self>> {
        // The object is opened by reading its first bytes, and not by asking for its properties, as a URL
        // that was signed allows nothing else.
        let first = GetOptions { range: Some(GetRange::Bounded(0..BLOCK)), ..GetOptions::default() };
        let ask = async || {
            let answer = place.store.get_opts(&place.path, first.clone()).await?;
            Ok((answer.meta.clone(), answer.bytes().await))
        };
        let mut tries = 1..TRIES;
        let (meta, block) = loop {
            match wait(ask())? {
                Ok(found) => break found,
                // The answer that there is no such object may be cut off, too.
                Err(e) if broke_off(&e) && tries.next().is_some() => {}
                Err(StoreError::NotFound { .. }) => return Ok(None),
                Err(e) if is_beyond_end(&e) => {
                    return Ok(Some(Self { version: Arc::new(ObjectVersion::empty(place)) }));
                }
                Err(e) => return Err(RequestFailure::new(&format!("cannot open {}", place.name), &e).into()),
            }
        };
        let version = Arc::new(ObjectVersion::from_meta(place, &meta));
        // A block comes again if it did not come whole.
        if let Ok(block) = block
            && block.len() as u64 == BLOCK.min(version.bytes())
        {
            BlockCache::of_process().put(&version, 0, block);
        }
        Ok(Some(Self { version }))
    }
}

impl Object for StoredObject {
    fn bytes(&self) -> u64 {
        self.version.bytes()
    }

    fn version(&self) -> &str {
        self.version.tag()
    }

    fn read_at(&self, mut buffer: &mut [u8], mut offset: u64) -> Result<()> {
        while !buffer.is_empty() {
            let block = BlockCache::of_process().get(&self.version, offset / BLOCK)?;
            let there = block.get((offset % BLOCK) as usize..).filter(|there| !there.is_empty());
            let there = there
                .ok_or_else(|| Error::internal(format!("{} is read beyond its end", self.version.name())))?;
            let count = there.len().min(buffer.len());
            buffer[..count].copy_from_slice(&there[..count]);
            buffer = &mut buffer[count..];
            offset += count as u64;
        }
        Ok(())
    }
}
