//! The vertices of a model by their numbers, as its triangles ask for them in any order: in a temporary file,
//! so that memory does not grow with the model.

use std::path::Path;

use bytemuck::{Pod, Zeroable};
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use simod_model::bounds::Bounds;
use simod_model::mapped::MapMut;
use simod_model::scratch::Scratch;
use simod_model::{Model, Progress, Result, SMALL_CHUNK, Vertices, for_faces, in_step};

use super::paint::Painted;
use super::view::UpAxis;
use super::{Renderer, Spacing, SurfaceDisc};

/// Bytes of vertices that are held in memory; more than that are in a file.
const HELD: u64 = 64 << 20;

/// Advice where the disk has no room.
const ADVICE: &str = "draw the vertices alone, with --points";

/// The cosine of an angle beyond which two directions are on both sides of a crease.
const CREASE: f32 = 0.7;

/// Vertex as it is kept for drawing.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct VertexRecord {
    /// Position from the middle of the bounds; not finite where the vertex has none.
    position: [f32; 3],
    /// Normal of the model; or else the sum of the normals of the triangles around the vertex, by their
    /// areas.
    normal: [f32; 3],
    color: [u8; 3],
    /// 1 if a triangle has the vertex.
    used: u8,
}

/// The records of all vertices, in memory or in a mapped file.
enum VertexRecords {
    Held(Vec<VertexRecord>),
    Mapped(MapMut),
}

impl VertexRecords {
    /// Reads the vertices of the first of several models that are read in step, as of [`DrawnMesh::new`], by
    /// their places from an origin.
    fn read(
        models: &[&dyn Model],
        (origin, spacing): (DVec3, &mut Spacing),
        paint: Painted<'_>,
        folder: &Path,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let info = models[0].info();
        let (width, mut at) = (size_of::<VertexRecord>() as u64, 0);
        let mut held = Vec::new();
        let is_held = info.vertices * width <= HELD;
        let scratch = if is_held { None } else { Some(Scratch::new(folder, ADVICE)?) };
        progress.begin("drawing", info.vertex_bytes);
        in_step(models, paint.map_or(0, |(attributes, _)| attributes), progress, |parts| {
            let Vertices { positions, normals, .. } = parts[0];
            spacing.add(positions.iter().copied());
            let record = |(i, p): (usize, &DVec3)| VertexRecord {
                position: (*p - origin).as_vec3().to_array(),
                normal: normals.get(i).copied().unwrap_or_default().to_array(),
                color: paint.map_or([0; 3], |(_, paint)| paint(parts, i)),
                used: 0,
            };
            held.extend(positions.iter().enumerate().map(record));
            if let Some(scratch) = &scratch {
                scratch.write_at(bytemuck::cast_slice(&held), at)?;
                at += held.len() as u64 * width;
                held.clear();
            }
            Ok(())
        })?;
        Ok(match scratch {
            Some(scratch) => Self::Mapped(scratch.map_mut()?),
            None => Self::Held(held),
        })
    }

    fn all(&self) -> &[VertexRecord] {
        match self {
            Self::Held(all) => all,
            // The map begins with a page, and is of whole records.
            Self::Mapped(map) => bytemuck::cast_slice(map),
        }
    }

    fn all_mut(&mut self) -> &mut [VertexRecord] {
        match self {
            Self::Held(all) => all,
            Self::Mapped(map) => bytemuck::cast_slice_mut(map),
        }
    }
}

/// Whether points that no triangle has are drawn: they are, where they are a tenth of all points, or more.
/// Fewer are strays, which as discs on a surface would be flaws.
pub(super) fn are_many(alone: usize, all: usize) -> bool {
    alone > 0 && alone >= all.div_ceil(10)
}

/// A model's vertices, to be drawn with its triangles; and those that no triangle has as discs, where these
/// are many.
pub(super) struct DrawnMesh<'a> {
    model: &'a dyn Model,
    records: VertexRecords,
    origin: DVec3,
    spacing: Spacing,
    /// Normals were found by the triangles.
    derived: bool,
    /// Whether there are many vertices that no triangle has.
    with_points: bool,
}

