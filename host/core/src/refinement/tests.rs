//! Tests of refinement that hold for any model, sampling and selection.

use std::path::PathBuf;

use glam::{DVec3, Vec3};
use simod_generate::{Shape, Surface};
use simod_model::Scalar;
use simod_model::progress::Silent;
use simod_model::write_points;
use tempfile::TempDir;

use super::*;
use crate::sampling::triangles::{self, Wanted};
use crate::sampling::{Grouping, Sampling, Skip, Splitting, Target, sample};

/// A generated model on the disk.
pub(crate) struct Body {
    pub folder: TempDir,
    pub positions: Vec<DVec3>,
    pub normals: Vec<Vec3>,
    faces: Vec<[u32; 3]>,
}

impl Body {
    pub fn new(vertices: u64) -> Self {
        let (vertices, faces) = Surface::new(Shape::Amphora, vertices).unwrap().mesh().unwrap();
        let (positions, normals) = vertices.iter().map(|v| (v.position, v.normal)).unzip();
        Self { folder: tempfile::tempdir().unwrap(), positions, normals, faces }
    }

    pub fn without_faces(mut self) -> Self {
        self.faces.clear();
        self
    }

    pub fn without_normals(mut self) -> Self {
        self.normals.clear();
        self
    }

    /// The vertices of a cloud in no order.
    pub fn shuffled(mut self) -> Self {
        assert!(self.faces.is_empty() && !self.positions.len().is_multiple_of(7919));
        let n = self.positions.len();
        let from = |i: usize| i * 7919 % n;
        self.positions = (0..n).map(|i| self.positions[from(i)]).collect();
        self.normals = (0..self.normals.len()).map(|i| self.normals[from(i)]).collect();
        self
    }

    pub fn path(&self) -> PathBuf {
        self.folder.path().join("model.ply")
    }

    pub fn write(&self) -> Box<dyn Model> {
        let positions = self.positions.iter().copied();
        write_points(&self.path(), positions, &self.normals, &self.faces, Scalar::F64, &[]).unwrap();
        simod_model::open(&self.path()).unwrap()
    }

    pub fn sampled(&self, sampling: Sampling) -> (SampledModel, Box<dyn Model>) {
        let model = self.write();
        (sample(model.as_ref(), &sampling, self.folder.path(), &Silent).unwrap(), model)
    }
}

/// Sampling that keeps clusters as the trees have them: those of several sheets are not parted.
pub(crate) fn samples(n: u64) -> Sampling {
    let skip = Skip { sheets: true, ..Skip::default() };
    Sampling { target: Target::Samples(n), skip, ..Sampling::default() }
}

/// Signed distance to a ball.
fn ball(center: [f64; 3], radius: f64) -> impl Fn(DVec3) -> f64 + Sync {
    move |p| p.distance(DVec3::from(center)) - radius
}

fn refined(
    sampled: &SampledModel,
    model: &dyn Model,
    finer: Finer,
    distance: &(dyn Fn(DVec3) -> f64 + Sync),
) -> Result<Refined> {
    let how = Refining { finer, memory_limit: None, shapes: Vec::new() };
    let folder = model.path().parent().unwrap();
    refine(sampled, model, SpaceSelection { distance, so_far: None, at_rest: true }, &how, folder, &Silent)
}

/// The sample of each vertex, by the kept trees; `None` where its position is not finite.
fn members(sampled: &SampledModel, model: &dyn Model) -> Vec<Option<u32>> {
    let kept = sampled.held_cells().unwrap();
    let (frame, cubes) = (sampled.frame, sampled.cubes());
    let gathering = Gathering { model, kept, frame, cubes, with_ids: true, attributes: 0, opaque: None };
    let all: Vec<u32> = (0..kept.cells.len() as u32).collect();
    let (gathered, _) = gathering.read(&all, &Silent).unwrap().expect("the model is as it was");
    let nowhere = |_: DVec3| f64::INFINITY;
    let sizing = Sizing::Selected(Selected::new(
        SpaceSelection { distance: &nowhere, so_far: None, at_rest: true },
        sampled.frame,
    ));
    let old = sampled.samples.len() as u32;
    let how = Regrowing { rule: sampled.rule(), sizing: &sizing, bound: 0.0, leaves_from: old, guides: None };
    let mut built = 0;
    let cells: Vec<Regrown> = gathered
        .into_iter()
        .map(|gathered| {
            let cell = &kept.cells[gathered.cell as usize];
            let wanted = vec![false; cell.tree.samples.len()];
            let mut cell = how.regrow(gathered, cell, &wanted).expect("the same tree");
            cell.count_from(built, old);
            built += cell.built;
            cell
        })
        .collect();
    let appended = append(kept, &sampled.samples.positions, &cells, 0.0, None);
    assert!(appended.positions.is_empty(), "nothing was to be refined");
    let mut of = vec![None; sampled.source.vertices as usize];
    for (vertex, leaf) in cells.iter().flat_map(|cell| &cell.members) {
        let starts = &appended.starts;
        let sample = match leaf.checked_sub(old) {
            None => *leaf,
            Some(leaf) => starts[starts.partition_point(|(first, _)| *first <= leaf) - 1].1,
        };
        assert!(of[*vertex as usize].replace(sample).is_none(), "vertex {vertex} is in two clusters");
    }
    of
}

