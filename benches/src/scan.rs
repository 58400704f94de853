//! Models that look like scans to a sampler: a coarse mesh, refined to any number of vertices on curved
//! triangles (A. Vlachos et al., *Curved PN triangles*, I3D 2001), with fine relief along its normals.

use std::io::{BufWriter, Write};
use std::path::Path;

use glam::DVec3;
use noise::{Fbm, MultiFractal, NoiseFn, Perlin};
use rayon::prelude::*;
use simod_generate::{MIN_VERTICES, Shape, Surface};
use simod_model::bounds::Bounds;
use simod_model::output::OutputFile;

use crate::process::Result;

/// Bytes of a vertex in the files that [`Mesh::write`] writes: position and normal, in floats.
pub const VERTEX_BYTES: usize = 24;

/// Vertices that [`Mesh::amphora`] leaves to be made by refining, for each that it has.
const REFINEMENT: u64 = 16;

/// The relief's octaves: their number, the longest wave in edges of the mesh, and how the next one relates to
/// the last in frequency and height. The shortest is of 6 edges, so that the mesh can carry it.
const OCTAVES: usize = 4;
const LONGEST_WAVE: f64 = 50.0;
const LACUNARITY: f64 = 2.0;
const PERSISTENCE: f64 = 0.6;

/// A triangle mesh in memory.
pub struct Mesh {
    /// Positions.
    pub positions: Vec<DVec3>,
    /// Indices of vertices, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Reads the triangles (and polygons, cut into them) of a Wavefront OBJ file.
    ///
    /// # Errors
    /// The file cannot be read, or has no triangles.
    pub fn read_obj(path: &Path) -> Result<Self> {
        let options = tobj::LoadOptions { triangulate: true, ..tobj::LoadOptions::default() };
        let (models, _) =
            tobj::load_obj(path, &options).map_err(|e| format!("cannot read {}: {e}", path.display()))?;
        let mut mesh = Self { positions: Vec::new(), triangles: Vec::new() };
        for tobj::Model { mesh: part, .. } in models {
            let first = mesh.positions.len() as u32;
            let positions = part.positions.as_chunks().0.iter();
            mesh.positions.extend(positions.map(|p: &[f32; 3]| DVec3::from_array(p.map(f64::from))));
            let triangles = part.indices.as_chunks().0.iter();
            mesh.triangles.extend(triangles.map(|t: &[u32; 3]| t.map(|i| first + i)));
        }
        if mesh.triangles.is_empty() {
            return Err(format!("{} has no triangles", path.display()).into());
        }
        Ok(mesh)
    }

    /// A coarse amphora, to be refined to so many vertices.
    ///
    /// # Errors
    /// There are too many of them for a mesh in memory.
    pub fn amphora(vertices: usize) -> Result<Self> {
        let surface = Surface::new(Shape::Amphora, (vertices as u64 / REFINEMENT).max(MIN_VERTICES))?;
        let (vertices, triangles) = surface.mesh()?;
        Ok(Self { positions: vertices.iter().map(|vertex| vertex.position).collect(), triangles })
    }

    /// The box around all vertices.
    pub fn bounds(&self) -> Bounds {
        Bounds::from_points(self.positions.iter().copied())
    }

    /// Unit normals of the vertices, weighted by the areas of the triangles around; zero where there are
    /// none.
    pub fn normals(&self) -> Vec<DVec3> {
        let mut normals = vec![DVec3::ZERO; self.positions.len()];
        for triangle in &self.triangles {
            let [a, b, c] = self.corners(*triangle);
            let normal = (b - a).cross(c - a);
            triangle.iter().for_each(|i| normals[*i as usize] += normal);
        }
        normals.iter().map(|n| n.normalize_or_zero()).collect()
    }

    /// Splits edges until there are exactly so many vertices (at least as many as there are now): all edges
    /// while that is not too much, and at last the longest ones.
    pub fn refine_to(&mut self, vertices: usize) {
        while self.positions.len() < vertices && !self.triangles.is_empty() {
            self.split(vertices - self.positions.len());
        }
    }

