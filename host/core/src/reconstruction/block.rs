//! Blocks of consecutive vertices, which are gone through part by part: each vertex finds its home, vertices
//! of one home are put side by side, and the blend goes over them. Vertices in no order are put along a curve
//! before.

use glam::{DVec3, Mat3, UVec3, Vec3};
use rayon::prelude::*;
use simod_model::frame::{Frame, is_finite};

use super::blend::{Blending, Grouped, LEAST_WEIGHT};
use super::expansion::Expansion;
use super::homes::{Homes, with_room};
use super::lanes::PACKET;
use super::repeated::Repeated;
use super::workspace::{GroupFill, HomeRun, NOWHERE, Workspace};
use super::{DeformationField, Method, RestGeometry, Transport, VertexDiagnostics, projected_barycentric};

/// Most vertices that are carried over at a time: many, so that there are several of each home, and as few as
/// stay in the cache.
const BLOCK: usize = 1 << 14;

/// Most vertices of a block that are in no order, where blocks are dealt out to threads: so many that those
/// which follow each other on a curve are near.
const LARGE_BLOCK: usize = 1 << 16;

/// Step between the pairs of successive vertices that are looked at to tell whether vertices are in order: a
/// prime, so that pairs are at all places of runs of any other length …
const LOOKED_AT: usize = 17;

/// … and the number of pairs of which at most one is far apart where vertices are in order. Runs of some
/// twenty vertices in random order are found, too.
const JUMPS: usize = 24;

/// Vertices that a packet is not worth for.
const FEW: usize = 3;

/// Bits of a coordinate by which vertices are put in order …
const MORTON_BITS: u32 = 10;

/// … if many are further from the one before than this part of where they all are.
const JUMP: f64 = 0.1;

/// Positions, normals, gradients and figures of vertices that are carried over, in place: as at rest until
/// then.
pub struct Moved<'a> {
    /// Positions in the model's coordinates.
    pub positions: &'a mut [DVec3],
    /// Normals that are to be turned: as many, or none.
    pub normals: &'a mut [Vec3],
    /// The gradient of the deformation at each, which is filled in where anything moves: as many, or none.
    pub gradients: &'a mut [Mat3],
    /// Diagnostics of the surface at each vertex, which are filled in: as many as positions, or none.
    pub figures: &'a mut [VertexDiagnostics],
}