impl<'a> DrawnMesh<'a> {
    /// Keeps the vertices of the first of several models that are read in step, as `paint` has them: of so
    /// many of the first attributes. The file, if there is one, is made in `folder`: 28 bytes for each
    /// vertex.
    ///
    /// Memory: 64 MiB at most, and a chunk.
    pub fn new(
        models: &[&'a dyn Model],
        bounds: &Bounds,
        paint: Painted<'_>,
        folder: &Path,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let middle = 0.5 * (bounds.min + bounds.max);
        let origin = if middle.is_finite() { middle } else { DVec3::ZERO };
        let mut spacing = Spacing::new([bounds.min, bounds.max]);
        let records = VertexRecords::read(models, (origin, &mut spacing), paint, folder, progress)?;
        let mut this = Self {
            model: models[0],
            records,
            origin,
            spacing,
            derived: !models[0].info().has_normals,
            with_points: false,
        };
        this.go_round(progress)?;
        let all = this.records.all();
        let is_alone = |record: &&VertexRecord| record.used == 0 && Vec3::from(record.position).is_finite();
        this.with_points = are_many(all.par_iter().filter(is_alone).count(), all.len());
        Ok(this)
    }

    /// Finds out which vertices triangles have, and their normals where the model has none.
    fn go_round(&mut self, progress: &dyn Progress) -> Result<()> {
        progress.begin("drawing", self.model.info().face_bytes);
        let (records, derived) = (self.records.all_mut(), self.derived);
        for_faces(self.model, |chunk| {
            progress.check()?;
            for triangle in &chunk.triangles {
                let corners = triangle.map(|i| records.get(i as usize).map(|r| Vec3::from(r.position)));
                let [Some(a), Some(b), Some(c)] = corners else { continue };
                if !(a.is_finite() && b.is_finite() && c.is_finite()) {
                    continue;
                }
                let normal = if derived { (b - a).cross(c - a) } else { Vec3::ZERO };
                for i in triangle {
                    let record = &mut records[*i as usize];
                    record.used = 1;
                    if derived {
                        record.normal = (Vec3::from(record.normal) + normal).to_array();
                    }
                }
            }
            progress.advance(chunk.bytes);
            Ok(())
        })
    }

    /// Draws all into a picture.
    pub fn draw(&self, renderer: &mut Renderer, up: UpAxis, progress: &dyn Progress) -> Result<()> {
        self.pass(up, progress, |triangles, points| {
            renderer.depth_of_triangles(triangles);
            renderer.depth(points);
        })?;
        self.pass(up, progress, |triangles, points| {
            renderer.blend_triangles(triangles);
            renderer.blend(points);
        })
    }

    fn pass(
        &self,
        up: UpAxis,
        progress: &dyn Progress,
        mut draw: impl FnMut(&[[SurfaceDisc; 3]], &[SurfaceDisc]),
    ) -> Result<()> {
        let (records, mut drawn) = (self.records.all(), Vec::new());
        progress.begin("drawing", self.model.info().face_bytes);
        for_faces(self.model, |chunk| {
            progress.check()?;
            // In the same memory each time: to get it anew takes the system longer than to fill it.
            chunk.triangles.par_iter().map(|t| self.triangle(records, *t, up)).collect_into_vec(&mut drawn);
            draw(&drawn, &[]);
            progress.advance(chunk.bytes);
            Ok(())
        })?;
        for some in records.chunks(SMALL_CHUNK).take_while(|_| self.with_points) {
            progress.check()?;
            let alone = some.iter().filter(|record| record.used == 0);
            let points: Vec<SurfaceDisc> = alone
                .map(|record| {
                    let radius = self.spacing.radius_at(self.place(record));
                    SurfaceDisc { radius, ..self.point(record, up) }
                })
                .collect();
            if !points.is_empty() {
                draw(&[], &points);
            }
        }
        Ok(())
    }

    fn place(&self, record: &VertexRecord) -> DVec3 {
        self.origin + Vec3::from(record.position).as_dvec3()
    }

    fn point(&self, record: &VertexRecord, up: UpAxis) -> SurfaceDisc {
        SurfaceDisc {
            position: up.turned(self.place(record)),
            normal: up.turned(Vec3::from(record.normal).as_dvec3()).as_vec3(),
            color: record.color,
            radius: 0.0,
        }
    }

    fn triangle(&self, records: &[VertexRecord], triangle: [u32; 3], up: UpAxis) -> [SurfaceDisc; 3] {
        // An index without a vertex gets a corner without a finite position.
        let nowhere = VertexRecord { position: [f32::NAN; 3], ..VertexRecord::zeroed() };
        let mut corners = triangle.map(|i| self.point(records.get(i as usize).unwrap_or(&nowhere), up));
        if self.derived {
            at_creases(&mut corners);
        }
        corners
    }
}

/// Gives corners at which the surface is creased the normal of their triangle.
fn at_creases(corners: &mut [SurfaceDisc; 3]) {
    let [a, b, c] = corners.map(|corner| corner.position);
    let Some(face) = (b - a).cross(c - a).as_vec3().try_normalize() else { return };
    for corner in corners {
        if corner.normal.normalize_or_zero().dot(face) < CREASE {
            corner.normal = face;
        }
    }
}
