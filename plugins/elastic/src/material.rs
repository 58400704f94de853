//! The energy of a piece of the body by how it is deformed, with its first and second derivatives.
//!
//! Stable neo-Hookean: B. Smith, F. de Goes, T. Kim, *Stable neo-Hookean flesh simulation*, ACM TOG 37, 2018; M.
//! Macklin, M.
//! Müller, *A constraint-based formulation of stable neo-Hookean materials*, MIG 2021. It is defined for pieces that
//! are
//! turned inside out, too. Shear modulus 1; split so that both parts are at rest by themselves: the first is that of a
//! material without transverse contraction, and the second the rest of what resists changes of volume.

use glam::DMat3;

/// The cofactors: what areas become, and the derivative of the determinant.
pub fn cofactors(f: &DMat3) -> DMat3 {
    let [a, b, c] = [f.x_axis, f.y_axis, f.z_axis];
    DMat3::from_cols(b.cross(c), c.cross(a), a.cross(b))
}

/// How the cofactors change.
fn cofactors_change(f: &DMat3, by: &DMat3) -> DMat3 {
    let ([a, b, c], [u, v, w]) = ([f.x_axis, f.y_axis, f.z_axis], [by.x_axis, by.y_axis, by.z_axis]);
    DMat3::from_cols(v.cross(c) + b.cross(w), w.cross(a) + c.cross(u), u.cross(b) + a.cross(v))
}

/// The sum of the products of all entries.
pub fn dot(a: &DMat3, b: &DMat3) -> f64 {
    a.x_axis.dot(b.x_axis) + a.y_axis.dot(b.y_axis) + a.z_axis.dot(b.z_axis)
}

/// Of shape: the energy and the stress.
pub fn shape(f: &DMat3) -> (f64, DMat3) {
    let cofactors = cofactors(f);
    let over = f.x_axis.dot(cofactors.x_axis) - 1.0;
    let energy = 0.5 * (dot(f, f) - 3.0) - over + 0.5 * over * over;
    (energy, *f + (over - 1.0) * cofactors)
}

/// Of shape: how the stress changes.
pub fn shape_change(f: &DMat3, by: &DMat3) -> DMat3 {
    let cofactors = cofactors(f);
    let over = f.x_axis.dot(cofactors.x_axis) - 1.0;
    *by + dot(&cofactors, by) * cofactors + (over - 1.0) * cofactors_change(f, by)
}

/// Of volume, for a modulus of 1.
pub fn volume(f: &DMat3) -> (f64, DMat3) {
    let cofactors = cofactors(f);
    let over = f.x_axis.dot(cofactors.x_axis) - 1.0;
    (0.5 * over * over, over * cofactors)
}

/// Of volume: how the stress changes.
pub fn volume_change(f: &DMat3, by: &DMat3) -> DMat3 {
    let cofactors = cofactors(f);
    let over = f.x_axis.dot(cofactors.x_axis) - 1.0;
    dot(&cofactors, by) * cofactors + over * cofactors_change(f, by)
}
