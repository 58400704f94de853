//! Binary STL: a facet for each triangle, whose corners are looked up among all vertices, which wait in a
//! temporary file of 12 bytes for each.

use std::sync::{Mutex, OnceLock, PoisonError};

use glam::Vec3;

use crate::bounds::Bounds;
use crate::form::{ConversionInput, Form, Rounding, WrittenRows, attribute_loss};
use crate::mapped::{Map, looked_at};
use crate::polygons::Polygons;
use crate::scratch::Scratch;
use crate::{Error, Result, Scalar, Summary};

/// Bytes of a facet.
const FACET: usize = 50;

pub(super) struct StlForm {
    triangles: u64,
    vertices: Mutex<Option<Scratch>>,
    map: OnceLock<Map>,
}

impl StlForm {
    pub(super) fn new(content: &ConversionInput<'_>, losses: &mut Vec<String>) -> Result<Self> {
        let info = content.info();
        if content.faces.triangles == 0 {
            return Err(Error::argument(
                format!("{} has no faces, which STL consists of", content.model.path().display()),
                "write another format, as PLY",
            ));
        }
        content.too_many("triangles", content.faces.triangles, u64::from(u32::MAX))?;
        if content.has_normals {
            losses.push("the normals of the vertices".to_owned());
        }
        losses.extend(info.attributes.iter().map(|a| attribute_loss(&a.name, a.kind)));
        if let Some(crs) = &info.crs {
            losses.push(format!("the coordinate reference system {crs}"));
        }
        // Soup is soup again.
        if info.vertices != 3 * content.faces.triangles {
            losses.push("which corners are one vertex".to_owned());
        }
        let file = Scratch::new(&content.folder, "write another format, as PLY")?;
        Ok(Self {
            triangles: content.faces.triangles,
            vertices: Mutex::new(Some(file)),
            map: OnceLock::new(),
        })
    }

    /// The positions of all vertices, 12 bytes each.
    fn all(&self) -> Result<&[u8]> {
        if self.map.get().is_none() {
            let file = self.vertices.lock().unwrap_or_else(PoisonError::into_inner).take();
            if let Some(file) = file {
                let _ = self.map.set(file.map()?);
            }
        }
        Ok(self.map.get().map_or(&[], |map| map))
    }
}

/// The position of a vertex among those of all.
fn position(all: &[u8], vertex: u32) -> Vec3 {
    let at = 12 * vertex as usize;
    let Some(([x, y, z], [])) = all.get(at..at + 12).map(<[u8]>::as_chunks) else { return Vec3::NAN };
    Vec3::from([*x, *y, *z].map(f32::from_le_bytes))
}

impl Form for StlForm {
    fn attributes(&self) -> usize {
        0
    }

    fn head(&self) -> Result<Vec<u8>> {
        let mut head = vec![0; 84];
        head[..5].copy_from_slice(b"SIMOD");
        head[80..].copy_from_slice(&(self.triangles as u32).to_le_bytes());
        Ok(head)
    }

    fn vertices(&self, rows: &WrittenRows<'_>, to: &mut Vec<u8>, _summary: &mut Summary) -> Result<()> {
        to.clear();
        let single: Vec<Vec3> = rows.positions.iter().map(|p| p.as_vec3()).collect();
        if let Some(i) = (0..single.len()).find(|i| rows.positions[*i].is_finite() && !single[*i].is_finite())
        {
            return Err(rows.unfit(i, "too far away for the type float"));
        }
        let bytes: Vec<u8> = single.iter().flat_map(|p| p.to_array()).flat_map(f32::to_le_bytes).collect();
        match &*self.vertices.lock().unwrap_or_else(PoisonError::into_inner) {
            Some(file) => file.write_at(&bytes, 12 * rows.first),
            None => Ok(()),
        }
    }

    fn has_faces(&self) -> bool {
        true
    }

    fn needs_vertices(&self) -> bool {
        true
    }

    fn faces(&self, faces: &Polygons, to: &mut Vec<u8>) -> Result<()> {
        let all = self.all()?;
        to.clear();
        to.resize(FACET * faces.len(), 0);
        for (facet, corners) in to.chunks_exact_mut(FACET).zip(faces.iter()) {
            let [a, b, c] =
                [0, 1, 2].map(|i| corners.get(i).map_or(Vec3::NAN, |corner| position(all, *corner)));
            let (u, v) = ((b - a).as_dvec3(), (c - a).as_dvec3());
            let normal =
                u.try_normalize().zip(v.try_normalize()).and_then(|(u, v)| u.cross(v).try_normalize());
            let normal = normal.unwrap_or_default().as_vec3();
            let numbers = [normal, a, b, c].map(|v| v.to_array().map(f32::to_le_bytes));
            facet[..48].copy_from_slice(numbers.as_flattened().as_flattened());
        }
        looked_at(3 * 12 * faces.len());
        Ok(())
    }

    fn rounding(&self, content: &ConversionInput<'_>) -> Result<Option<Rounding>> {
        if content.info().position_type == Scalar::F32 {
            return Ok(None);
        }
        // Distance of the largest coordinate in single precision to the next number; coordinates beyond
        // single precision are an error where they are written.
        let step = |bounds: &Bounds| {
            let largest = bounds.min.abs().max(bounds.max.abs()).max_element() as f32;
            let largest = largest.min(f32::MAX.next_down());
            f64::from(largest.next_up()) - f64::from(largest)
        };
        Rounding::of_model(content.model, |p| p.as_vec3().as_dvec3() == p, step)
    }

    fn bytes(&self) -> u64 {
        84 + FACET as u64 * self.triangles
    }
}