/// Number of vertices of each sample; all finite vertices have one.
fn counts(sampled: &SampledModel, model: &dyn Model) -> Vec<u32> {
    let members = members(sampled, model);
    let mut counts = vec![0; sampled.samples.len()];
    members.iter().flatten().for_each(|sample| counts[*sample as usize] += 1);
    let finite = sampled.source.vertices - sampled.source.non_finite;
    assert_eq!(counts.iter().map(|n| u64::from(*n)).sum::<u64>(), finite);
    counts
}

#[test]
fn every_vertex_has_a_sample_and_samples_stay_however_often_it_is_refined() {
    let body = || Body::new(40_000);
    let mut odd = body().without_faces();
    odd.positions[20_033].x = f64::NAN;
    let cases = [
        (body(), samples(2000)),
        (body().without_faces().shuffled(), samples(2000)),
        (body().without_faces().without_normals(), samples(1500)),
        (odd, samples(2000)),
        (body(), Sampling { grouping: Grouping::Level(2), ..samples(2000) }),
        (body(), Sampling { splitting: Splitting::Octree, ..samples(2000) }),
        // Fewer samples than cells share the cells.
        (body(), Sampling { grid: Some(64), ..samples(300) }),
        (body(), Sampling { target: Target::Error(4e-3), ..samples(0) }),
    ];
    for (body, sampling) in cases {
        let (first, model) = body.sampled(sampling);
        let mut now = first;
        assert!(counts(&now, model.as_ref()).iter().all(|n| *n > 0));
        let steps = [
            (Finer::Factor(4.0), ball([0.41, 1.0, 0.41], 0.3)),
            (Finer::Error(1e-3), ball([0.41, 1.0, 0.41], 0.15)),
            (Finer::Samples(500), ball([0.4, 1.2, 0.4], 0.3)),
            (Finer::Error(0.0), ball([0.35, 1.0, 0.46], 0.1)),
        ];
        for (finer, place) in steps {
            let done = refined(&now, model.as_ref(), finer, &place).unwrap();
            assert!(done.added > 20, "{finer:?} {sampling:?}: {} samples", done.added);
            let next = done.sampled.unwrap();
            let old = now.samples.len();
            assert_eq!(next.samples.len(), old + done.added as usize);
            assert_eq!(next.samples.positions[..old], now.samples.positions);
            assert_eq!(next.samples.normals()[..old], *now.samples.normals());
            assert!(next.samples.normals()[old..].iter().all(|n| n.is_normalized()));
            let finite = next.source.vertices - next.source.non_finite;
            let kept = next.held_cells().unwrap();
            kept.check(
                finite,
                next.source.vertices,
                next.source.bytes,
                next.samples.len(),
                std::iter::empty(),
            )
            .unwrap();
            assert!(counts(&next, model.as_ref()).iter().all(|n| *n > 0), "{finer:?} {sampling:?}");
            // Far away, nothing is read, and nothing new is there.
            let far = next.samples.positions[old..].iter().map(|p| place(next.frame.to_model(*p)));
            let worst = far.fold(0.0, f64::max);
            assert!(worst < 0.5, "a new sample {worst} away: {finer:?} {sampling:?}");
            assert_eq!(next.triangles.is_empty(), now.triangles.is_empty());
            now = next;
        }
        // The folder holds it all.
        let folder = body.folder.path().join("model.simod");
        now.save(&folder).unwrap();
        let mut loaded = SampledModel::load(&folder).unwrap();
        assert_eq!(loaded.samples.positions, now.samples.positions);
        assert_eq!(loaded.refinements, now.refinements);
        assert_eq!(SampledModel::kept_cells(&folder).as_ref(), now.held_cells());
        loaded.hold_cells(SampledModel::kept_cells(&folder).unwrap());
        let place = ball([0.0, 0.1, 0.0], 0.2);
        let [a, b] = [&now, &loaded].map(|s| refined(s, model.as_ref(), Finer::Factor(3.0), &place).unwrap());
        let [a, b] = [a, b].map(|done| done.sampled.unwrap());
        assert_eq!(a.samples.positions, b.samples.positions);
        assert_eq!(a.held_cells(), b.held_cells());
    }
}

