//! Barr warps.
