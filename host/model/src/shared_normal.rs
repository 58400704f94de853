//! Normals that several vertices share: their new direction where these vertices turn differently.

use glam::{DVec3, Vec3};

/// Least cosine of the angle between a normal at a place and the mean.
const AGREE: f32 = 0.996_194_7;

/// Mean of the turned normals at all places that share a normal; `None` where they disagree. Its length is
/// the mean of theirs.
pub(crate) fn mean(old: Vec3, turned: &[Vec3]) -> Option<Vec3> {
    let same = |new: &Vec3| new.to_array().map(f32::to_bits) == old.to_array().map(f32::to_bits);
    if turned.iter().all(same) {
        return Some(old);
    }
    if let [only] = turned {
        return Some(*only);
    }
    let units = || turned.iter().map(|n| n.as_dvec3().normalize_or_zero());
    let mean = units().sum::<DVec3>().try_normalize()?;
    let agree = units().all(|unit| unit.dot(mean) >= f64::from(AGREE));
    let length = turned.iter().map(|n| n.as_dvec3().length()).sum::<f64>() / turned.len() as f64;
    agree.then(|| (mean * length).as_vec3())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_are_of_those_that_agree() {
        let at = |degrees: f32| Vec3::new(degrees.to_radians().sin(), 0.0, degrees.to_radians().cos());
        let near = mean(Vec3::Z, &[at(10.0), at(14.0)]).unwrap();
        assert!((near - at(12.0)).length() < 1e-6);
        assert!(mean(Vec3::Z, &[at(0.0), at(9.9)]).is_some());
        assert_eq!(mean(Vec3::Z, &[at(0.0), at(10.2)]), None);
        assert_eq!(mean(Vec3::Z, &[Vec3::X, -Vec3::X]), None);
        assert_eq!(mean(Vec3::Z, &[Vec3::Z; 3]), Some(Vec3::Z));
    }
}
