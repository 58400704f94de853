//! Three numbers in a session file. Neither glam's nor serde's own reading minds a fourth.

use glam::DVec3;
use serde::{Deserialize, Deserializer, de::Error};

/// For `#[serde(deserialize_with)]`: exactly three numbers.
pub(crate) fn three<'de, D: Deserializer<'de>>(deserializer: D) -> Result<DVec3, D::Error> {
    let numbers = Vec::<f64>::deserialize(deserializer)?;
    let count = numbers.len();
    let three = <[f64; 3]>::try_from(numbers);
    three
        .map(DVec3::from_array)
        .map_err(|_| D::Error::custom(format!("expected three numbers, found {count}")))
}
