//! Real plugins, alone and in stacks, and files that are damaged.

mod common;
mod plugins;
mod readers;
mod stack;
