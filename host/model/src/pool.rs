//! Files of a model of very many, of which few are open at a time: each is opened again when it is read, and
//! has to be the file that it was.

use std::collections::VecDeque;
use std::fs::Metadata;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::SystemTime;

use crate::input::{self, Identity};
use crate::positioned::Positioned;
use crate::{Error, Result};

/// Most files that are open beside those that are being read just now, one for each thread.
const MOST_OPEN: usize = 32;

/// The files that are open, the last one that was read first.
#[derive(Debug, Default)]
pub(crate) struct Pool {
    open: Mutex<VecDeque<(PathBuf, Arc<Positioned>)>>,
}

impl Pool {
    fn take(&self, path: &Path) -> Option<Arc<Positioned>> {
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        let at = open.iter().position(|(known, _)| known == path)?;
        let file = open.remove(at)?;
        let found = file.1.clone();
        open.push_front(file);
        Some(found)
    }

    fn keep(&self, path: &Path, file: &Arc<Positioned>) {
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        open.push_front((path.to_owned(), file.clone()));
        open.truncate(MOST_OPEN);
    }
}

/// A file of a pool.
#[derive(Debug)]
pub(crate) struct Pooled {
    pool: Arc<Pool>,
    path: PathBuf,
    stamp: FileStamp,
}

/// Stamp of a file, by which a change of the file is noticed.
#[derive(Debug, PartialEq, Eq)]
struct FileStamp(Option<Identity>, u64, Option<SystemTime>);

impl FileStamp {
    fn new(path: &Path, is: &Metadata) -> Self {
        Self(Identity::from_path(path), is.len(), is.modified().ok())
    }
}

impl Pooled {
    /// Opens a file for the first time.
    ///
    /// # Errors
    /// As of [`input::open`].
    pub fn open(pool: &Arc<Pool>, path: &Path) -> Result<Self> {
        let file = input::open(path)?;
        let is = file.metadata().map_err(|e| Error::io("open", path, &e))?;
        pool.keep(path, &Arc::new(Positioned::new(file)));
        Ok(Self { pool: pool.clone(), path: path.to_owned(), stamp: FileStamp::new(path, &is) })
    }

    /// The files among which this one is.
    pub fn pool(&self) -> &Arc<Pool> {
        &self.pool
    }

    /// The open file.
    ///
    /// # Errors
    /// The file cannot be opened again, or is another one now.
    pub fn file(&self) -> Result<Arc<Positioned>> {
        if let Some(open) = self.pool.take(&self.path) {
            return Ok(open);
        }
        let file = input::open(&self.path)?;
        let is = file.metadata().map_err(|e| Error::io("open", &self.path, &e))?;
        if FileStamp::new(&self.path, &is) != self.stamp {
            return Err(Error::changed_while_read(&self.path));
        }
        let file = Arc::new(Positioned::new(file));
        self.pool.keep(&self.path, &file);
        Ok(file)
    }

    pub fn metadata(&self) -> io::Result<Metadata> {
        self.file().map_err(io::Error::other)?.metadata()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::write_file;

    #[test]
    fn few_are_open_and_each_is_the_one_that_it_was() {
        let folder = tempfile::tempdir().unwrap();
        let pool = Arc::new(Pool::default());
        let path = |i: usize| folder.path().join(i.to_string());
        let files: Vec<Pooled> = (0..3 * MOST_OPEN)
            .map(|i| {
                write_file(&path(i), &[i as u8]).unwrap();
                Pooled::open(&pool, &path(i)).unwrap()
            })
            .collect();
        for (i, file) in files.iter().enumerate().rev() {
            let mut byte = [0];
            file.file().unwrap().read_exact_at(&mut byte, 0).unwrap();
            assert_eq!(byte, [i as u8]);
            assert!(pool.open.lock().unwrap().len() <= MOST_OPEN);
        }
        // The last one was closed meanwhile, and another one has its name.
        let last = files.last().unwrap();
        write_file(&last.path, b"xy").unwrap();
        let error = last.file().unwrap_err().to_string();
        assert!(error.ends_with("changed while it was read"), "{error}");
    }
}
