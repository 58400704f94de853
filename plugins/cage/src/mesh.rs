//! A cage: a closed surface of triangles, and its reading from a file.

use glam::{DMat3, DVec3};
use simod_plugin_api::{PluginError, PluginResult};
use std::collections::HashMap;
use std::path::Path;

/// Volume, as a part of the box' cube, below which a cage is flat.
const FLAT: f64 = 1e-9;

/// A triangle of a cage.
#[derive(Debug, Clone, Copy)]
pub struct CageTriangle {
    /// Corners, counter-clockwise as seen from outside.
    pub corners: [usize; 3],
    /// Edge opposite to each corner, and its direction there: the edge's own (1), or the other one (-1).
    pub edges: [(usize, f64); 3],
}

/// A closed surface of triangles that face outwards.
#[derive(Debug, Clone)]
pub struct Cage {
    pub vertices: Vec<DVec3>,
    pub triangles: Vec<CageTriangle>,
    /// Polygons that are shown, of which the triangles are parts.
    pub faces: Vec<Vec<u32>>,
    /// Vertices at both ends of each edge.
    pub edges: Vec<[usize; 2]>,
    /// The middle of the vertices' box.
    pub centre: DVec3,
    /// Radius of a sphere about the centre that holds the box.
    pub radius: f64,
    /// The mean of the vertices.
    pub mean: DVec3,
    /// The inverse of the sum of `(p - mean)(p - mean)ᵀ` over the vertices.
    pub scatter_inverse: DMat3,
}

fn refused(what: String) -> PluginError {
    PluginError::parameter("file", &what)
        .hint("give a closed surface whose faces all look outwards, each edge shared by two of them")
}