/// Carries consecutive vertices of the model over, by each of the fields for one of `moved`, on all threads
/// of the pool. `positions` are theirs at rest, in the model's coordinates. Vertices without a finite
/// position stay as they are. `homes` are as [`bind`](super::bind) kept them, if it did.
///
/// All fields are of the same samples. The deformed position of a vertex depends on its position alone, and
/// its normal on position and normal: not on what other vertices there are, on their order, on the division
/// into calls, or on the number of threads.
pub fn carry(
    fields: &[DeformationField<'_>],
    frame: &Frame,
    positions: &[DVec3],
    homes: Option<&[u32]>,
    moved: &mut [Moved<'_>],
) {
    if let Some(first) = fields.first().filter(|_| homes.is_none()) {
        // Before jobs ask for them.
        first.around.cells();
    }
    let most = most_of_block(positions, LARGE_BLOCK);
    blocks(positions, homes, moved, most).into_par_iter().for_each(|block| block.carry(fields, frame));
}

/// Deformed positions of points in the model's coordinates.
pub fn carry_positions(field: &DeformationField<'_>, frame: &Frame, positions: &[DVec3]) -> Vec<DVec3> {
    let mut moved = positions.to_vec();
    let to = &mut [Moved { positions: &mut moved, normals: &mut [], gradients: &mut [], figures: &mut [] }];
    carry(std::slice::from_ref(field), frame, positions, None, to);
    moved
}

/// Carries vertices over as [`carry`] does, by the thread that calls it. Where nothing is asked for but
/// positions, those of vertices at one place are found once. Vertices in no order are put in one as a whole:
/// the more there are, the nearer are those that follow each other then.
///
/// Memory: 12 bytes for each vertex in no order; 28 for each, and 24 for each version, where places are
/// [`Repeated`].
pub fn carry_on_this_thread(
    fields: &[DeformationField<'_>],
    frame: &Frame,
    positions: &[DVec3],
    homes: Option<&[u32]>,
    moved: &mut [Moved<'_>],
) {
    let places_alone = |moved: &Moved<'_>| {
        moved.normals.is_empty() && moved.gradients.is_empty() && moved.figures.is_empty()
    };
    let is_by_place = homes.is_none() && moved.iter().all(places_alone);
    let Some(repeated) = is_by_place.then(|| Repeated::find(positions)).flatten() else {
        let most = most_of_block(positions, usize::MAX);
        blocks(positions, homes, moved, most).into_iter().for_each(|block| block.carry(fields, frame));
        return;
    };
    let positions = repeated.gather(positions);
    let mut images: Vec<Vec<DVec3>> = moved.iter().map(|moved| repeated.gather(moved.positions)).collect();
    let of_places = |positions| Moved { positions, normals: &mut [], gradients: &mut [], figures: &mut [] };
    let mut of_places: Vec<Moved<'_>> = images.iter_mut().map(|images| of_places(images)).collect();
    let most = most_of_block(&positions, usize::MAX);
    let mut counts = repeated.count.chunks(most);
    for block in blocks(&positions, None, &mut of_places, most) {
        let counts = counts.next().unwrap_or_default();
        Block { counts, ..block }.carry(fields, frame);
    }
    for (moved, images) in moved.iter_mut().zip(&images) {
        repeated.scatter(images, moved.positions);
    }
}

/// Consecutive vertices, and their results in each version.
struct Block<'a> {
    positions: &'a [DVec3],
    homes: Option<&'a [u32]>,
    /// Number of vertices that each one stands for; empty where that is itself alone.
    counts: &'a [u32],
    moved: Vec<Moved<'a>>,
}

/// Blocks that vertices are divided into, each of at most `most` vertices.
fn blocks<'a>(
    positions: &'a [DVec3],
    homes: Option<&'a [u32]>,
    moved: &'a mut [Moved<'_>],
    most: usize,
) -> Vec<Block<'a>> {
    let ranges = (0..positions.len()).step_by(most).map(|at| at..positions.len().min(at + most));
    let mut blocks: Vec<Block<'a>> = ranges
        .map(|range| Block {
            positions: &positions[range.clone()],
            homes: homes.map(|homes| &homes[range]),
            counts: &[],
            moved: Vec::with_capacity(moved.len()),
        })
        .collect();
    for Moved { positions, normals, gradients, figures } in moved {
        let (mut of_normals, mut of_figures) = (normals.chunks_mut(most), figures.chunks_mut(most));
        let mut of_gradients = gradients.chunks_mut(most);
        for (block, positions) in blocks.iter_mut().zip(positions.chunks_mut(most)) {
            let normals = of_normals.next().unwrap_or_default();
            let gradients = of_gradients.next().unwrap_or_default();
            let figures = of_figures.next().unwrap_or_default();
            block.moved.push(Moved { positions, normals, gradients, figures });
        }
    }
    blocks
}

impl Block<'_> {
    fn carry(self, fields: &[DeformationField<'_>], frame: &Frame) {
        let Self { positions, homes, counts, mut moved } = self;
        let Some(around) = fields.first().map(|field| field.around) else { return };
        for Moved { normals, .. } in &mut moved {
            // Normals of splats are all zero as a rule, and stay so.
            if normals.iter().all(|n| *n == Vec3::ZERO) {
                *normals = &mut [];
            }
        }
        around.workspaces.with(|workspace| {
            workspace.for_parts(frame, positions, |workspace| {
                match homes {
                    Some(homes) => workspace.take_homes(homes),
                    None => workspace.find_homes(around),
                }
                workspace.group(fields);
                around.count(&workspace.grouped);
                if !counts.is_empty() {
                    for run in workspace.runs.iter().filter(|run| run.place != NOWHERE) {
                        let vertices = &workspace.order[run.range()];
                        let more = vertices.iter().map(|i| u64::from(counts[*i as usize] - 1));
                        around.count_more(run.home, more.sum());
                    }
                }
                let versions = fields.iter().zip(&mut moved);
                versions.for_each(|(field, moved)| workspace.carry(field, frame, positions, moved));
            });
        });
        for (field, moved) in fields.iter().zip(moved).filter(|(field, _)| field.shift != DVec3::ZERO) {
            let all = moved.positions.iter_mut().filter(|p| p.is_finite());
            all.for_each(|p| *p += field.shift);
        }
    }
}