/// The tree after several refinements is that after one.
#[test]
fn many_refinements_come_to_what_one_does() {
    for grouping in [Grouping::Never, Grouping::Level(2)] {
        let body = Body::new(60_000).without_faces();
        let (first, model) = body.sampled(Sampling { grouping, ..samples(1500) });
        let place = ball([0.41, 1.0, 0.41], 0.25);
        let at_once = refined(&first, model.as_ref(), Finer::Error(6e-4), &place).unwrap().sampled.unwrap();
        let mut slowly = first;
        for e in [4e-3, 2e-3, 2e-3, 1e-3, 6e-4] {
            let done = refined(&slowly, model.as_ref(), Finer::Error(e), &place).unwrap();
            slowly = done.sampled.unwrap_or(slowly);
        }
        assert_eq!(slowly.samples.len(), at_once.samples.len());
        for (a, b) in slowly.held_cells().unwrap().cells.iter().zip(&at_once.held_cells().unwrap().cells) {
            assert_eq!((&a.tree.children, &a.tree.grown), (&b.tree.children, &b.tree.grown));
            assert_eq!(a.tree.errors, b.tree.errors);
        }
        let again = refined(&slowly, model.as_ref(), Finer::Error(6e-4), &place).unwrap();
        assert!(again.added == 0 && again.sampled.is_none());
    }
}

#[test]
fn an_error_of_nothing_gives_every_vertex_a_sample_of_its_own() {
    let body = Body::new(40_000);
    let (first, model) = body.sampled(samples(2000));
    let place = ball([0.41, 1.0, 0.41], 0.2);
    let full = refined(&first, model.as_ref(), Finer::Error(0.0), &place).unwrap().sampled.unwrap();
    let (members, counts) = (members(&full, model.as_ref()), counts(&full, model.as_ref()));
    let inside: Vec<usize> = (0..body.positions.len()).filter(|i| place(body.positions[*i]) <= 0.0).collect();
    assert!(inside.len() > 300);
    for i in inside {
        assert_eq!(counts[members[i].unwrap() as usize], 1, "vertex {i} shares its sample");
    }
    // New ones are the vertices themselves.
    let scale = full.local_diagonal() as f32;
    let alone = (0..body.positions.len()).filter(|i| counts[members[*i].unwrap() as usize] == 1);
    for (i, s) in alone.map(|i| (i, members[i].unwrap() as usize)).filter(|(_, s)| *s >= first.samples.len())
    {
        let off = full.samples.positions[s].distance(full.frame.to_local(body.positions[i]));
        assert!(off < 1e-6 * scale, "vertex {i}: {off}");
    }
    // The surface there is the model's own.
    let corners = |t: &[u32; 3]| t.map(|v| members[v as usize].unwrap());
    let own = |t: &&[u32; 3]| t.iter().all(|v| place(body.positions[*v as usize]) <= 0.0);
    let known: std::collections::BTreeSet<[u32; 3]> = full.triangles.iter().copied().collect();
    for face in body.faces.iter().filter(own) {
        assert!(
            known.contains(&crate::sampling::triangles::first_least(corners(face))),
            "{face:?} is missing"
        );
    }
}

/// After any refinement the triangles are those that reindexing all faces gives.
#[test]
fn triangles_are_those_of_all_faces() {
    let body = Body::new(60_000);
    for sampling in [samples(3000), Sampling { grid: Some(64), ..samples(300) }] {
        let (first, model) = body.sampled(sampling);
        let mut now = first;
        for (finer, place) in [
            (Finer::Factor(6.0), ball([0.41, 1.0, 0.41], 0.2)),
            (Finer::Error(1e-3), ball([0.42, 1.1, 0.38], 0.15)),
        ] {
            now = refined(&now, model.as_ref(), finer, &place).unwrap().sampled.unwrap();
            let members: Vec<u32> = members(&now, model.as_ref()).into_iter().map(Option::unwrap).collect();
            let all =
                triangles::reindex(model.as_ref(), &members, now.samples.len(), all_triangles(), &Silent);
            assert!(now.triangles == all.unwrap().triangles, "{sampling:?} {finer:?}");
        }
    }
}

/// Form of the faces in a file.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Form {
    Shuffled,
    Polygons,
    Text,
    Strips,
    FacesAndStrips,
}

