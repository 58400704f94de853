//! Three numbers in a session file. Neither glam's nor serde's own reading minds a fourth.

use glam::DVec3;
use serde::{Deserialize, Deserializer, de::Error};

/// Reader of exactly three numbers, for `#[serde(deserialize_with)]`.
pub fn three<'de, D: Deserializer<'de>>(deserializer: D) -> Result<DVec3, D::Error> {
    let numbers = Vec::<f64>::deserialize(deserializer)?;
    let count = numbers.len();
    let three = <[f64; 3]>::try_from(numbers);
    three
        .map(DVec3::from_array)
        .map_err(|_| D::Error::custom(format!("expected three numbers, found {count}")))
}

/// Reader as [`three`], for numbers that may be missing; together with `#[serde(default)]`.
pub fn maybe_three<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<DVec3>, D::Error> {
    three(deserializer).map(Some)
}

/// Reader of a list of exactly three numbers each, for `#[serde(deserialize_with)]`.
pub fn threes<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<DVec3>, D::Error> {
    #[derive(Deserialize)]
    struct Three(#[serde(deserialize_with = "three")] DVec3);
    Ok(Vec::<Three>::deserialize(deserializer)?.into_iter().map(|three| three.0).collect())
}