impl Cage {
    /// The surface of these triangles, which may all look inwards as well.
    ///
    /// # Errors
    /// The surface is not closed, not consistently oriented, or flat; vertices are not finite, or in no
    /// triangle. Vertices are numbered from 1 there, as in OBJ files.
    pub fn new(vertices: Vec<DVec3>, mut corners: Vec<[usize; 3]>) -> PluginResult<Self> {
        if let Some(v) = vertices.iter().position(|p| !p.is_finite()) {
            return Err(refused(format!("has a vertex that is not finite, number {}", v + 1)));
        }
        let (min, max) =
            vertices.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(a, b), p| (a.min(*p), b.max(*p)));
        let (centre, radius) = (0.5 * (min + max), 0.5 * min.distance(max));
        let volume = |[a, b, c]: &[usize; 3]| {
            let [a, b, c] = [a, b, c].map(|v| (vertices[*v] - centre) / radius);
            a.cross(b).dot(c) / 6.0
        };
        let volume: f64 = corners.iter().map(volume).sum();
        // The volume is not a number with all vertices in one point.
        if volume.is_nan() || volume.abs() <= FLAT {
            return Err(refused("holds a cage without a volume".to_owned()));
        }
        if volume < 0.0 {
            corners.iter_mut().for_each(|c| c.swap(1, 2));
        }
        let mean = vertices.iter().sum::<DVec3>() / vertices.len() as f64;
        let outer = |d: DVec3| DMat3::from_cols(d.x * d, d.y * d, d.z * d);
        // The scatter has an inverse, as there is a volume.
        let scatter = vertices.iter().fold(DMat3::ZERO, |sum, p| sum + outer((*p - mean) / radius));
        let scatter_inverse = scatter.inverse() * (1.0 / (radius * radius));
        let mut this = Self {
            vertices,
            mean,
            scatter_inverse,
            triangles: Vec::with_capacity(corners.len()),
            faces: corners.iter().map(|corners| corners.map(|v| v as u32).to_vec()).collect(),
            edges: Vec::new(),
            centre,
            radius,
        };
        this.connect(&corners)?;
        let mut used = vec![false; this.vertices.len()];
        corners.iter().flatten().for_each(|v| used[*v] = true);
        match used.iter().position(|used| !used) {
            Some(v) => Err(refused(format!("has a vertex in no face, number {}", v + 1))),
            None => Ok(this),
        }
    }

    /// The same cage with other polygons to be shown.
    pub fn with_faces(self, faces: Vec<Vec<u32>>) -> Self {
        Self { faces, ..self }
    }

    /// Finds the edges.
    fn connect(&mut self, corners: &[[usize; 3]]) -> PluginResult<()> {
        // The table has, for each edge, the number of triangles that run along it, and against it.
        let mut known: HashMap<[usize; 2], (usize, [usize; 2])> = HashMap::new();
        for corners in corners {
            let mut edges = [(0, 1.0); 3];
            for i in 0..3 {
                let (a, b) = (corners[(i + 1) % 3], corners[(i + 2) % 3]);
                let ends = [a.min(b), a.max(b)];
                let (edge, uses) = known.entry(ends).or_insert_with(|| {
                    self.edges.push(ends);
                    (self.edges.len() - 1, [0; 2])
                });
                uses[usize::from(a > b)] += 1;
                edges[i] = (*edge, if a < b { 1.0 } else { -1.0 });
            }
            self.triangles.push(CageTriangle { corners: *corners, edges });
        }
        for ends @ [a, b] in &self.edges {
            let (along, against) = known.get(ends).map_or((0, 0), |(_, [along, against])| (*along, *against));
            let between = format!("the edge between the vertices {} and {}", a + 1, b + 1);
            match (along, against) {
                (1, 1) if a != b => {}
                (1, 0) | (0, 1) => return Err(refused(format!("holds a cage with a hole, at {between}"))),
                (2, 0) | (0, 2) => {
                    return Err(refused(format!(
                        "holds faces that look in and out beside each other, at {between}"
                    )));
                }
                _ => {
                    return Err(refused(format!("holds a cage with {} faces at {between}", along + against)));
                }
            }
        }
        Ok(())
    }

    /// The cage in a Wavefront OBJ file, in the file's coordinates: its vertices in their order, and its
    /// faces as triangles. Everything else is passed over.
    pub fn read(path: &Path, to_local: impl Fn(DVec3) -> DVec3) -> PluginResult<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| {
            PluginError::parameter("file", &format!("cannot be read: {}: {e}", path.display()))
                .hint("give an OBJ file")
        })?;
        let (mut vertices, mut triangles, mut faces) = (Vec::new(), Vec::new(), Vec::new());
        for (number, line) in text.lines().enumerate() {
            let wrong = || {
                PluginError::parameter(
                    "file",
                    &format!("is no OBJ file: {}, line {}", path.display(), number + 1),
                )
                .hint("give vertices as `v x y z` and faces as `f 1 2 3`")
            };
            let mut words = line.split_whitespace();
            match words.next() {
                Some("v") => {
                    let mut number = || words.next().and_then(|w| w.parse().ok()).ok_or_else(wrong);
                    vertices.push(to_local(DVec3::new(number()?, number()?, number()?)));
                }
                Some("f") => {
                    let corners: Option<Vec<usize>> = words.map(|w| corner(w, vertices.len())).collect();
                    let corners = corners.filter(|c| c.len() >= 3).ok_or_else(wrong)?;
                    triangles.extend(corners[1..].windows(2).map(|pair| [corners[0], pair[0], pair[1]]));
                    faces.push(corners.iter().map(|v| *v as u32).collect());
                }
                _ => {}
            }
        }
        Ok(Self::new(vertices, triangles)?.with_faces(faces))
    }
}

