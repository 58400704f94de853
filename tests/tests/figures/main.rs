//! Figures that are promised: errors of the transfer, and memory, of the real binary on large models.

mod accuracy;
mod exactness;
mod horse;
mod memory;
mod transfer;