    /// Moves the vertices along their normals by noise whose r.m.s. is `height`, the same each time.
    pub fn roughen(&mut self, height: f64) {
        let normals = self.normals();
        let (origin, scale) = (self.bounds().min, 1.0 / (LONGEST_WAVE * self.mean_edge()));
        let relief = Fbm::<Perlin>::new(0)
            .set_octaves(OCTAVES)
            .set_lacunarity(LACUNARITY)
            .set_persistence(PERSISTENCE);
        let heights: Vec<f64> =
            self.positions.par_iter().map(|p| relief.get(((*p - origin) * scale).to_array())).collect();
        let squares: f64 = heights.iter().map(|h| h * h).sum();
        let rms = (squares / heights.len() as f64).sqrt().max(f64::MIN_POSITIVE);
        for ((p, normal), h) in self.positions.iter_mut().zip(normals).zip(heights) {
            *p += normal * (h * height / rms);
        }
    }

    /// Puts triangles that are near each other in space near each other in memory (along a Morton curve), as
    /// scanners and the tools after them leave them; OBJ files often do not.
    pub fn order(&mut self) {
        let bounds = self.bounds();
        let scale = 1023.0 / (bounds.max - bounds.min).max_element().max(f64::MIN_POSITIVE);
        let cell = |triangle: &[u32; 3]| {
            let center: DVec3 = self.corners(*triangle).iter().sum::<DVec3>() / 3.0;
            let [x, y, z] = ((center - bounds.min) * scale).to_array().map(|x| x as u32);
            (0..10).fold(0u32, |code, bit| {
                code | [x, y, z]
                    .iter()
                    .zip(0..)
                    .map(|(c, axis)| (c >> bit & 1) << (3 * bit + axis))
                    .sum::<u32>()
            })
        };
        let mut triangles = self.triangles.clone();
        triangles.sort_by_cached_key(cell);
        self.triangles = triangles;
    }

    /// Numbers the vertices as the triangles come to them; those of none are dropped.
    pub fn number_by_triangles(&mut self) {
        let mut numbers = vec![u32::MAX; self.positions.len()];
        let mut positions = Vec::with_capacity(self.positions.len());
        for i in self.triangles.iter_mut().flatten() {
            let number = &mut numbers[*i as usize];
            if *number == u32::MAX {
                *number = positions.len() as u32;
                positions.push(self.positions[*i as usize]);
            }
            *i = *number;
        }
        self.positions = positions;
    }

    /// Rounds positions to what a file of floats holds.
    pub fn round(&mut self) {
        self.positions.iter_mut().for_each(|p| *p = p.as_vec3().as_dvec3());
    }

