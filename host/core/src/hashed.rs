//! Bytes that are hashed on their way to a file, or from one.

use std::io::{self, Read, Write};

use xxhash_rust::xxh3::Xxh3Default;

/// Reader or writer that hashes the bytes which go through.
pub(crate) struct Hashed<T> {
    pub to: T,
    pub hash: Xxh3Default,
}

impl<T> Hashed<T> {
    /// Hashing reader or writer on `to`.
    pub fn new(to: T) -> Self {
        Self { to, hash: Xxh3Default::new() }
    }
}

impl<T: Write> Write for Hashed<T> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.to.write(bytes)?;
        self.hash.update(&bytes[..written]);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.to.flush()
    }
}

impl<T: Read> Read for Hashed<T> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let read = self.to.read(bytes)?;
        self.hash.update(&bytes[..read]);
        Ok(read)
    }
}