/// Corner of a face, as `7`, `7/2/5` or `-1`, which is the last vertex so far.
fn corner(word: &str, vertices: usize) -> Option<usize> {
    let number: i64 = word.split('/').next()?.parse().ok()?;
    let index = if number < 0 { vertices as i64 + number } else { number - 1 };
    usize::try_from(index).ok().filter(|v| *v < vertices)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    /// Damaged files are an error or a cage, and nothing panics.
    #[test]
    fn damaged_files_do_no_harm() {
        let good = "# a tetrahedron\no cage\nv 0 0 0\nv 1 0 0 1.0\nv 0 1 0\nv 0 0 1\nvn 0 0 1\n\
                    f 1 3 2\nf 1/1/1 2//1 4\nf 1 4 3\nf -3 -2 -1\n";
        assert!(read(good).is_ok());
        simod_tests::damage::damaged_files(good, 500, |path| match Cage::read(path, |p| p) {
            Ok(cage) => assert!(cage.vertices.iter().all(|p| p.is_finite())),
            Err(e) => assert!(!e.message.is_empty() && !e.hint.is_empty()),
        });
    }

    fn read(text: &str) -> PluginResult<Cage> {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(text.as_bytes()).unwrap();
        Cage::read(file.path(), |p| p)
    }

    const VERTICES: &str = "# a tetrahedron\nv 0 0 0\nv 1 0 0 1\nvn 0 0 1\nv 0 1e0 0\nv 0 0 1\n";

    #[test]
    fn obj_files_are_read() {
        let cage = read(&format!("{VERTICES}f 1 3 2\nf 1//1 2//1 4//1\nf -2 4 2\nf 1/7 4/8/9 3")).unwrap();
        assert_eq!((cage.vertices.len(), cage.triangles.len(), cage.edges.len()), (4, 4, 6));
        assert_eq!(cage.vertices[2], DVec3::Y);
        // The cage turned inside out is the same.
        let turned = read(&format!("{VERTICES}f 2 3 1\nf 4 2 1\nf 2 4 3\nf 3 4 1")).unwrap();
        let out = |c: &Cage| {
            c.triangles.iter().all(|t| {
                let [a, b, d] = t.corners.map(|v| c.vertices[v]);
                (b - a).cross(d - a).dot((a + b + d) / 3.0 - DVec3::splat(0.25)) > 0.0
            })
        };
        assert!(out(&cage) && out(&turned));
        // A face of four corners, of a pyramid.
        let pyramid =
            "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nf 1 4 3 2\nf 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5";
        let cage = read(pyramid).unwrap();
        assert_eq!((cage.triangles.len(), cage.faces.len()), (6, 5));
        assert_eq!(cage.faces[0], [0, 3, 2, 1]);
    }

    #[test]
    fn what_is_no_cage_is_refused() {
        let told = |text: &str, part: &str| {
            let error = read(text).unwrap_err();
            assert!(error.message.contains(part), "{part}: {error}");
            assert!(!error.hint.is_empty(), "{part}");
        };
        told("", "without a volume");
        told(VERTICES, "without a volume");
        told(
            &format!("{VERTICES}f 1 3 2\nf 1 2 4\nf 3 4 2"),
            "a hole, at the edge between the vertices 1 and 3",
        );
        told(&format!("{VERTICES}f 1 3 2\nf 1 2 4\nf 3 2 4\nf 1 4 3"), "look in and out");
        told(&format!("{VERTICES}f 1 3 2\nf 1 2 4\nf 3 4 2\nf 1 4 3\nf 1 4 3\nf 1 3 4"), "faces at");
        told(&format!("{VERTICES}v 1 1 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3"), "in no face, number 5");
        told(&format!("{VERTICES}f 1 3 9"), "line 7");
        told(&format!("{VERTICES}f 1 0 2"), "line 7");
        told(&format!("{VERTICES}f 1 2"), "line 7");
        told("v 0 0", "line 1");
        told("v 0 0 x", "line 1");
        told("v 0 0 nan", "not finite");
        let error = Cage::read(Path::new("/nowhere.obj"), |p| p).unwrap_err();
        assert!(error.message.contains("/nowhere.obj"), "{error}");
    }
}
