//! Transforms of nodes to the world.

use glam::{DMat3, DMat4, DQuat, DVec3, Vec3};

use super::json::GltfNode;
use super::places::Accessors;
use crate::text::DAMAGED;
use crate::{Error, Result};

/// A determinant this small, beside the lengths of the columns, is that of no map that can be undone.
const SINGULAR: f64 = 1e-9;

/// Transform from a mesh' coordinates to the world's, and back.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct MeshPose {
    matrix: DMat3,
    translation: DVec3,
    inverse: DMat3,
}

impl MeshPose {
    /// The placement by a matrix that can be inverted; `None` inside for one that changes nothing.
    fn from_matrix(world: DMat4) -> Result<Option<Self>, &'static str> {
        let [a, b, c, d] = [world.x_axis, world.y_axis, world.z_axis, world.w_axis];
        let matrix = DMat3::from_cols(a.truncate(), b.truncate(), c.truncate());
        let translation = d.truncate();
        if !matrix.is_finite() || !translation.is_finite() {
            return Err("its matrix has numbers that are not finite");
        }
        if matrix == DMat3::IDENTITY && translation == DVec3::ZERO {
            return Ok(None);
        }
        let lengths = matrix.x_axis.length() * matrix.y_axis.length() * matrix.z_axis.length();
        let inverse = matrix.inverse();
        let is_regular = matrix.determinant().abs() > SINGULAR * lengths && inverse.is_finite();
        if !is_regular {
            return Err("its matrix is singular, so that nothing leads back from the world");
        }
        Ok(Some(Self { matrix, translation, inverse }))
    }

    /// Whether the pose turns left into right.
    pub(super) fn is_mirrored(&self) -> bool {
        self.matrix.determinant() < 0.0
    }

    #[inline]
    pub(super) fn position(&self, local: Vec3) -> DVec3 {
        self.matrix * local.as_dvec3() + self.translation
    }

    /// Position in the mesh's own coordinates of a point that is moved by a vector of the world.
    #[inline]
    pub(super) fn moved(&self, local: Vec3, by: DVec3) -> DVec3 {
        local.as_dvec3() + self.inverse * by
    }

    /// A normal in the world, of the same length.
    #[inline]
    pub(super) fn normal(&self, local: Vec3) -> Vec3 {
        with_length(self.inverse.transpose() * local.as_dvec3(), local)
    }

    /// A normal of the world in the mesh' coordinates, with the length of `old`.
    #[inline]
    pub(super) fn normal_back(&self, world: Vec3, old: Vec3) -> Vec3 {
        with_length(self.matrix.transpose() * world.as_dvec3(), old)
    }

    /// A direction along the surface in the world, of the same length.
    #[inline]
    pub(super) fn tangent(&self, local: Vec3) -> Vec3 {
        with_length(self.matrix * local.as_dvec3(), local)
    }

    /// A direction of the world in the mesh' coordinates, with the length of `old`.
    #[inline]
    pub(super) fn tangent_back(&self, world: Vec3, old: Vec3) -> Vec3 {
        with_length(self.inverse * world.as_dvec3(), old)
    }
}

/// Direction with the length of another vector; that vector itself where the direction has none.
#[inline]
fn with_length(direction: DVec3, other: Vec3) -> Vec3 {
    direction.try_normalize().map_or(other, |d| (d * other.as_dvec3().length()).as_vec3())
}

/// A node's own matrix.
fn own(node: &GltfNode) -> DMat4 {
    if let Some(matrix) = &node.matrix {
        return DMat4::from_cols_array(matrix);
    }
    let translation = node.translation.as_ref().map_or(DVec3::ZERO, |t| DVec3::from_array(**t));
    let scale = node.scale.as_ref().map_or(DVec3::ONE, |s| DVec3::from_array(**s));
    let rotation = node.rotation.as_ref().map_or(DQuat::IDENTITY, |r| DQuat::from_array(**r));
    // One of no length turns nothing; it is none of a length of one, either.
    let length = rotation.length();
    let rotation = if length > 0.0 && length.is_finite() { rotation / length } else { DQuat::IDENTITY };
    DMat4::from_scale_rotation_translation(scale, rotation, translation)
}