/// The homes of consecutive vertices of the model, which `carry` finds itself unless it is told them.
pub fn homes(around: &RestGeometry<'_>, frame: &Frame, positions: &[DVec3], homes: &mut Vec<u32>) {
    homes.resize(positions.len(), 0);
    // Before jobs ask for them.
    around.cells();
    let most = most_of_block(positions, LARGE_BLOCK);
    let blocks = positions.par_chunks(most).zip(homes.par_chunks_mut(most));
    blocks.for_each(|(positions, homes)| {
        around.workspaces.with(|workspace| {
            workspace.for_parts(frame, positions, |workspace| {
                workspace.find_homes(around);
                let found = workspace.order.iter().zip(&workspace.homes);
                found.for_each(|(vertex, home)| homes[*vertex as usize] = *home);
            });
        });
    });
}

impl Workspace {
    /// Takes the vertices of a block, some of those that are near to each other after the other, and does
    /// `work` on each such part.
    fn for_parts(&mut self, frame: &Frame, positions: &[DVec3], mut work: impl FnMut(&mut Self)) {
        let mut all = std::mem::take(&mut self.block_order);
        put_in_order(frame, positions, &mut all);
        for part in all.chunks(BLOCK) {
            self.place(frame, positions, part);
            work(self);
        }
        self.block_order = all;
    }

    /// Takes some vertices of a block, in their order.
    fn place(&mut self, frame: &Frame, positions: &[DVec3], part: &[u32]) {
        self.order.clear();
        self.order.extend_from_slice(part);
        self.local.iter_mut().for_each(|x| x.resize(with_room(part.len()), 0.0));
        let [x, y, z] = &mut self.local;
        self.is_finite = true;
        for (((i, x), y), z) in self.order.iter().zip(x).zip(y).zip(z) {
            let p = positions[*i as usize];
            self.is_finite &= is_finite(p);
            (*x, *y, *z) = local(frame, p).into();
        }
    }

    fn find_homes(&mut self, around: &RestGeometry<'_>) {
        let local = self.local.each_ref().map(|x| &x[..]);
        Homes::new(around).find(local, self.order.len(), &mut self.homes);
    }

    fn take_homes(&mut self, homes: &[u32]) {
        self.homes.clear();
        self.homes.extend(self.order.iter().map(|i| homes[*i as usize]));
    }

    /// Carries the part over.
    fn carry(
        &mut self,
        field: &DeformationField<'_>,
        frame: &Frame,
        positions: &[DVec3],
        moved: &mut Moved<'_>,
    ) {
        let Moved { normals, gradients, figures, .. } = moved;
        let turning = if gradients.is_empty() { &[][..] } else { &field.turning };
        let expansions = if turning.is_empty() { 1 } else { 2 };
        let bytes = field.around.supports.bytes_of(1) + expansions * size_of::<Expansion>();
        field.around.samples.storage().gone_through(bytes * self.runs.len());
        let is_blend = field.method == Method::BlendedJets;
        if is_blend || !turning.is_empty() {
            self.group_normals(normals);
            let gradient = !figures.is_empty()
                || !gradients.is_empty() && turning.is_empty()
                || !normals.is_empty() && field.limiter.is_needed();
            let blending = Blending {
                supports: &field.around.supports,
                expansions: &field.expansions,
                turning,
                mirrored: field.gradients.mirrored,
                gradient,
            };
            blending.blend(&mut self.grouped);
        }
        if is_blend {
            field.find_within_range(&mut self.grouped);
        } else {
            self.grouped.is_within_range.clear();
        }
        let places_alone = gradients.is_empty() && figures.is_empty() && self.is_finite;
        for run in &self.runs {
            let within = run.grouped().and_then(|places| self.grouped.is_within_range.get(places));
            if places_alone && within.is_some_and(|within| within.iter().all(|is| *is > 0.0)) {
                self.take(run, frame, moved);
            } else if !(places_alone && self.stays(run, field)) {
                self.carry_one_by_one(run, field, frame, positions, moved);
            }
        }
    }

