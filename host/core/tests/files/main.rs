//! Files that are written in parts, gone on with, and read though they are damaged.

mod parts;
mod readers;
mod resume;
