//! The plain shapes: a sphere and planes with waves or bumps of analytic height.

use std::f64::consts::PI;

use glam::{DVec2, DVec3};

use super::SurfaceVertex;
use super::curve::BSpline;
use super::layout::SurfacePatch;
use super::sweep::{Raised, Relief, Site, Sweep, SweepAxis};

pub(super) const CLAY: [u8; 3] = [196, 168, 140];

/// A sphere of radius 1 about the origin, with waves of two wavelengths.
pub(super) fn bumpy_sphere() -> Box<dyn SurfacePatch> {
    Box::new(Sweep { axis: SweepAxis::Straight, profile: half_circle(), relief: SphereWaves })
}

/// The half circle from pole to pole, as a spline that leaves the circle by less than 1e-6.
fn half_circle() -> BSpline {
    const SEGMENTS: i32 = 64;
    let step = PI / f64::from(SEGMENTS);
    // Control points lie slightly outside, such that the curve passes through the circle at its knots.
    let radius = 3.0 / (2.0 + step.cos());
    let point = |i| {
        let angle = step * f64::from(i);
        DVec2::new(angle.sin(), -angle.cos()) * radius
    };
    BSpline::new((-1..=SEGMENTS + 1).map(point).collect())
}

struct SphereWaves;

impl Relief for SphereWaves {
    fn raise(&self, site: &Site) -> (Raised, [u8; 3]) {
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

/// A square with waves of two wavelengths.
pub(super) fn wavy_plane() -> Box<dyn SurfacePatch> {
    let waves = |x: f64, z: f64| {
        let (mut y, mut by_x, mut by_z) = (0.0, 0.0, 0.0);
        for (wave, amplitude) in [(4.0, 0.08), (31.0, 0.004)] {
            let ((sx, cx), (sz, cz)) = ((wave * x).sin_cos(), (wave * z).sin_cos());
            y += amplitude * sx * sz;
            by_x += amplitude * wave * cx * sz;
            by_z += amplitude * wave * sx * cz;
        }
        [y, by_x, by_z]
    };
    Box::new(PlaneShape { relief: waves })
}

/// A square with bumps in rows and columns, flat between them.
pub(super) fn bumpy_plane() -> Box<dyn SurfacePatch> {
    const WAVE: f64 = 10.0 * PI;
    const HEIGHT: f64 = 0.06;
    // sin² and its derivative, of the distance from the border.
    let bump = |x: f64| (0.5 - 0.5 * (WAVE * (x + 1.0)).cos(), 0.5 * WAVE * (WAVE * (x + 1.0)).sin());
    let bumps = move |x: f64, z: f64| {
        let ((bx, by_x), (bz, by_z)) = (bump(x), bump(z));
        [bx * bz, by_x * bz, bx * by_z].map(|value| HEIGHT * value)
    };
    Box::new(PlaneShape { relief: bumps })
}

/// A square of side 2 in the plane of x and z, facing up. The relief gives the height, and its derivatives by
/// x and z.
struct PlaneShape<R> {
    relief: R,
}

impl<R: Fn(f64, f64) -> [f64; 3] + Send + Sync> SurfacePatch for PlaneShape<R> {
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
            let [y, by_x, by_z] = (self.relief)(x, z);
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
        let sphere = Sweep { axis: SweepAxis::Straight, profile: half_circle(), relief: SphereWaves };
        assert!(worst_normal(&sphere) < 1e-5);
    }

    #[test]
    fn profile_is_a_circle() {
        let circle = half_circle();
        for i in 0..=1000 {
            let point = circle.point(circle.length() * f64::from(i) / 1000.0);
            assert!((point.position.length() - 1.0).abs() < 1e-6);
        }
    }
}