impl Body {
    /// Writes the model with its faces in a form: pairs of triangles as quads, others as they are, some with
    /// no triangle.
    fn write_as(&self, form: Form) -> Box<dyn Model> {
        let mut polygons: Vec<Vec<u32>> = Vec::new();
        let mut faces = self.faces.iter().peekable();
        while let Some([a, b, c]) = faces.next() {
            match faces.next_if(|[d, e, _]| d == a && e == c && form != Form::Strips) {
                Some([_, _, d]) => polygons.push(vec![*a, *b, *c, *d]),
                None => polygons.push(vec![*a, *b, *c]),
            }
            if polygons.len().is_multiple_of(7) {
                polygons.push(vec![*a, *b]);
            }
        }
        if form == Form::Shuffled {
            let n = polygons.len();
            assert!(!n.is_multiple_of(7919));
            polygons = (0..n).map(|i| polygons[i * 7919 % n].clone()).collect();
        }
        let (text, strips) = (form == Form::Text, form == Form::Strips);
        let half = if form == Form::FacesAndStrips { polygons.len() / 2 } else { polygons.len() };
        let format = if text { "ascii" } else { "binary_little_endian" };
        let mut bytes = format!(
            "ply\nformat {format} 1.0\nelement vertex {}\nproperty double x\nproperty double y\nproperty double z\n\
             element {} {half}\nproperty list uchar int vertex_indices\n",
            self.positions.len(),
            if strips { "tristrips" } else { "face" }
        );
        if half < polygons.len() {
            bytes += &format!(
                "element tristrips {}\nproperty list uchar int vertex_indices\n",
                polygons.len() - half
            );
        }
        let mut bytes = (bytes + "end_header\n").into_bytes();
        for p in &self.positions {
            match text {
                true => bytes.extend(format!("{} {} {}\n", p.x, p.y, p.z).bytes()),
                false => bytes.extend(p.to_array().iter().flat_map(|x| x.to_le_bytes())),
            }
        }
        for polygon in &polygons {
            if text {
                let corners: Vec<String> = polygon.iter().map(u32::to_string).collect();
                bytes.extend(format!("{} {}\n", polygon.len(), corners.join(" ")).bytes());
            } else {
                bytes.push(polygon.len() as u8);
                bytes.extend(polygon.iter().flat_map(|corner| corner.to_le_bytes()));
            }
        }
        std::io::Write::write_all(&mut std::fs::File::create(self.path()).unwrap(), &bytes).unwrap();
        simod_model::open(&self.path()).unwrap()
    }
}

/// The faces are read of the chosen cells only, whatever their form, and the result is the same.
#[test]
fn faces_of_every_form_are_read_where_they_are() {
    let body = Body::new(60_000);
    let place = ball([0.41, 1.0, 0.41], 0.15);
    for form in [Form::Shuffled, Form::Polygons, Form::Text, Form::Strips, Form::FacesAndStrips] {
        let model = body.write_as(form);
        let mut now = sample(model.as_ref(), &samples(3000), body.folder.path(), &Silent).unwrap();
        assert_eq!(now.held_cells().unwrap().knows_faces, form != Form::FacesAndStrips);
        for finer in [Finer::Factor(6.0), Finer::Factor(2.0)] {
            let done = refined(&now, model.as_ref(), finer, &place).unwrap();
            now = done.sampled.unwrap();
            let all = model.info().face_bytes;
            match form {
                Form::Shuffled => assert!(done.face_bytes <= all),
                Form::FacesAndStrips => assert_eq!(done.face_bytes, all),
                _ => assert!(done.face_bytes * 4 < all, "{form:?}: {} of {all}", done.face_bytes),
            }
            let members: Vec<u32> = members(&now, model.as_ref()).into_iter().map(Option::unwrap).collect();
            let all =
                triangles::reindex(model.as_ref(), &members, now.samples.len(), all_triangles(), &Silent);
            assert!(now.triangles == all.unwrap().triangles, "{form:?} {finer:?}");
        }
    }
}

/// Faces that are no longer where they were, though the vertices are, are noticed.
#[test]
fn faces_that_have_moved_are_noticed() {
    let body = Body::new(60_000);
    let model = body.write_as(Form::Polygons);
    let first = sample(model.as_ref(), &samples(3000), body.folder.path(), &Silent).unwrap();
    let mut shorter = Body { faces: body.faces[1..].to_vec(), ..Body::new(60_000) };
    shorter.faces.push(body.faces[0]);
    let moved = shorter.write_as(Form::Polygons);
    let place = ball([0.41, 1.0, 0.41], 0.15);
    let error = refined(&first, moved.as_ref(), Finer::Factor(6.0), &place).err().expect("an error");
    assert_eq!(error.kind(), ErrorKind::Mismatch);
}

