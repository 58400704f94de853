//! The names by which numbers of vertices are known to turn with the surface.

use super::rules::TensorKind;
use super::splat::SplatNumbers;
use crate::{Attribute, Type};

/// Place of an attribute among all, if there is one of this name; an error if its numbers are not
/// floating-point.
fn place(name: &str, attributes: &[Attribute]) -> Result<Option<usize>, String> {
    let Some(place) = attributes.iter().position(|a| a.name == name) else { return Ok(None) };
    match attributes[place].kind {
        Type::F32 | Type::F64 => Ok(Some(place)),
        kind => Err(format!(
            "{name} is of type {}, and vectors that turn have to be float or double",
            kind.name()
        )),
    }
}

/// Places of the attributes of all these names, if all are there.
fn all(names: &[String], attributes: &[Attribute]) -> Result<Option<Vec<usize>>, String> {
    if !names.iter().all(|name| attributes.iter().any(|a| a.name == *name)) {
        return Ok(None);
    }
    names.iter().map(|name| place(name, attributes)).collect()
}

/// Ways in which programs name the parts of a vector.
const STYLES: usize = 6;

/// Name of a part of `name` in one of the spellings, as `name_x`.
fn spelt(style: usize, name: &str, i: usize, part: &str) -> String {
    match style {
        0 => format!("{name}_{part}"),
        1 => format!("{name}{part}"),
        2 => format!("{name}.{part}"),
        3 => format!("{name}_{i}"),
        4 => format!("{name}{i}"),
        // nx1 of n1.
        _ => {
            let (letter, rest) = name.split_at(name.chars().next().map_or(0, char::len_utf8));
            format!("{letter}{part}{rest}")
        }
    }
}

fn capitals(parts: &[&str]) -> Vec<String> {
    parts.iter().map(|part| part.to_ascii_uppercase()).collect()
}

/// Places of the attributes that a declared name means, in the order of its numbers.
pub(super) fn declared(name: &str, kind: TensorKind, attributes: &[Attribute]) -> Result<Vec<usize>, String> {
    let parts: &[&str] = match kind {
        TensorKind::Vector | TensorKind::Direction | TensorKind::Normal => &["x", "y", "z"],
        TensorKind::QuaternionWxyz => &["w", "x", "y", "z"],
        TensorKind::QuaternionXyzw => &["x", "y", "z", "w"],
        TensorKind::Covariance => &["xx", "xy", "xz", "yy", "yz", "zz"],
    };
    for style in 0..STYLES {
        // LAS has NormalX where others have normal_x.
        for parts in [parts.iter().map(|part| (*part).to_owned()).collect(), capitals(parts)] {
            let names: Vec<String> =
                parts.iter().enumerate().map(|(i, part)| spelt(style, name, i, part)).collect();
            if let Some(places) = all(&names, attributes)? {
                return Ok(places);
            }
        }
    }
    let wanted: Vec<String> = parts.iter().map(|part| format!("{name}_{part}")).collect();
    Err(format!("the vertices have no properties {}", wanted.join(", ")))
}

/// Place of the opacity of splats, if the vertices are splats.
pub fn opacity(attributes: &[Attribute]) -> Option<usize> {
    let has = |name: &str| attributes.iter().any(|a| a.name == name);
    (has("rot_0") && has("scale_0")).then(|| attributes.iter().position(|a| a.name == "opacity"))?
}

/// Most coefficients of a channel beyond the first: those of degree 3.
const MOST_COEFFICIENTS: usize = 15;