impl Accessors<'_> {
    /// Nodes that show a mesh, each with its placement. A skinned mesh is where its joints take it, and stays
    /// in its own coordinates.
    pub(super) fn placements(&self) -> Result<Vec<(usize, Option<MeshPose>)>> {
        let worlds = self.worlds()?;
        let of_node = |(index, node): (usize, &GltfNode)| {
            if node.skin.is_some() {
                return Ok((index, None));
            }
            let wrong = |why| {
                let what = format!("node {index}: {why}");
                self.container.source.malformed(
                    what,
                    "apply the transforms of nodes where the model is made, then export it again",
                )
            };
            Ok((index, MeshPose::from_matrix(worlds[index]).map_err(wrong)?))
        };
        let shown = self.shown()?;
        let nodes = self.document.nodes.iter().enumerate();
        nodes.filter(|(index, node)| shown[*index] && node.mesh.is_some()).map(of_node).collect()
    }

    /// Returns for each node whether it is shown: the nodes of the scenes, where any scene has nodes; else
    /// all, as in a library of meshes. The nodes are trees.
    fn shown(&self) -> Result<Vec<bool>> {
        let (nodes, scenes) = (&self.document.nodes, &self.document.scenes);
        let mut next: Vec<usize> = scenes.iter().flat_map(|scene| &scene.nodes).copied().collect();
        let mut shown = vec![next.is_empty(); nodes.len()];
        while let Some(index) = next.pop() {
            let Some(is_shown) = shown.get_mut(index) else {
                return Err(self.malformed(format_args!("a scene has node {index}, of {}", nodes.len())));
            };
            if !std::mem::replace(is_shown, true) {
                next.extend_from_slice(&nodes[index].children);
            }
        }
        Ok(shown)
    }

    /// The matrices from each node's coordinates to the world's.
    fn worlds(&self) -> Result<Vec<DMat4>> {
        let nodes = &self.document.nodes;
        let mut parents = vec![None; nodes.len()];
        for (index, node) in nodes.iter().enumerate() {
            for child in &node.children {
                let Some(parent) = parents.get_mut(*child) else {
                    return Err(self.malformed(format_args!(
                        "node {index} has node {child} as a child, of {}",
                        nodes.len()
                    )));
                };
                if let Some(other) = parent.replace(index) {
                    let what = format!("node {child} is a child of node {other} and of node {index}");
                    return Err(self.tangled(what));
                }
            }
        }
        let mut worlds = vec![DMat4::IDENTITY; nodes.len()];
        let mut next: Vec<usize> = (0..nodes.len()).filter(|index| parents[*index].is_none()).collect();
        let mut is_known = vec![false; nodes.len()];
        while let Some(index) = next.pop() {
            let parent = parents[index].map_or(DMat4::IDENTITY, |parent| worlds[parent]);
            worlds[index] = parent * own(&nodes[index]);
            is_known[index] = true;
            next.extend_from_slice(&nodes[index].children);
        }
        match is_known.iter().position(|is| !is) {
            Some(index) => Err(self.tangled(format!("node {index} is below itself"))),
            None => Ok(worlds),
        }
    }

    fn tangled(&self, what: String) -> Error {
        self.container.source.malformed(what, DAMAGED)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn what_changes_nothing_is_none() {
        assert_eq!(MeshPose::from_matrix(DMat4::IDENTITY), Ok(None));
        assert!(MeshPose::from_matrix(DMat4::from_scale(DVec3::new(1.0, 0.0, 1.0))).is_err());
        assert!(MeshPose::from_matrix(DMat4::from_translation(DVec3::NAN)).is_err());
        // Small is not singular.
        assert!(MeshPose::from_matrix(DMat4::from_scale(DVec3::splat(1e-30))).is_ok());
    }

    proptest! {
        #[test]
        fn the_way_back_is_the_way_back(
            columns in prop::array::uniform9(-2.0f64..2.0),
            shift in prop::array::uniform3(-1e6f64..1e6),
            p in prop::array::uniform3(-10f32..10.0),
            by in prop::array::uniform3(-1f64..1.0),
        ) {
            let matrix = DMat3::from_cols_array(&columns);
            prop_assume!(matrix.determinant().abs() > 0.1);
            let (p, by) = (Vec3::from(p), DVec3::from(by));
            let world = DMat4::from_translation(DVec3::from(shift)) * DMat4::from_mat3(matrix);
            let placement = MeshPose::from_matrix(world).unwrap().unwrap();
            let moved = placement.moved(p, by);
            let there = matrix * moved + DVec3::from(shift);
            prop_assert!((there - placement.position(p) - by).length() < 1e-8);
            prop_assert_eq!(placement.moved(p, DVec3::ZERO), p.as_dvec3());
            let turned = placement.normal(p);
            prop_assert!((turned.length() - p.length()).abs() <= 1e-5 * p.length());
            prop_assert!((placement.normal_back(turned, p) - p).length() <= 1e-4 * p.length());
            prop_assert!((placement.tangent_back(placement.tangent(p), p) - p).length() <= 1e-4 * p.length());
            // A vector that is perpendicular to the normal stays so.
            let along = p.any_orthogonal_vector();
            let cosine = placement.tangent(along).dot(turned) / (along.length() * p.length()).max(1e-20);
            prop_assert!(cosine.abs() < 1e-3);
        }
    }
}