#[test]
fn numbers_of_samples_are_met() {
    let body = Body::new(200_000).without_faces();
    let (first, model) = body.sampled(samples(4000));
    let place = ball([0.41, 1.0, 0.41], 0.3);
    let inside =
        |s: &SampledModel| s.samples.positions.iter().filter(|p| place(s.frame.to_model(**p)) <= 0.0).count();
    for factor in [1.5, 4.0, 10.0, 40.0] {
        let now = refined(&first, model.as_ref(), Finer::Factor(factor), &place).unwrap().sampled.unwrap();
        let times = inside(&now) as f64 / inside(&first) as f64;
        assert!((0.6 * factor..1.3 * factor).contains(&times), "{times} times for {factor}");
    }
    for more in [10, 500, 5000] {
        let added = refined(&first, model.as_ref(), Finer::Samples(more), &place).unwrap().added;
        assert!(added <= more && added + 8 >= more * 49 / 50, "{added} for {more}");
    }
    // A number of samples above that of the vertices gives all vertices.
    let all = refined(&first, model.as_ref(), Finer::Samples(1_000_000), &place).unwrap();
    let full = refined(&first, model.as_ref(), Finer::Error(0.0), &place).unwrap();
    assert_eq!(all.added, full.added);
}

/// Neighbours are not much nearer to each other than others around them, and spacings change slowly.
#[test]
fn density_is_graded() {
    let body = Body::new(200_000).without_faces();
    let (first, model) = body.sampled(samples(3000));
    let place = ball([0.41, 1.0, 0.41], 0.2);
    let figures = |s: &SampledModel| {
        let (spacing, graph) = (s.samples.spacing(), s.samples.neighbours());
        let ratio = |i: usize| {
            let near = graph.nearest_to(i)[..6].iter().map(|j| spacing[*j as usize] / spacing[i]);
            near.fold(1.0f32, |a, r| a.max(r).max(1.0 / r))
        };
        let mut ratios: Vec<f32> = (0..s.samples.len()).map(ratio).collect();
        ratios.sort_by(f32::total_cmp);
        let nearest = |i: usize| {
            let j = graph.nearest_to(i)[0] as usize;
            s.samples.positions[i].distance(s.samples.positions[j]) / spacing[i]
        };
        let mut near: Vec<f32> = (0..s.samples.len()).map(nearest).collect();
        near.sort_by(f32::total_cmp);
        (ratios[ratios.len() * 99 / 100], near[near.len() / 100])
    };
    let now = refined(&first, model.as_ref(), Finer::Factor(20.0), &place).unwrap().sampled.unwrap();
    let ((jump, near), (jump_before, near_before)) = (figures(&now), figures(&first));
    assert!(jump < 1.5 * jump_before, "spacings jump by {jump}, before by {jump_before}");
    assert!(near > 0.6 * near_before, "the nearest is at {near} spacings, before at {near_before}");
}

#[test]
fn models_that_have_changed_and_selections_that_meet_nothing_are_refused() {
    let body = Body::new(40_000);
    let (first, model) = body.sampled(samples(2000));
    let place = ball([0.41, 1.0, 0.41], 0.3);
    let failed = |sampled: &SampledModel, model: &dyn Model, finer, place: &(dyn Fn(DVec3) -> f64 + Sync)| {
        refined(sampled, model, finer, place).err().expect("an error")
    };
    let error = failed(&first, model.as_ref(), Finer::Error(1e-4), &ball([9.0; 3], 1.0));
    assert!(error.to_string().contains("does not meet the model"), "{error}");
    for bad in [
        Finer::Error(-1.0),
        Finer::Error(f64::NAN),
        Finer::Factor(1.0),
        Finer::Factor(f64::INFINITY),
        Finer::Samples(0),
    ] {
        assert!(failed(&first, model.as_ref(), bad, &place).to_string().contains("out of range"));
    }
    let error = failed(&first, model.as_ref(), Finer::Error(1e-4), &|_| f64::NAN);
    assert!(error.to_string().contains("does not meet the model"), "{error}");

    // In a cell that is read, anything that moved is noticed.
    let mut other = Body::new(40_000);
    let inside = other.positions.iter().position(|p| place(*p) < -0.1).unwrap();
    other.positions[inside].y += 1e-4;
    let error = failed(&first, other.write().as_ref(), Finer::Error(1e-4), &place);
    assert_eq!(error.kind(), ErrorKind::Mismatch);
    other.positions[inside].y += 1.0;
    let error = failed(&first, other.write().as_ref(), Finer::Error(1e-4), &place);
    assert!(error.to_string().contains("changed since it was sampled"), "{error}");

    // Trees of another model are refused.
    let mut lying = first.held_cells().unwrap().clone();
    lying.cells.iter_mut().flat_map(|cell| &mut cell.tree.errors).for_each(|e| *e *= 1.25);
    let mut sampled = first;
    sampled.hold_cells(lying);
    let error = failed(&sampled, model.as_ref(), Finer::Error(1e-4), &place);
    assert_eq!(error.kind(), ErrorKind::Mismatch);
}

