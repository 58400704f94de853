//! Gaussian splats as flat ellipses across their shortest axis, as pictures and windows draw them (B. Kerbl,
//! G. Kopanas, T. Leimkühler, G. Drettakis, *3D Gaussian Splatting for Real-Time Radiance Field Rendering*,
//! 2023).

use glam::{DQuat, DVec3, Mat3, Vec3};
use simod_model::Attribute;

use crate::sampling::LEAST_OPACITY;

/// Standard deviations of a splat that are drawn.
const EXTENT: f64 = 2.0;

/// The shorter axis is at least so long, as a part of the longer one: thinner ones would vanish.
const THINNEST: f64 = 1e-3;

/// Places of a splat's rotation, scales and opacity in the model's list of attributes.
#[derive(Debug, Clone, PartialEq)]
pub struct Ellipses {
    /// Real part first.
    rotation: [usize; 4],
    /// Logarithms; those of discs are two.
    scales: Vec<usize>,
    /// The place of the opacity, before the sigmoid.
    opacity: Option<usize>,
}

/// Half axes, the longer one first, and the normal, which is of unit length.
pub type Ellipse = ([DVec3; 2], DVec3);

fn place(name: &str, attributes: &[Attribute]) -> Option<usize> {
    attributes.iter().position(|a| a.name == name)
}

impl Ellipses {
    /// The ellipses of splats; `None` where the points are none.
    pub fn from_attributes(attributes: &[Attribute]) -> Option<Self> {
        let of = |name: &str, i: usize| place(&format!("{name}_{i}"), attributes);
        let rotation = [of("rot", 0)?, of("rot", 1)?, of("rot", 2)?, of("rot", 3)?];
        let scales = [Some(of("scale", 0)?), Some(of("scale", 1)?), of("scale", 2)].into_iter().flatten();
        Some(Self { rotation, scales: scales.collect(), opacity: place("opacity", attributes) })
    }

    /// Number of attributes, from the first on, that have to be read.
    pub fn count(&self) -> usize {
        let all = self.rotation.iter().chain(&self.scales).chain(&self.opacity);
        all.max().map_or(0, |last| last + 1)
    }

    /// Ellipse of a splat, its half axes and its normal, from a function that gives the attribute at each
    /// place; `None` for a splat that is too transparent or has no extent, or whose numbers are not finite.
    pub fn ellipse(&self, attribute: impl Fn(usize) -> f64) -> Option<Ellipse> {
        let opacity = self.opacity.map_or(1.0, |place| 1.0 / (1.0 + (-attribute(place)).exp()));
        let [w, x, y, z] = self.rotation.map(&attribute);
        let q = DQuat::from_xyzw(x, y, z, w);
        let q = q * (1.0 / q.length());
        let frame = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| q * axis);
        let scale = |i: usize| self.scales.get(i).map_or(0.0, |place| EXTENT * attribute(*place).exp());
        let mut axes = [0, 1, 2].map(|i| (scale(i), frame[i]));
        axes.sort_by(|a, b| b.0.total_cmp(&a.0));
        let [(long, a), (short, b), (_, normal)] = axes;
        let axes = [a * long, b * short.max(THINNEST * long)];
        let is_seen = opacity >= LEAST_OPACITY && long > 0.0;
        (is_seen && axes.iter().all(|axis| axis.is_finite()) && normal.is_finite()).then_some((axes, normal))
    }
}

/// The half axes of an ellipse's image under a linear map, the longer one first.
///
/// The images of half axes are conjugate half diameters; those that are at right angles among these come of
/// the angle 2t with tan 2t = 2 a·b / (a² - b²) (Rytz).
pub fn image([long, short]: [Vec3; 2], map: &Mat3) -> [Vec3; 2] {
    let (a, b) = (*map * long, *map * short);
    let t = 0.5 * (2.0 * a.dot(b)).atan2(a.length_squared() - b.length_squared());
    let (sin, cos) = t.sin_cos();
    [a * cos + b * sin, b * cos - a * sin]
}

#[cfg(test)]
mod tests {
    use super::*;
    use simod_model::Type;

    #[test]
    fn splats_are_ellipses_across_their_shortest_axis() {
        let names = ["f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"];
        let names = names.into_iter().chain(["rot_0", "rot_1", "rot_2", "rot_3"]);
        let all: Vec<Attribute> =
            names.map(|name| Attribute { name: name.to_owned(), kind: Type::F32 }).collect();
        let ellipses = Ellipses::from_attributes(&all).unwrap();
        assert_eq!(ellipses.count(), 11);
        let half = 0.5f64.sqrt();
        // A quarter turn about z: the first axis goes to y.
        let mut numbers = [0.0, 0.0, 0.0, 2.0, 0.3f64.ln(), 0.01f64.ln(), 0.1f64.ln(), half, 0.0, 0.0, half];
        let ([long, short], normal) = ellipses.ellipse(|place| numbers[place]).unwrap();
        assert!(long.distance(DVec3::Y * 0.6) < 1e-9 && short.distance(DVec3::Z * 0.2) < 1e-9);
        assert!(normal.abs().distance(DVec3::X) < 1e-9);
        for (place, bad) in [(3, -5.0), (4, f64::INFINITY), (7, f64::NAN)] {
            let good = std::mem::replace(&mut numbers[place], bad);
            assert!(ellipses.ellipse(|place| numbers[place]).is_none(), "{place}");
            numbers[place] = good;
        }
        assert!(Ellipses::from_attributes(&all[..8]).is_none());
    }

    #[test]
    fn images_of_ellipses_have_the_same_points() {
        let map =
            Mat3::from_cols(Vec3::new(0.3, 1.0, 0.2), Vec3::new(-2.0, 0.4, 0.1), Vec3::new(0.0, 0.5, 1.0));
        let axes = [Vec3::new(0.0, 2.0, 0.0), Vec3::new(1.5, 0.0, 0.0)];
        let [long, short] = image(axes, &map);
        assert!(long.dot(short).abs() < 1e-5 && long.length() > short.length());
        for i in 0..12 {
            let (sin, cos) = (0.5 * i as f32).sin_cos();
            let p = map * (axes[0] * cos + axes[1] * sin);
            let [x, y] = [long, short].map(|axis| p.dot(axis) / axis.length_squared());
            assert!((x * x + y * y - 1.0).abs() < 1e-5 && p.distance(long * x + short * y) < 1e-5);
        }
        assert_eq!(image(axes, &Mat3::IDENTITY), axes);
        assert_eq!(image([Vec3::ZERO; 2], &map), [Vec3::ZERO; 2]);
    }
}