    /// Writes a binary PLY: positions and normals in floats, and triangles as lists.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let mut file = OutputFile::create(path, 0)?;
        let mut out = BufWriter::with_capacity(1 << 20, &mut file);
        write!(
            out,
            "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\n\
             property float z\nproperty float nx\nproperty float ny\nproperty float nz\nelement face {}\n\
             property list uchar int vertex_indices\nend_header\n",
            self.positions.len(),
            self.triangles.len()
        )?;
        for (p, n) in self.positions.iter().zip(self.normals()) {
            let numbers = [p.x, p.y, p.z, n.x, n.y, n.z].map(|x| (x as f32).to_le_bytes());
            out.write_all(numbers.as_flattened())?;
        }
        for triangle in &self.triangles {
            out.write_all(&[3])?;
            out.write_all(triangle.map(u32::to_le_bytes).as_flattened())?;
        }
        out.flush()?;
        drop(out);
        Ok(file.commit()?)
    }

    fn corners(&self, triangle: [u32; 3]) -> [DVec3; 3] {
        triangle.map(|i| self.positions[i as usize])
    }

    fn mean_edge(&self) -> f64 {
        let around = |t: &[u32; 3]| {
            let [a, b, c] = self.corners(*t);
            a.distance(b) + b.distance(c) + c.distance(a)
        };
        let sum: f64 = self.triangles.iter().map(around).sum();
        sum / (3 * self.triangles.len()).max(1) as f64
    }

    /// Splits at most so many edges, the longest ones.
    fn split(&mut self, most: usize) {
        let mut edges: Vec<(u32, u32)> = self.triangles.iter().flat_map(|t| edges_of(*t)).collect();
        edges.par_sort_unstable();
        edges.dedup();
        if edges.len() > most {
            let length = |(a, b): (u32, u32)| self.positions[a as usize].distance(self.positions[b as usize]);
            let longest_first =
                |x: &(u32, u32), y: &(u32, u32)| length(*y).total_cmp(&length(*x)).then(x.cmp(y));
            edges.par_sort_unstable_by(longest_first);
            edges.truncate(most);
            edges.par_sort_unstable();
        }
        let first = self.positions.len();
        let middles = self.middles(&edges);
        self.positions.extend(middles);
        let middle = |edge: (u32, u32)| edges.binary_search(&edge).ok().map(|i| (first + i) as u32);
        let pieces: Vec<Vec<[u32; 3]>> = self
            .triangles
            .par_chunks(1 << 14)
            .map(|triangles| {
                let mut pieces = Vec::with_capacity(4 * triangles.len());
                triangles.iter().for_each(|t| self.cut(*t, edges_of(*t).map(middle), &mut pieces));
                pieces
            })
            .collect();
        self.triangles = pieces.concat();
    }

    /// The middles of edges, on the cubic curves over them that PN triangles have.
    fn middles(&self, edges: &[(u32, u32)]) -> Vec<DVec3> {
        let normals = self.normals();
        let middle = |(a, b): &(u32, u32)| {
            let [(p, n), (q, m)] = [a, b].map(|i| (self.positions[*i as usize], normals[*i as usize]));
            0.5 * (p + q) - 0.125 * ((q - p).dot(n) * n + (p - q).dot(m) * m)
        };
        edges.par_iter().map(middle).collect()
    }

    /// Cuts a triangle at the middles of its edges, where they have one.
    fn cut(&self, [a, b, c]: [u32; 3], middles: [Option<u32>; 3], pieces: &mut Vec<[u32; 3]>) {
        match middles {
            [None, None, None] => pieces.push([a, b, c]),
            [Some(ab), None, None] => pieces.extend([[a, ab, c], [ab, b, c]]),
            [Some(ab), Some(bc), None] => {
                let length = |i: u32, j: u32| self.positions[i as usize].distance(self.positions[j as usize]);
                pieces.push([ab, b, bc]);
                // The quadrangle that is left, along its shorter diagonal.
                if length(a, bc) < length(ab, c) {
                    pieces.extend([[a, ab, bc], [a, bc, c]]);
                } else {
                    pieces.extend([[a, ab, c], [ab, bc, c]]);
                }
            }
            [Some(ab), Some(bc), Some(ca)] => {
                pieces.extend([[a, ab, ca], [ab, b, bc], [ab, bc, ca], [ca, bc, c]]);
            }
            // Turned until it is one of these.
            [ab, bc, ca] => self.cut([b, c, a], [bc, ca, ab], pieces),
        }
    }
}