#[test]
fn memory_is_bounded_and_changes_nothing() {
    let body = Body::new(150_000).without_faces().shuffled();
    let (mut first, model) = body.sampled(samples(2000));
    // Of a larger model, no more would be known.
    let mut cells = first.held_cells().unwrap().clone();
    let whole = 0..150_000;
    cells.cells.iter_mut().for_each(|cell| cell.ranges = vec![whole.clone()]);
    first.hold_cells(cells);
    let place = ball([0.0, 1.0, 0.0], 0.7);
    let how = |limit, finer| Refining { finer, memory_limit: limit, shapes: Vec::new() };
    let run = |how: Refining| {
        let selection = SpaceSelection { distance: &place, so_far: None, at_rest: true };
        refine(&first, model.as_ref(), selection, &how, body.folder.path(), &Silent)
    };
    let free = run(how(None, Finer::Error(2e-3))).unwrap();
    let tight = run(how(Some(LEAST_MEMORY), Finer::Error(2e-3))).unwrap();
    // Cells came in several batches, for each of which a shuffled model is read.
    assert!(tight.vertex_bytes > free.vertex_bytes);
    let [free, tight] = [free, tight].map(|done| done.sampled.unwrap().samples.positions);
    assert_eq!(free, tight);
    let error = run(how(Some(LEAST_MEMORY), Finer::Error(0.0))).err().expect("too many");
    assert!(error.to_string().contains("more than"), "{error}");
}

#[test]
fn shapes_of_the_deformed_model_select_what_is_there_then() {
    let body = Body::new(60_000).without_faces();
    let (first, model) = body.sampled(samples(3000));
    let shift = Vec3::new(3.0, 0.0, 0.0);
    let deformed: Vec<Vec3> = first.samples.positions.iter().map(|p| *p + shift).collect();
    let around = crate::reconstruction::RestGeometry::new(&first.samples);
    let field = DeformationField::new(&around, &deformed, crate::reconstruction::Method::default());
    let by = shift.as_dvec3() * first.frame.scale;
    let (here, there) = (ball([0.41, 1.0, 0.41], 0.3), ball([0.41 + by.x, 1.0, 0.41], 0.3));
    let how = Refining { finer: Finer::Error(1e-3), memory_limit: None, shapes: Vec::new() };
    let run = |distance: &(dyn Fn(DVec3) -> f64 + Sync), so_far| {
        refine(
            &first,
            model.as_ref(),
            SpaceSelection { distance, so_far, at_rest: false },
            &how,
            body.folder.path(),
            &Silent,
        )
    };
    let at_rest = run(&here, None).unwrap().sampled.unwrap();
    let moved = run(&there, Some(&field)).unwrap().sampled.unwrap();
    // Clusters are the same, but for those at the rim, whose distance is rounded.
    assert!(at_rest.samples.len().abs_diff(moved.samples.len()) < 20);
    assert!(run(&here, Some(&field)).is_err());
    for (rest, image) in moved.samples.positions[3000.min(first.samples.len())..]
        .iter()
        .zip(appended_deformed(&moved, deformed.len(), &field))
    {
        let off = image.distance(moved.frame.to_model(*rest) + by) / moved.frame.scale;
        assert!(off < 1e-5, "{off}");
    }
}

fn deformed_by(sampled: &SampledModel, map: &dyn Fn(DVec3) -> DVec3) -> Vec<Vec3> {
    let frame = &sampled.frame;
    sampled.samples.positions.iter().map(|p| frame.to_local(map(frame.to_model(*p)))).collect()
}

fn with_field<T>(
    sampled: &SampledModel,
    map: &dyn Fn(DVec3) -> DVec3,
    call: impl FnOnce(&DeformationField<'_>) -> T,
) -> T {
    let deformed = deformed_by(sampled, map);
    let around = crate::reconstruction::RestGeometry::new(&sampled.samples);
    call(&DeformationField::new(&around, &deformed, crate::reconstruction::Method::default()))
}

/// To look for triangles alone.
fn all_triangles() -> Wanted<'static, 'static> {
    Wanted { triangles: true, ..Wanted::default() }
}

/// Error of each vertex, as a fraction of the diagonal.
fn off(sampled: &SampledModel, body: &Body, map: &dyn Fn(DVec3) -> DVec3) -> Vec<f64> {
    let moved = with_field(sampled, map, |field| carry_positions(field, &sampled.frame, &body.positions));
    let diagonal = sampled.bounds.diagonal();
    body.positions.iter().zip(&moved).map(|(p, q)| q.distance(map(*p)) / diagonal).collect()
}

/// Root of the mean square of errors, and their 99.9th percentile.
fn rms_and_p999(mut off: Vec<f64>) -> [f64; 2] {
    off.sort_by(f64::total_cmp);
    let n = off.len();
    [(off.iter().map(|e| e * e).sum::<f64>() / n as f64).sqrt(), off[n * 999 / 1000]]
}

/// Spearman's rank correlation.
fn spearman(a: &[f64], b: &[f64]) -> f64 {
    let ranks = |x: &[f64]| {
        let mut order: Vec<usize> = (0..x.len()).collect();
        order.sort_by(|i, j| x[*i].total_cmp(&x[*j]));
        let mut ranks = vec![0.0; x.len()];
        order.iter().enumerate().for_each(|(rank, i)| ranks[*i] = rank as f64);
        ranks
    };
    let (a, b) = (ranks(a), ranks(b));
    let mean = (a.len() as f64 - 1.0) / 2.0;
    let product = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| (x - mean) * (y - mean)).sum::<f64>();
    product(&a, &b) / (product(&a, &a) * product(&b, &b)).sqrt()
}

