//! The plain shapes: a sphere and a plane with waves of analytic height.

use glam::{DVec2, DVec3};

use super::SurfaceVertex;
use super::curve::Curve;
use super::layout::Patch;
use super::sweep::{Axis, Raised, Relief, Site, Sweep};

const CLAY: [u8; 3] = [196, 168, 140];

/// A sphere of radius 1 about the origin, with waves of two wavelengths.
pub(super) fn bumpy_sphere() -> Vec<Box<dyn Patch>> {
    vec![Box::new(Sweep { axis: Axis::Straight, profile: half_circle(), relief: SphereWaves })]
}

/// The half circle from pole to pole, as a spline that leaves the circle by less than 1e-6.
fn half_circle() -> Curve {
    const SEGMENTS: i32 = 64;
    let step = std::f64::consts::PI / f64::from(SEGMENTS);
    // Control points lie slightly outside, such that the curve passes through the circle at its knots.
    let radius = 3.0 / (2.0 + step.cos());
    let point = |i| {
        let angle = step * f64::from(i);
        DVec2::new(angle.sin(), -angle.cos()) * radius
    };
    Curve::new((-1..=SEGMENTS + 1).map(point).collect())
}

struct SphereWaves;

impl Relief for SphereWaves {
    fn at(&self, site: &Site) -> (Raised, [u8; 3]) {
        let mut raised = Raised::default();
        for (wave, amplitude) in [(5.0, 0.04), (23.0, 0.004)] {
            let (sin, cos) = ((site.position * wave).map(f64::sin), (site.position * wave).map(f64::cos));
            let gradient =
                DVec3::new(cos.x * sin.y * sin.z, sin.x * cos.y * sin.z, sin.x * sin.y * cos.z) * wave;
            raised.add_field(amplitude * sin.element_product(), gradient * amplitude, site);
        }
        (raised, CLAY)
    }
}

/// A square of side 2 in the plane of x and z, facing up, with waves of two wavelengths.
pub(super) struct BumpyPlane;

impl Patch for BumpyPlane {
    fn length(&self) -> f64 {
        2.0
    }

    fn width(&self, _distance: f64) -> f64 {
        2.0
    }

    fn is_wrapped(&self) -> bool {
        false
    }

    fn row(&self, distance: f64, columns: u32, vertices: &mut Vec<SurfaceVertex>) {
        for column in 0..columns {
            let z = distance - 1.0;
            let x = 2.0 * f64::from(column) / f64::from((columns - 1).max(1)) - 1.0;
            let (mut y, mut by_x, mut by_z) = (0.0, 0.0, 0.0);
            for (wave, amplitude) in [(4.0, 0.08), (31.0, 0.004)] {
                let ((sx, cx), (sz, cz)) = ((wave * x).sin_cos(), (wave * z).sin_cos());
                y += amplitude * sx * sz;
                by_x += amplitude * wave * cx * sz;
                by_z += amplitude * wave * sx * cz;
            }
            vertices.push(SurfaceVertex {
                position: DVec3::new(x, y, z),
                normal: DVec3::new(-by_x, 1.0, -by_z).normalize_or(DVec3::Y).as_vec3(),
                color: CLAY,
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::sweep::worst_normal;
    use super::*;

    #[test]
    fn normals_are_those_of_the_surface() {
        let sphere = Sweep { axis: Axis::Straight, profile: half_circle(), relief: SphereWaves };
        assert!(worst_normal(&sphere) < 1e-5);
    }

    #[test]
    fn profile_is_a_circle() {
        let circle = half_circle();
        for i in 0..=1000 {
            let point = circle.at(circle.length() * f64::from(i) / 1000.0);
            assert!((point.position.length() - 1.0).abs() < 1e-6);
        }
    }
}