    /// Whether the vertices of a run stay where they are, in all versions: neither their home moves nor the
    /// samples whose supports reach there, and the home is among the samples nearest to each vertex.
    #[inline]
    fn stays(&self, run: &HomeRun, field: &DeformationField<'_>) -> bool {
        if run.place != NOWHERE {
            return false;
        }
        let [x, y, z] = self.local.each_ref().map(|x| &x[run.range()]);
        let places = x.iter().zip(y).zip(z).map(|((x, y), z)| Vec3::new(*x, *y, *z));
        field.keep_home_nearest(run.home as usize, places)
    }

    /// Puts normals that are to be turned beside the vertices' positions.
    fn group_normals(&mut self, normals: &[Vec3]) {
        let Self { grouped, runs, order, .. } = self;
        let length = if normals.is_empty() { 0 } else { grouped.positions[0].len() };
        grouped.normals.iter_mut().for_each(|v| v.resize(length, 0.0));
        if normals.is_empty() {
            return;
        }
        for (run, places) in runs.iter().filter_map(|run| Some((run, run.grouped()?))) {
            let [x, y, z] = grouped.normals.each_mut().map(|v| &mut v[places.clone()]);
            for (((i, x), y), z) in order[run.range()].iter().zip(x).zip(y).zip(z) {
                (*x, *y, *z) = normals[*i as usize].into();
            }
        }
    }

    /// Takes the results of vertices that are nothing but the blend's.
    #[inline]
    fn take(&self, run: &HomeRun, frame: &Frame, moved: &mut Moved<'_>) {
        let places = run.places();
        let vertices = &self.order[run.range()];
        let [x, y, z] = self.grouped.displacement.each_ref().map(|v| &v[places.clone()]);
        for (((i, x), y), z) in vertices.iter().zip(x).zip(y).zip(z) {
            let image = &mut moved.positions[*i as usize];
            // Only the displacement is in single precision.
            image.x += f64::from(*x) * frame.scale;
            image.y += f64::from(*y) * frame.scale;
            image.z += f64::from(*z) * frame.scale;
        }
        if moved.normals.is_empty() {
            return;
        }
        let [x, y, z] = self.grouped.normals.each_ref().map(|v| &v[places.clone()]);
        for (((i, x), y), z) in vertices.iter().zip(x).zip(y).zip(z) {
            let normal = &mut moved.normals[*i as usize];
            if is_finite(normal.as_dvec3()) {
                (normal.x, normal.y, normal.z) = (*x, *y, *z);
            }
        }
    }

    /// Carries vertices of a run over.
    #[inline(never)]
    fn carry_one_by_one(
        &self,
        run: &HomeRun,
        field: &DeformationField<'_>,
        frame: &Frame,
        positions: &[DVec3],
        moved: &mut Moved<'_>,
    ) {
        for (at, within_run) in run.range().zip(0..) {
            let i = self.order[at] as usize;
            if !positions[i].is_finite() {
                moved.figures.get_mut(i).into_iter().for_each(|f| *f = VertexDiagnostics::UNKNOWN);
                continue;
            }
            let local = Vec3::from_array(self.local.each_ref().map(|x| x[at]));
            let place = if run.place == NOWHERE { NOWHERE } else { run.place + within_run };
            self.carry_one(
                BlockVertex { i, home: run.home as usize, local, place: place as usize },
                field,
                frame,
                moved,
            );
        }
    }

