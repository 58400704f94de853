//! The program's commands, through the real binary: one module for each subject.

mod bind;
mod cancel;
mod compare;
mod convert;
mod diagnostics;
mod e57;
mod errors;
mod examples;
mod files;
mod formats;
mod gltf;
mod las;
mod main_job;
mod pictures;
mod place;
mod programs;
mod refine;
mod reliability;
mod resume;
mod sampling;
mod sheets;
mod shell;
mod trust;
mod turntable;
mod untouched;
mod versions;
