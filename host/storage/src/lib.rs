//! simod-storage: models in object stores. Objects are read in blocks, some of them ahead, and written in
//! parts of one upload; both by the crate `object_store`, whose own names of environment variables say
//! endpoints and credentials.
//!
//! The crates that know models know of this one by the trait [`Store`] alone, so that nothing else waits for
//! its libraries: a program is built with it, or without.

mod blocks;
mod failure;
mod place;
mod reading;
mod runtime;
mod upload;
mod version;

use std::sync::Arc;

use simod_model::Result;
use simod_model::object::{self, Object, Store, Upload};

use place::ObjectLocation;
use reading::StoredObject;
use upload::PartsUpload;

/// Makes this crate open the objects of this process from now on.
pub fn install() {
    object::install(Box::new(Stores));
}

/// All stores that the crate `object_store` knows.
struct Stores;

impl Store for Stores {
    fn open(&self, url: &str) -> Result<Option<Arc<dyn Object>>> {
        let object = StoredObject::open(ObjectLocation::to_read(url)?)?;
        Ok(object.map(|object| Arc::new(object) as Arc<dyn Object>))
    }

    fn begin(&self, url: &str) -> Result<Box<dyn Upload>> {
        Ok(Box::new(PartsUpload::begin(ObjectLocation::to_write(url)?)?))
    }

    fn go_on(&self, url: &str, id: &str) -> Result<Box<dyn Upload>> {
        Ok(Box::new(PartsUpload::go_on(ObjectLocation::to_write(url)?, id)?))
    }
}