    fn carry_one(
        &self,
        vertex: BlockVertex,
        field: &DeformationField<'_>,
        frame: &Frame,
        moved: &mut Moved<'_>,
    ) {
        let Moved { positions: images, normals, gradients, figures } = moved;
        let BlockVertex { i, home, local, place } = vertex;
        let figures = figures.get_mut(i);
        let is_within_range = self.grouped.is_within_range.get(place);
        let one_by_one = if is_within_range.is_some_and(|is| *is > 0.0) {
            // Nothing but the blend.
            None
        } else if field.active[home] {
            self.bounded(field, vertex, self.one_by_one(field, vertex))
        } else {
            let dragged_along = field.still_drawn_back(home, local);
            if dragged_along.is_none() {
                let still = || field.figures(home, local, &Transport::NONE, frame.scale);
                figures.into_iter().for_each(|f| *f = still());
                return;
            }
            dragged_along
        };
        // Only the displacement is in single precision.
        let displacement = one_by_one.map_or_else(|| self.displacement(place), |moved| moved.displacement);
        images[i] += displacement.as_dvec3() * frame.scale;
        if let Some(n) = normals.get_mut(i).filter(|n| n.is_finite()) {
            *n = match one_by_one {
                Some(moved) => moved.normal(*n, field.gradients.mirrored),
                None => Vec3::from_array(self.grouped.normals.each_ref().map(|v| v[place])),
            };
        }
        if figures.is_none() && gradients.is_empty() {
            return;
        }
        let gradient = one_by_one.map_or_else(|| self.gradient(place), |moved| moved.gradient);
        let moved = Transport { displacement, gradient };
        if let Some(to) = gradients.get_mut(i) {
            let turning = !field.turning.is_empty();
            *to = match field.active[home] {
                _ if !turning => gradient,
                true => self.turning(place).unwrap_or(gradient),
                // The vertex alone is drawn along.
                false => Mat3::IDENTITY,
            };
        }
        if let Some(figures) = figures {
            *figures = field.figures(home, local, &moved, frame.scale);
        }
    }

    /// Transport of a vertex of the block, where it is other than the blend's.
    #[inline]
    fn one_by_one(&self, field: &DeformationField<'_>, vertex: BlockVertex) -> Option<Transport> {
        let BlockVertex { home, local: p, place, .. } = vertex;
        let nearer = || if field.reaches(home, p) { None } else { field.by_nearer_ones(home, p) };
        match field.method {
            Method::ProjectedBarycentric => Some(projected_barycentric::carry(field, home, p)),
            Method::BlendedJets if self.grouped.sum[place] < LEAST_WEIGHT => {
                Some(nearer().unwrap_or_else(|| field.beyond(home, p)))
            }
            Method::BlendedJets if field.limiter.concerns(home) => {
                if let Some(moved) = nearer() {
                    return Some(moved);
                }
                let blended =
                    Transport { displacement: self.displacement(place), gradient: self.gradient(place) };
                Some(field.limiter.limited(&field.around.supports, &field.expansions, home, p, blended))
            }
            Method::BlendedJets => nearer(),
        }
    }

    /// The way of a vertex, held within the range of the samples around; nothing where the blend is within.
    #[inline]
    fn bounded(
        &self,
        field: &DeformationField<'_>,
        vertex: BlockVertex,
        one_by_one: Option<Transport>,
    ) -> Option<Transport> {
        let BlockVertex { home, local: p, place, .. } = vertex;
        let u = one_by_one.map_or_else(|| self.displacement(place), |moved| moved.displacement);
        if field.is_bounded(home, p, u) {
            return one_by_one;
        }
        let gradient = || {
            one_by_one.map_or_else(
                || field.blended(field.around.reaching(home), p).1.gradient,
                |moved| moved.gradient,
            )
        };
        field.drawn_back(p, u, gradient).or(one_by_one)
    }

    /// The blend at a place.
    #[inline]
    fn displacement(&self, place: usize) -> Vec3 {
        Vec3::from_array(self.grouped.displacement.each_ref().map(|v| v[place]))
    }