fn twist(p: DVec3) -> DVec3 {
    let (sin, cos) = (1.2 * p.y).sin_cos();
    DVec3::new(cos * p.x - sin * p.z, p.y, sin * p.x + cos * p.z)
}

fn bend(p: DVec3) -> DVec3 {
    let (sin, cos) = (0.8 * p.y).sin_cos();
    DVec3::new((1.0 + p.x) * cos - 1.0, (1.0 + p.x) * sin, p.z)
}

/// The middle of the bump, on the amphora's belly.
const BUMP: DVec3 = DVec3::new(0.41, 1.0, 0.41);

fn bump(p: DVec3) -> DVec3 {
    p + DVec3::new(0.1, 0.0, 0.1) * (-p.distance_squared(BUMP) / 0.01).exp()
}

fn step(p: DVec3) -> DVec3 {
    if p.x + 0.3 * p.y > 0.4 { p + DVec3::new(0.0, 0.0, 0.05) } else { p }
}

fn rigid(p: DVec3) -> DVec3 {
    glam::DQuat::from_euler(glam::EulerRot::XYZ, 0.7, -0.3, 1.1) * p + DVec3::new(3.0, -1.0, 0.5)
}

fn affine(p: DVec3) -> DVec3 {
    DVec3::new(1.5 * p.x + 0.3 * p.y, 0.7 * p.y, p.z + 0.2 * p.x)
}

/// A deformation of space.
type Map = fn(DVec3) -> DVec3;

/// The expected error is of the size of the error: it ranks the clusters, and tells the largest error in each
/// within a factor.
#[test]
fn expected_errors_are_of_the_size_of_errors() {
    let body = Body::new(200_000).without_faces();
    let (sampled, _) = body.sampled(samples(4000));
    let diagonal = sampled.local_diagonal();
    let maps: [(&str, Map, f64); 4] =
        [("twist", twist, 0.5), ("bend", bend, 0.5), ("bump", bump, 0.5), ("step", step, 0.3)];
    for (name, map, least) in maps {
        let expected: Vec<f64> = with_field(&sampled, &map, |field| {
            field.expected_error().iter().map(|e| f64::from(*e) / diagonal).collect()
        });
        let mut truth = vec![0.0f64; expected.len()];
        for (p, e) in body.positions.iter().zip(off(&sampled, &body, &map)) {
            let i = sampled.samples.nearest(sampled.frame.to_local(*p)) as usize;
            truth[i] = truth[i].max(e);
        }
        let is_told = |(e, t): &(&f64, &f64)| **e > 0.0 && **t > 0.0;
        let (e, t): (Vec<f64>, Vec<f64>) = expected.iter().zip(&truth).filter(is_told).unzip();
        let rank = spearman(&e, &t);
        let mut ratios: Vec<f64> = e.iter().zip(&t).map(|(e, t)| t / e).collect();
        ratios.sort_by(f64::total_cmp);
        let [low, middle, high] = [5, 50, 95].map(|q| ratios[q * ratios.len() / 100]);
        println!("{name}: rank correlation {rank:.2}; error over estimate {low:.2e}, {middle:.2}, {high:.2}");
        assert!(rank > least, "{name}: a rank correlation of {rank}");
        assert!(
            (0.1..0.7).contains(&middle) && high < 20.0,
            "{name}: {middle} times the estimate, up to {high}"
        );
    }
    for (name, map) in
        [("identity", &(|p| p) as &dyn Fn(DVec3) -> DVec3), ("rigid", &rigid), ("affine", &affine)]
    {
        let most = with_field(&sampled, map, |field| field.expected_error().into_iter().fold(0.0, f32::max));
        assert!(f64::from(most) < 1e-5, "{name}: {most}");
    }
}

fn auto(
    sampled: &SampledModel,
    model: &dyn Model,
    map: &dyn Fn(DVec3) -> DVec3,
    finer: Finer,
    distance: &(dyn Fn(DVec3) -> f64 + Sync),
) -> Result<Refined> {
    let how = Refining { finer, memory_limit: None, shapes: Vec::new() };
    let folder = model.path().parent().unwrap();
    with_field(sampled, map, |field| {
        let selection = SpaceSelection { distance, so_far: Some(field), at_rest: true };
        refine(sampled, model, selection, &how, folder, &Silent)
    })
}