/// The numbers of splats, if the vertices are such: `rot_0` and `scale_0` tell.
///
/// # Errors
/// Something else of splats is not there.
pub(super) fn splat(attributes: &[Attribute]) -> Result<Option<(SplatNumbers, Vec<usize>)>, String> {
    let has = |name: &str| attributes.iter().any(|a| a.name == name);
    if !(has("rot_0") && has("scale_0")) {
        return Ok(None);
    }
    let needed = |name: String| {
        let missing = || format!("the vertices look like Gaussian splats, but have no property {name}");
        place(&name, attributes)?.ok_or_else(missing)
    };
    let scales = if has("scale_2") { 3 } else { 2 };
    let shape = (0..4).map(|i| format!("rot_{i}")).chain((0..scales).map(|i| format!("scale_{i}")));
    let mut places = shape.map(needed).collect::<Result<Vec<_>, _>>()?;
    let count = attributes.iter().filter(|a| a.name.starts_with("f_rest_")).count();
    let degree = (0..=3usize).find(|degree| 3 * ((degree + 1) * (degree + 1) - 1) == count);
    let degree = degree.ok_or_else(|| {
        format!(
            "the vertices look like Gaussian splats, but have {count} properties f_rest_*: harmonics of degree 0 to 3 \
             have 0, 9, 24 or {}",
            3 * MOST_COEFFICIENTS
        )
    })?;
    for i in 0..count {
        places.push(needed(format!("f_rest_{i}"))?);
    }
    places.extend(place("opacity", attributes)?);
    Ok(Some((SplatNumbers { scales, degree }, places)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn floats(names: &[&str]) -> Vec<Attribute> {
        names.iter().map(|name| Attribute { name: (*name).to_owned(), kind: Type::F32 }).collect()
    }

    #[test]
    fn declared_names_are_found_however_they_are_written() {
        let all = floats(&["qy", "qz", "qw", "qx", "t_x", "t_y", "t_z", "nx1", "ny1", "nz1", "rot_0"]);
        assert_eq!(declared("q", TensorKind::QuaternionWxyz, &all).unwrap(), [2, 3, 0, 1]);
        assert_eq!(declared("q", TensorKind::QuaternionXyzw, &all).unwrap(), [3, 0, 1, 2]);
        assert_eq!(declared("t", TensorKind::Vector, &all).unwrap(), [4, 5, 6]);
        assert_eq!(declared("n1", TensorKind::Normal, &all).unwrap(), [7, 8, 9]);
        assert_eq!(
            declared("Normal", TensorKind::Normal, &floats(&["NormalZ", "NormalX", "NormalY"])).unwrap(),
            [1, 2, 0]
        );
        let missing = declared("t", TensorKind::Covariance, &all).unwrap_err();
        assert!(missing.ends_with("t_xx, t_xy, t_xz, t_yy, t_yz, t_zz"), "{missing}");
        let mut whole = all;
        whole[5].kind = Type::I32;
        assert!(declared("t", TensorKind::Vector, &whole).unwrap_err().starts_with("t_y is of type int"));
        assert!(declared("", TensorKind::Vector, &whole).is_err());
    }

    #[test]
    fn splats_are_told_by_their_properties() {
        let names = |scales: usize, rest: usize| -> Vec<String> {
            let rot = (0..4).rev().map(|i| format!("rot_{i}"));
            let scale = (0..scales).map(|i| format!("scale_{i}"));
            rot.chain(scale).chain((0..rest).rev().map(|i| format!("f_rest_{i}"))).collect()
        };
        let of = |names: &[String]| splat(&floats(&names.iter().map(String::as_str).collect::<Vec<_>>()));
        for (scales, rest, degree) in [(3, 0, 0), (2, 9, 1), (3, 24, 2), (3, 45, 3)] {
            let (splat, places) = of(&names(scales, rest)).unwrap().unwrap();
            assert_eq!(splat, SplatNumbers { scales, degree });
            assert_eq!(places[..5], [3, 2, 1, 0, 4]);
            assert_eq!(places.len(), 4 + scales + rest);
        }
        assert!(of(&names(3, 44)).unwrap_err().contains("44 properties f_rest_*"));
        assert!(of(&names(1, 0)).unwrap_err().ends_with("no property scale_1"));
        assert!(of(&names(3, 0)[1..]).unwrap_err().ends_with("no property rot_3"));
        let mut gap = names(3, 8);
        gap.push("f_rest_12".to_owned());
        assert!(of(&gap).unwrap_err().ends_with("no property f_rest_8"));
        assert!(of(&names(0, 9)).unwrap().is_none() && of(&[]).unwrap().is_none());
    }
}
