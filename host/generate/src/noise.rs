//! Deterministic value noise with its exact gradient.

use glam::DVec3;

/// Noise in [-1, 1] with unit wavelength, and its gradient.
pub(super) fn noise(p: DVec3) -> (f64, DVec3) {
    let cell = p.floor();
    let f = p - cell;
    // Quintic fade: its second derivative vanishes at the lattice, so normals show no lattice planes.
    let fade = f * f * f * (f * (f * 6.0 - 15.0) + 10.0);
    let slope = f * f * (f * (f * 30.0 - 60.0) + 30.0);
    // The lattice's hash starts from a sum over the axes, whose terms the eight corners share.
    let terms = |x: f64, factor: u64| {
        let first = (x as i64 as u64).wrapping_mul(factor);
        [first, first.wrapping_add(factor)]
    };
    let xs = terms(cell.x, 0x9E37_79B9_7F4A_7C15);
    let ys = terms(cell.y, 0xC2B2_AE3D_27D4_EB4F);
    let zs = terms(cell.z, 0x1656_67B1_9E37_79F9);
    let corner = |i: usize, j: usize, k: usize| value(xs[i].wrapping_add(ys[j]).wrapping_add(zs[k]));

    let along_x = |j, k| {
        let (a, b) = (corner(0, j, k), corner(1, j, k));
        (a + (b - a) * fade.x, (b - a) * slope.x)
    };
    let along_y = |k| {
        let ((a, ax), (b, bx)) = (along_x(0, k), along_x(1, k));
        (a + (b - a) * fade.y, ax + (bx - ax) * fade.y, (b - a) * slope.y)
    };
    let ((a, ax, ay), (b, bx, by)) = (along_y(0), along_y(1));
    let gradient = DVec3::new(ax + (bx - ax) * fade.z, ay + (by - ay) * fade.z, (b - a) * slope.z);
    (a + (b - a) * fade.z, gradient)
}

/// The pseudo-random value of a lattice point, in [-1, 1].
fn value(mut hash: u64) -> f64 {
    hash = (hash ^ (hash >> 32)).wrapping_mul(0xD6E8_FEB8_6659_FD93);
    hash ^= hash >> 32;
    f64::from(hash as u32 as i32) * (1.0 / 2_147_483_648.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gradient_is_the_derivative() {
        let h = 1e-5;
        for i in 0..200 {
            let t = f64::from(i);
            let p = DVec3::new(t * 0.37 - 20.0, t * 0.211, -t * 0.173);
            let (value, gradient) = noise(p);
            assert!(value.abs() <= 1.0);
            for axis in DVec3::AXES {
                let difference = (noise(p + axis * h).0 - noise(p - axis * h).0) / (2.0 * h);
                assert!((difference - gradient.dot(axis)).abs() < 1e-5, "{p}");
            }
        }
    }
}