/// The edges of a triangle, each with its lower vertex first.
fn edges_of([a, b, c]: [u32; 3]) -> [(u32, u32); 3] {
    [(a, b), (b, c), (c, a)].map(|(a, b)| (a.min(b), a.max(b)))
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use super::*;

    /// A sphere of radius 1, coarsely.
    fn octahedron() -> Mesh {
        let positions = [1.0, -1.0].iter().flat_map(|s| DVec3::AXES.map(|axis| *s * axis)).collect();
        let triangles =
            [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]];
        Mesh { positions, triangles: triangles.to_vec() }
    }

    /// Checks that each edge lies between two triangles that agree on the outside, and that there is no hole.
    fn assert_closed(mesh: &Mesh) {
        let mut edges = HashMap::new();
        for [a, b, c] in &mesh.triangles {
            for edge in [(*a, *b), (*b, *c), (*c, *a)] {
                assert_eq!(edges.insert(edge, ()), None, "edge {edge:?} twice");
            }
        }
        assert!(edges.keys().all(|(a, b)| edges.contains_key(&(*b, *a))));
        assert_eq!(mesh.positions.len() + mesh.triangles.len(), edges.len() / 2 + 2, "Euler's formula");
    }

    #[test]
    fn refining_gives_any_number_of_vertices() {
        for vertices in [6, 7, 10, 18, 1000, 4242] {
            let mut mesh = octahedron();
            mesh.refine_to(vertices);
            assert_eq!(mesh.positions.len(), vertices);
            assert_closed(&mesh);
            let inwards = mesh.positions.iter().zip(mesh.normals()).filter(|(p, n)| p.dot(*n) < 0.8).count();
            assert_eq!(inwards, 0, "{vertices}");
        }
    }

    #[test]
    fn refining_keeps_a_sphere_round() {
        let mut mesh = octahedron();
        mesh.refine_to(1026);
        mesh.positions.iter_mut().for_each(|p| *p = p.normalize_or_zero());
        mesh.refine_to(10_000);
        let off = mesh.positions.iter().map(|p| (p.length() - 1.0).abs()).fold(0.0, f64::max);
        // The longest edges are of 0.14: their flat middles would be 2.5e-3 off.
        assert!(off < 6e-4, "{off}");
    }

    #[test]
    fn relief_has_its_height() {
        let mut mesh = octahedron();
        mesh.refine_to(20_000);
        let before = mesh.positions.clone();
        mesh.roughen(1e-3);
        let squares: f64 = mesh.positions.iter().zip(&before).map(|(p, q)| p.distance_squared(*q)).sum();
        let rms = (squares / before.len() as f64).sqrt();
        assert!((rms - 1e-3).abs() < 1e-9, "{rms}");
    }

    #[test]
    fn order_brings_neighbours_together_and_keeps_the_mesh() {
        let mut mesh = octahedron();
        mesh.refine_to(5000);
        // Order of triangles as a bad exporter leaves it.
        let scattered = mesh.triangles.iter().map(|t| t[0].wrapping_mul(2_654_435_761)).collect::<Vec<_>>();
        let mut triangles: Vec<_> = scattered.into_iter().zip(mesh.triangles).collect();
        triangles.sort();
        mesh.triangles = triangles.into_iter().map(|(_, t)| t).collect();
        mesh.number_by_triangles();
        let jump = |mesh: &Mesh| -> f64 { mesh.positions.windows(2).map(|w| w[0].distance(w[1])).sum() };
        let before = jump(&mesh);
        mesh.order();
        mesh.number_by_triangles();
        assert_closed(&mesh);
        assert_eq!(mesh.positions.len(), 5000);
        assert!(jump(&mesh) < 0.2 * before, "{} of {before}", jump(&mesh));
    }

    #[test]
    fn an_amphora_is_refined_and_written() {
        let mut mesh = Mesh::amphora(20_000).expect("an amphora");
        mesh.refine_to(20_000);
        mesh.round();
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("scan.ply");
        mesh.write(&path).expect("a file");
        let model = simod_model::open(&path).expect("a model");
        let info = model.info();
        assert_eq!((info.vertices, info.faces), (20_000, mesh.triangles.len() as u64));
        assert_eq!(info.vertex_bytes, (20_000 * VERTEX_BYTES) as u64);
        model.check_complete(&simod_model::progress::Silent).expect("a whole file");
        let mut chunk = simod_model::VertexChunk::default();
        model.vertices(0..20_000).expect("a reader").read(&mut chunk).expect("vertices");
        assert_eq!(chunk.positions, mesh.positions);
        assert!(chunk.normals.iter().all(|n| n.is_normalized()));
    }

    #[test]
    fn triangles_and_polygons_of_an_obj_are_read() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("square.obj");
        let text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\no square\nf 1//1 2//1 3//1 4//1\nvn 0 0 1\no corner\nf 1 2 4\n";
        simod_model::output::write_file(&path, text.as_bytes()).expect("a file");
        let mesh = Mesh::read_obj(&path).expect("a mesh");
        assert_eq!(mesh.triangles.len(), 3);
        let normals = mesh.normals();
        assert!(normals.iter().all(|n| *n == DVec3::Z), "{normals:?}");
        assert!(Mesh::read_obj(&folder.path().join("none.obj")).is_err());
    }
}
