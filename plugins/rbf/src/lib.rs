//! RBF.
