//! Keys of results that are kept from one evaluation to the next: hashes of all that a result came from,
//! number by number and bit by bit. The printed form of a value does not matter.

use std::path::Path;
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use glam::DVec3;
use simod_core::refinement::Finer;
use simod_plugin_api as api;
use xxhash_rust::xxh3::Xxh3Default;

use crate::side_file::Reference;

/// A key in the making.
pub struct Key(Xxh3Default);

impl Key {
    /// The key of what came from something that has this key itself.
    pub fn from_key(former: u64) -> Self {
        Self(Xxh3Default::new()).and(&former)
    }

    /// The key of this as well.
    pub fn and(mut self, what: &(impl Keyed + ?Sized)) -> Self {
        what.add_to(&mut self);
        self
    }

    /// The key.
    pub fn end(self) -> u64 {
        self.0.digest()
    }
}

/// Content of a key. Different content is added as different bytes: lengths before lists and texts, a number
/// before each case.
pub trait Keyed {
    /// Adds all of the content to the key.
    fn add_to(&self, key: &mut Key);
}

macro_rules! numbers {
    ($($number:ty),*) => {
        $(impl Keyed for $number {
            fn add_to(&self, key: &mut Key) {
                key.0.update(&self.to_le_bytes());
            }
        })*
    };
}
numbers!(u8, u32, u64, u128, i64, f32, f64);

impl Keyed for usize {
    fn add_to(&self, key: &mut Key) {
        (*self as u64).add_to(key);
    }
}

impl Keyed for bool {
    fn add_to(&self, key: &mut Key) {
        u8::from(*self).add_to(key);
    }
}

impl Keyed for str {
    fn add_to(&self, key: &mut Key) {
        self.len().add_to(key);
        key.0.update(self.as_bytes());
    }
}

impl Keyed for String {
    fn add_to(&self, key: &mut Key) {
        self.as_str().add_to(key);
    }
}

impl Keyed for Path {
    fn add_to(&self, key: &mut Key) {
        let bytes = self.as_os_str().as_encoded_bytes();
        bytes.len().add_to(key);
        key.0.update(bytes);
    }
}

impl Keyed for SystemTime {
    fn add_to(&self, key: &mut Key) {
        match self.duration_since(UNIX_EPOCH) {
            Ok(since) => (true, since.as_nanos()).add_to(key),
            Err(before) => (false, before.duration().as_nanos()).add_to(key),
        }
    }
}

impl<T: Keyed + ?Sized> Keyed for &T {
    fn add_to(&self, key: &mut Key) {
        (**self).add_to(key);
    }
}

impl<T: Keyed + ?Sized> Keyed for Arc<T> {
    fn add_to(&self, key: &mut Key) {
        (**self).add_to(key);
    }
}

impl<T: Keyed> Keyed for Option<T> {
    fn add_to(&self, key: &mut Key) {
        self.is_some().add_to(key);
        self.iter().for_each(|it| it.add_to(key));
    }
}

impl<T: Keyed> Keyed for [T] {
    fn add_to(&self, key: &mut Key) {
        self.len().add_to(key);
        self.iter().for_each(|it| it.add_to(key));
    }
}

impl<T: Keyed, const N: usize> Keyed for [T; N] {
    fn add_to(&self, key: &mut Key) {
        self.iter().for_each(|it| it.add_to(key));
    }
}

impl<T: Keyed> Keyed for Vec<T> {
    fn add_to(&self, key: &mut Key) {
        self.as_slice().add_to(key);
    }
}

impl<A: Keyed, B: Keyed> Keyed for (A, B) {
    fn add_to(&self, key: &mut Key) {
        self.0.add_to(key);
        self.1.add_to(key);
    }
}

impl Keyed for DVec3 {
    fn add_to(&self, key: &mut Key) {
        self.to_array().add_to(key);
    }
}

impl Keyed for api::Affine {
    fn add_to(&self, key: &mut Key) {
        self.rows.add_to(key);
    }
}

impl Keyed for api::Effort {
    fn add_to(&self, key: &mut Key) {
        self.0.add_to(key);
    }
}

impl Keyed for api::Time {
    fn add_to(&self, key: &mut Key) {
        (self.frame, self.seconds).add_to(key);
    }
}

impl Keyed for Reference {
    fn add_to(&self, key: &mut Key) {
        let Self { file, fingerprint } = self;
        (file.as_path(), fingerprint).add_to(key);
    }
}

impl Keyed for Finer {
    fn add_to(&self, key: &mut Key) {
        match self {
            Self::Error(error) => (0u8, error).add_to(key),
            Self::Factor(factor) => (1u8, factor).add_to(key),
            Self::Samples(samples) => (2u8, samples).add_to(key),
            Self::Auto { error, samples } => (3u8, (error, samples)).add_to(key),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::ParamValue;
    use crate::shapes::{RegionShape, Shapes};
    use std::collections::HashSet;

    fn key(what: &(impl Keyed + ?Sized)) -> u64 {
        Key::from_key(7).and(what).end()
    }

    #[test]
    fn equal_things_have_equal_keys_and_others_do_not() {
        let ball = |radius| RegionShape::Sphere { center: DVec3::ONE, radius };
        let cases = [
            key(&("ab", "c")),
            key(&("a", "bc")),
            key(&vec![1.0, 2.0]),
            key(&[1.0, 2.0]),
            key(&(vec![1.0], vec![2.0])),
            key(&0.0),
            key(&-0.0),
            key(&Some(0.0)),
            key(&None::<f64>),
            key(&ball(1.0)),
            key(&ball(1.0 + f64::EPSILON)),
            key(&RegionShape::Box { min: DVec3::ZERO, max: DVec3::ONE }),
            key(&RegionShape::HalfSpace { point: DVec3::ZERO, normal: DVec3::ONE }),
            key(&Shapes { shapes: vec![ball(1.0)], falloff: 0.0 }),
            key(&Shapes { shapes: vec![ball(1.0), ball(1.0)], falloff: 0.0 }),
            key(&ParamValue::Float(1.0)),
            key(&ParamValue::Length(1.0)),
            key(&ParamValue::Choice("a".into())),
            key(&ParamValue::File(Some("a".into()))),
            key(&ParamValue::File(None)),
            key(&Finer::Auto { error: 1.0, samples: None }),
            key(&Finer::Auto { error: 1.0, samples: Some(1) }),
            key(&Finer::Error(2.0)),
        ];
        assert_eq!(cases.iter().collect::<HashSet<_>>().len(), cases.len());
        assert_eq!(key(&ball(0.5)), key(&ball(0.5)));
        assert_ne!(Key::from_key(1).end(), Key::from_key(2).end());
    }
}
