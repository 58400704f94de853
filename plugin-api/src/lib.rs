//! The one crate that a SIMOD plugin needs.
