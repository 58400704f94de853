//! Energy of a piece of the body as a function of its deformation gradient, with the first and second
//! derivatives.
//!
//! Stable neo-Hookean: B. Smith, F. de Goes, T. Kim, *Stable neo-Hookean flesh simulation*, ACM TOG 37, 2018;
//! M. Macklin, M. Müller, *A constraint-based formulation of stable neo-Hookean materials*, MIG 2021. It is
//! defined for pieces that are turned inside out, too. Shear modulus 1; split so that both parts are at rest
//! by themselves: the first is that of a material without transverse contraction, and the second the rest of
//! what resists changes of volume.

use crate::cell::{Eight, Matrices, cross, dot as dot_at};
use glam::DMat3;
use std::array::from_fn;

/// Cofactors: the map of areas, and the derivative of the determinant.
#[inline(always)]
pub fn cofactors(f: &DMat3) -> DMat3 {
    let [a, b, c] = [f.x_axis, f.y_axis, f.z_axis];
    DMat3::from_cols(b.cross(c), c.cross(a), a.cross(b))
}

/// The change of the cofactors.
#[inline(always)]
fn cofactors_change(f: &DMat3, by: &DMat3) -> DMat3 {
    let ([a, b, c], [u, v, w]) = ([f.x_axis, f.y_axis, f.z_axis], [by.x_axis, by.y_axis, by.z_axis]);
    DMat3::from_cols(v.cross(c) + b.cross(w), w.cross(a) + c.cross(u), u.cross(b) + a.cross(v))
}

/// The sum of the products of all entries.
#[inline(always)]
fn dot(a: &DMat3, b: &DMat3) -> f64 {
    a.x_axis.dot(b.x_axis) + a.y_axis.dot(b.y_axis) + a.z_axis.dot(b.z_axis)
}

#[inline(always)]
fn cofactors_at([a, b, c]: &Matrices) -> Matrices {
    [cross(*b, *c), cross(*c, *a), cross(*a, *b)]
}

/// Energies and stresses by changes of shape, at eight points.
#[inline(always)]
pub fn shape(f: &Matrices) -> (Eight, Matrices) {
    let cofactors = cofactors_at(f);
    let (one, half) = (Eight::all(1.0), Eight::all(0.5));
    let over = dot_at(f[0], cofactors[0]) - one;
    let squares = dot_at(f[0], f[0]) + dot_at(f[1], f[1]) + dot_at(f[2], f[2]);
    let energy = half * (squares - Eight::all(3.0)) - over + half * over * over;
    let by = over - one;
    (energy, from_fn(|c| from_fn(|r| f[c][r] + by * cofactors[c][r])))
}

/// Change of the stresses of shape, at eight points, if the material is taken for stiffer by a part of its
/// shear modulus.
#[inline(always)]
pub fn shape_change(f: &Matrices, by: &Matrices, stiffer: f64) -> Matrices {
    let cofactors = cofactors_at(f);
    let over = dot_at(f[0], cofactors[0]) - Eight::all(2.0);
    let wider = dot_at(cofactors[0], by[0]) + dot_at(cofactors[1], by[1]) + dot_at(cofactors[2], by[2]);
    let ([a, b, c], [u, v, w]) = (*f, *by);
    let pairs = [(cross(v, c), cross(b, w)), (cross(w, a), cross(c, u)), (cross(u, b), cross(a, v))];
    let own = Eight::all(1.0 + stiffer);
    from_fn(|k| {
        from_fn(|r| own * by[k][r] + wider * cofactors[k][r] + over * (pairs[k].0[r] + pairs[k].1[r]))
    })
}

/// The energy of a change of volume for a modulus of 1, and the stress.
#[inline(always)]
pub fn volume(f: &DMat3) -> (f64, DMat3) {
    let cofactors = cofactors(f);
    let over = f.x_axis.dot(cofactors.x_axis) - 1.0;
    (0.5 * over * over, over * cofactors)
}

/// The change of that stress with the deformation gradient.
#[inline(always)]
pub fn volume_change(f: &DMat3, by: &DMat3) -> DMat3 {
    let cofactors = cofactors(f);
    let over = f.x_axis.dot(cofactors.x_axis) - 1.0;
    dot(&cofactors, by) * cofactors + over * cofactors_change(f, by)
}