    /// Gradient of the blend; zero, if it was not asked for.
    fn gradient(&self, place: usize) -> Mat3 {
        let entry = |v: &Vec<f32>| v.get(place).copied().unwrap_or_default();
        Mat3::from_cols_array(&self.grouped.gradient.each_ref().map(entry))
    }

    /// The gradient by which numbers turn at a place, if any support reaches it.
    #[inline]
    fn turning(&self, place: usize) -> Option<Mat3> {
        let is_reached = self.grouped.sum.get(place).is_some_and(|sum| *sum > 0.0);
        is_reached.then(|| Mat3::from_cols_array(&self.grouped.turning.each_ref().map(|v| v[place])))
    }

    /// Puts the vertices of each home that moves side by side.
    fn group(&mut self, fields: &[DeformationField<'_>]) {
        let samples = &fields[0].around.samples.positions;
        self.group_of.resize(samples.len(), u32::MAX);
        self.find_runs(|home| fields.iter().any(|field| field.active[home as usize]));
        let Self { local, runs, group_of, filled, grouped, .. } = self;
        let mut end = 0;
        grouped.scattered.clear();
        for ((home, range), filled) in grouped.groups.iter_mut().zip(filled.iter_mut()) {
            let rest = filled.next % PACKET;
            let scattered = if rest <= FEW { rest } else { 0 };
            *range = end..end + filled.next - scattered;
            *filled = GroupFill { next: end, scattered: grouped.scattered.len() };
            grouped.scattered.extend(std::iter::repeat_n(*home, scattered));
            end = range.end.next_multiple_of(PACKET);
        }
        grouped.scattered_at = end;
        let all = end + grouped.scattered.len();
        grouped.positions.iter_mut().for_each(|v| v.resize(all.next_multiple_of(PACKET), 0.0));
        for (home, range) in &grouped.groups {
            // Lanes that are left over are at the home, where they disturb nobody.
            let center = samples[*home as usize];
            let rest = range.end..range.end.next_multiple_of(PACKET);
            (0..3).for_each(|i| grouped.positions[i][rest.clone()].fill(center[i]));
        }
        for at in 0..runs.len() {
            let run = &mut runs[at];
            if run.place == NOWHERE {
                continue;
            }
            let group = group_of[run.home as usize] as usize;
            let filled = &mut filled[group];
            let in_packets = run.count.min((grouped.groups[group].1.end - filled.next) as u32);
            let (first, place) = (run.first + in_packets, (end + filled.scattered) as u32);
            let scattered = HomeRun { first, count: run.count - in_packets, place, ..*run };
            (run.count, run.place) = (in_packets, filled.next as u32);
            filled.next += in_packets as usize;
            filled.scattered += scattered.count as usize;
            grouped.put(run, local);
            if scattered.count > 0 {
                grouped.put(&scattered, local);
                runs.push(scattered);
            }
        }
    }

    /// Finds the runs of vertices that have one home: mostly one follows the other. Counts those of each home
    /// that moves, whose places are not known yet.
    fn find_runs(&mut self, moves: impl Fn(u32) -> bool) {
        let Self { order, homes, runs, group_of, filled, grouped, .. } = self;
        let homes = &homes[..order.len()];
        runs.clear();
        filled.clear();
        grouped.groups.clear();
        let mut first = 0;
        while first < homes.len() {
            let home = homes[first];
            let mut end = first + 1;
            while end < homes.len() && homes[end] == home {
                end += 1;
            }
            let (place, count) = (if moves(home) { 0 } else { NOWHERE }, end - first);
            runs.push(HomeRun { home, first: first as u32, count: count as u32, place });
            first = end;
            if place == NOWHERE {
                continue;
            }
            // A group of an earlier part counts for this part only if it is of the same home.
            let group = &mut group_of[home as usize];
            if grouped.groups.get(*group as usize).is_some_and(|(of, _)| *of == home) {
                filled[*group as usize].next += count;
            } else {
                *group = grouped.groups.len() as u32;
                grouped.groups.push((home, 0..0));
                filled.push(GroupFill { next: count, scattered: 0 });
            }
        }
    }
}

impl Grouped {
    /// Puts the coordinates of a run into its place.
    #[inline]
    fn put(&mut self, run: &HomeRun, local: &[Vec<f32>; 3]) {
        let places = run.places();
        let [from_x, from_y, from_z] = local.each_ref().map(|v| &v[run.range()]);
        let [x, y, z] = self.positions.each_mut().map(|v| &mut v[places.clone()]);
        // One by one, as these are few.
        for at in 0..run.count as usize {
            (x[at], y[at], z[at]) = (from_x[at], from_y[at], from_z[at]);
        }
    }
}

/// A vertex of a block: its number, and the place of the blend for it, if there is one.
#[derive(Clone, Copy)]
struct BlockVertex {
    i: usize,
    home: usize,
    local: Vec3,
    place: usize,
}

/// Local coordinates of a position. A position that is not finite gives any place, whose result is not used.
#[inline]
fn local(frame: &Frame, p: DVec3) -> Vec3 {
    // A sum with zero is never −0.
    if is_finite(p) { frame.to_local(p) + 0.0 } else { Vec3::ZERO }
}

/// Largest number of vertices in a block of these: `in_no_order` where they are in no order.
fn most_of_block(positions: &[DVec3], in_no_order: usize) -> usize {
    if is_in_order(positions) { BLOCK } else { in_no_order.min(positions.len()).max(1) }
}

/// Whether the vertices come in order: most of those looked at are near to the vertex before.
fn is_in_order(positions: &[DVec3]) -> bool {
    let some = || positions.windows(2).step_by(LOOKED_AT);
    let low = some().map(|p| p[0]).fold(DVec3::INFINITY, DVec3::min);
    let high = some().map(|p| p[0]).fold(DVec3::NEG_INFINITY, DVec3::max);
    let far = JUMP * (high - low).max_element();
    JUMPS * some().filter(|p| (p[1] - p[0]).abs().max_element() > far).count() <= some().len()
}

/// Puts the numbers of vertices in an order in which those near to each other are mostly side by side: along
/// a curve of Morton's, unless they are so as they are.
///
/// Memory: 8 bytes for each meanwhile.
fn put_in_order(frame: &Frame, positions: &[DVec3], order: &mut Vec<u32>) {
    order.clear();
    order.extend(0..positions.len() as u32);
    if is_in_order(positions) {
        return;
    }
    let local = || positions.iter().map(|p| local(frame, *p));
    let low = local().fold(Vec3::INFINITY, Vec3::min);
    let high = local().fold(Vec3::NEG_INFINITY, Vec3::max);
    let size = (high - low).max_element();
    let steps = (1 << MORTON_BITS) as f32 * 0.999 / size;
    let key = |p: Vec3| u64::from(morton(((p - low) * steps).as_uvec3())) << 32;
    let mut keys: Vec<u64> = local().zip(0u64..).map(|(p, i)| key(p) | i).collect();
    keys.sort_unstable();
    order.iter_mut().zip(keys).for_each(|(to, key)| *to = key as u32);
}

/// The bits of three coordinates in turn.
fn morton(at: UVec3) -> u32 {
    let spread = |x: u32| {
        let x = (x | x << 16) & 0x0300_00ff;
        let x = (x | x << 8) & 0x0300_f00f;
        let x = (x | x << 4) & 0x030c_30c3;
        (x | x << 2) & 0x0924_9249
    };
    spread(at.x) | spread(at.y) << 1 | spread(at.z) << 2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_runs_are_in_no_order() {
        let place = |i: usize| DVec3::new((i / 128) as f64, (i % 128) as f64, 0.0);
        let rows: Vec<DVec3> = (0..BLOCK).map(place).collect();
        assert!(is_in_order(&rows));
        for length in [1, 2, 3, 4, 8, 16] {
            let runs = BLOCK / length;
            // Each run once: a prime that divides none of their numbers.
            let of = |i: usize| (i / length * 3571 % runs) * length + i % length;
            let scattered: Vec<DVec3> = (0..runs * length).map(|i| rows[of(i)]).collect();
            assert!(!is_in_order(&scattered), "runs of {length}");
        }
    }
}
