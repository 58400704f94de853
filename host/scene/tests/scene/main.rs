//! Pictures of samples, surfaces and vertices, by a graphics card or the software that stands in for one.

mod common;
mod details;
mod goldens;
mod scenes;
mod surfaces;