/// The same number of new samples helps much more where the deformation needs them.
#[test]
fn samples_come_where_the_deformation_needs_them() {
    let body = Body::new(200_000).without_faces();
    let (sampled, model) = body.sampled(samples(4000));
    let everywhere = |_: DVec3| -1.0;
    let finer = Finer::Auto { error: 1e-5, samples: None };
    let done = auto(&sampled, model.as_ref(), &bump, finer, &everywhere).unwrap();
    let (need, next) = (done.need.unwrap(), done.sampled.unwrap());
    assert!(done.added > 500 && done.added <= 1000, "{} samples", done.added);
    assert!(need.expected > 1e-3 && need.allowed >= 1e-5 && need.samples > 20, "{need:?}");
    assert_eq!(next.refinements[0].transfer_error, Some(need.allowed));
    let new = &next.samples.positions[sampled.samples.len()..];
    let farthest = new.iter().map(|p| next.frame.to_model(*p).distance(BUMP)).fold(0.0, f64::max);
    assert!(farthest < 0.6, "a new sample {farthest} from the bump");
    let near = new.iter().filter(|p| next.frame.to_model(**p).distance(BUMP) < 0.3).count();
    assert!(near * 10 > new.len() * 8, "{near} of {} are near the bump", new.len());

    let before = rms_and_p999(off(&sampled, &body, &bump));
    let needed = rms_and_p999(off(&next, &body, &bump));
    let (more, _) = body.sampled(samples(next.samples.len() as u64));
    let uniform = rms_and_p999(off(&more, &body, &bump));
    println!(
        "rms and p99.9: {before:?} before, {uniform:?} with as many everywhere, {needed:?} where needed"
    );
    assert!(needed[0] * 5.0 < uniform[0] && needed[1] * 5.0 < uniform[1], "{needed:?}, {uniform:?}");

    // A smaller number of samples goes to the worst places.
    let few = Finer::Auto { error: 1e-5, samples: Some(200) };
    let few = auto(&sampled, model.as_ref(), &bump, few, &everywhere).unwrap();
    assert!(few.added > 50 && few.added <= 200, "{}", few.added);
    assert!(few.need.unwrap().allowed > need.allowed);
    let fewer = rms_and_p999(off(&few.sampled.unwrap(), &body, &bump));
    assert!(needed[0] < fewer[0] && fewer[0] < 0.7 * before[0], "{fewer:?}");

    // Shapes limit it.
    let below = |p: DVec3| p.y - 0.5;
    let none = auto(&sampled, model.as_ref(), &bump, finer, &below).unwrap();
    assert!(none.sampled.is_none() && none.need.unwrap().samples == 0);
    let nowhere = |p: DVec3| p.distance(DVec3::splat(9.0)) - 1.0;
    assert!(auto(&sampled, model.as_ref(), &bump, finer, &nowhere).is_err());
}

#[test]
fn what_needs_nothing_is_not_refined_and_nonsense_is_refused() {
    let body = Body::new(60_000);
    let (sampled, model) = body.sampled(samples(3000));
    let everywhere = |_: DVec3| -1.0;
    for error in [1e-5, 5e-6] {
        for map in [&(|p| p) as &dyn Fn(DVec3) -> DVec3, &rigid, &affine] {
            let finer = Finer::Auto { error, samples: None };
            let done = auto(&sampled, model.as_ref(), map, finer, &everywhere).unwrap();
            assert!(done.sampled.is_none() && done.added == 0 && done.vertex_bytes == 0);
            let need = done.need.unwrap();
            assert!(need.samples == 0 && need.expected < error, "{need:?}");
        }
    }
    // A deformation that has not moved anything yet needs no samples.
    let done = refined(&sampled, model.as_ref(), Finer::Auto { error: 1e-5, samples: None }, &everywhere);
    assert_eq!(done.unwrap().need.unwrap().samples, 0);
    for (error, samples) in [(0.0, None), (f64::NAN, None), (-1.0, Some(5)), (1e-5, Some(0))] {
        let failed = auto(&sampled, model.as_ref(), &bump, Finer::Auto { error, samples }, &everywhere);
        assert!(failed.err().expect("an error").to_string().contains("out of range"));
    }
    let huge = |p: DVec3| if p.distance(BUMP) < 0.1 { p * 1e38 } else { p };
    let failed =
        auto(&sampled, model.as_ref(), &huge, Finer::Auto { error: 1e-5, samples: None }, &everywhere);
    assert!(failed.is_ok() || failed.err().is_some_and(|e| e.to_string().contains("no finite number")));
}
