//! Messages between the program and a plugin's process: requests and replies over a socket, arrays in shared
//! memory.

use super::arena::ArenaRange;
use crate::deformer::{About, OwnHandles};
use crate::params::is_text;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use simod_plugin_api::{
    Affine, Attribute, AttributeKind, Attributes, DeformInput, Effort, ErrorCode, Graph, HandleDesc,
    HandleMotions, Joint, Joints, ModelFrame, OtherModel, OtherModels, Param, ParamKind, Part, PluginError,
    PointsKind, PrepareInput, Region, RestPositions, Role, Samples, Setting, Stroke, Strokes, Time,
    Triangles,
};
use std::io::{Error, Read, Result, Write};

/// A frame that is longer is a mistake, not a message.
const LONGEST: u32 = 1 << 28;

/// Request of the program.
#[derive(Serialize, Deserialize)]
pub(super) enum Request {
    /// Loads the library: the first request. Nothing of the library runs before, so that this process is
    /// ready for any behaviour of the library: by then it is set up to end with the program.
    Load,
    Prepare(InputRecord),
    NewScratch,
    /// `fill` is what `out` is filled with before.
    Deform {
        state: u64,
        scratch: u64,
        motion: MotionRecord,
        out: Slice,
        fill: [f32; 3],
    },
    Evaluate {
        state: u64,
        motion: MotionRecord,
        points: Slice,
    },
    Handles(InputRecord),
    /// Version of settings, and the settings to be brought up to date.
    Migrate(u32, Vec<SettingRecord>),
    IsIdentity {
        bounds: [[f64; 3]; 2],
        motion: MotionRecord,
    },
    DropState(u64),
    DropScratch(u64),
}

/// Reply of the plugin's process: one for each request but the drops, after any number of log lines; and one
/// [`Loaded`](Self::Loaded) before all others.
#[derive(Serialize, Deserialize)]
pub(super) enum Reply {
    Loaded(std::result::Result<Box<About>, LibraryRefusal>),
    Log {
        level: u32,
        text: String,
    },
    /// Number of the state or scratch that was made.
    Made(std::result::Result<u64, PluginFailure>),
    Done(std::result::Result<(), PluginFailure>),
    Handles(std::result::Result<HandlesRecord, PluginFailure>),
    Identity(std::result::Result<bool, PluginFailure>),
    Settings(std::result::Result<Vec<SettingRecord>, PluginFailure>),
}

/// A [`Setting`].
#[derive(Serialize, Deserialize)]
pub(super) struct SettingRecord {
    id: String,
    kind: u32,
    numbers: Vec<f64>,
    text: String,
}

impl From<Setting> for SettingRecord {
    fn from(s: Setting) -> Self {
        Self { id: s.id.into(), kind: s.kind.0, numbers: s.numbers.into(), text: s.text.into() }
    }
}

impl From<SettingRecord> for Setting {
    fn from(r: SettingRecord) -> Self {
        let (id, numbers, text) = (r.id.into(), r.numbers.into(), r.text.into());
        Self { id, kind: ParamKind(r.kind), numbers, text }
    }
}

/// Reason for which a library is not used.
#[derive(Serialize, Deserialize)]
pub(super) struct LibraryRefusal {
    pub what: String,
    pub hint: String,
}

/// A [`PluginError`].
#[derive(Serialize, Deserialize)]
pub(super) struct PluginFailure {
    code: u32,
    message: String,
    hint: String,
}

impl From<PluginError> for PluginFailure {
    fn from(e: PluginError) -> Self {
        Self { code: e.code.0, message: e.message.into(), hint: e.hint.into() }
    }
}

impl From<PluginFailure> for PluginError {
    fn from(f: PluginFailure) -> Self {
        Self::new(ErrorCode(f.code), f.message).hint(f.hint)
    }
}

/// The handles that a plugin places.
#[derive(Serialize, Deserialize)]
pub(super) struct HandlesRecord {
    descs: Vec<HandleRecord>,
    faces: Vec<Vec<u32>>,
}

impl From<OwnHandles> for HandlesRecord {
    fn from(OwnHandles { descs, faces }: OwnHandles) -> Self {
        Self { descs: descs.into_iter().map(HandleRecord::from).collect(), faces }
    }
}

impl From<HandlesRecord> for OwnHandles {
    fn from(HandlesRecord { descs, faces }: HandlesRecord) -> Self {
        Self { descs: descs.into_iter().map(HandleDesc::from).collect(), faces }
    }
}

/// A [`HandleDesc`].
#[derive(Serialize, Deserialize)]
struct HandleRecord {
    id: String,
    name: String,
    position: [f64; 3],
    gizmo: u32,
    parent: u32,
}

impl From<HandleDesc> for HandleRecord {
    fn from(h: HandleDesc) -> Self {
        let (id, name) = (h.id.into(), h.name.into());
        Self { id, name, position: h.position, gizmo: h.gizmo.0, parent: h.parent }
    }
}

impl From<HandleRecord> for HandleDesc {
    fn from(h: HandleRecord) -> Self {
        let desc = Self::new(&h.id, h.position).name(&h.name).parent(h.parent);
        desc.gizmo(simod_plugin_api::Gizmo(h.gizmo))
    }
}

/// An array in shared memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Slice {
    pub range: ArenaRange,
    /// Bytes that are used of the range.
    pub len: u64,
}

/// A [`PrepareInput`]: its arrays are one after the other in a range of the shared memory.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct InputRecord {
    pub range: ArenaRange,
    count: usize,
    normals: bool,
    spacing: bool,
    /// Names and kinds.
    attributes: Option<Vec<(String, u32)>>,
    roles: Vec<u32>,
    triangles: Option<usize>,
    /// Number of all neighbours.
    graph: Option<usize>,
    rest: bool,
    bounds: [[f64; 3]; 2],
    params: Vec<ParamRecord>,
    joints: Option<Vec<(String, [f64; 3], u32)>>,
    /// Origin and scale.
    frame: Option<([f64; 3], f64)>,
    others: Vec<OtherRecord>,
}

/// An [`OtherModel`], whose arrays come after those of the input.
#[derive(Clone, Serialize, Deserialize)]
struct OtherRecord {
    param: String,
    kind: u32,
    vertices: u64,
    points: usize,
    ids: usize,
    triangles: usize,
}

impl OtherRecord {
    fn new<'a>(model: &OtherModel<'a>, arrays: &mut Vec<&'a [u8]>) -> Self {
        arrays.push(bytemuck::cast_slice(model.positions()));
        arrays.push(bytemuck::cast_slice(model.normals()));
        arrays.push(bytemuck::cast_slice(model.ids()));
        arrays.push(bytemuck::cast_slice(model.triangles()));
        Self {
            param: model.param().to_owned(),
            kind: model.kind.0,
            vertices: model.vertices,
            points: model.positions().len(),
            ids: model.ids().len(),
            triangles: model.triangles().len(),
        }
    }

    fn take<'a>(&self, rest: &mut Arrays<'a>) -> Option<OtherArrays<'a>> {
        Some(OtherArrays {
            positions: rest.take_copy(self.points)?,
            normals: rest.take(self.points)?,
            ids: rest.take_copy(self.ids)?,
            triangles: rest.take(self.triangles)?,
        })
    }
}

/// The arrays of an [`OtherModel`]; those of eight bytes a number are copied, as they may not be aligned.
struct OtherArrays<'a> {
    positions: Vec<[f64; 3]>,
    normals: &'a [[f32; 3]],
    ids: Vec<u64>,
    triangles: &'a [[u32; 3]],
}

impl OtherArrays<'_> {
    fn view<'a>(&'a self, of: &'a OtherRecord) -> OtherModel<'a> {
        let Self { positions, normals, ids, triangles } = self;
        OtherModel::new((&of.param, PointsKind(of.kind), of.vertices), positions, normals, ids, triangles)
    }
}

impl InputRecord {
    /// The record of an input whose arrays go to `range`; and the arrays, in their order.
    pub fn new<'a>(input: &PrepareInput<'a>) -> (Self, Vec<&'a [u8]>) {
        let samples = input.samples;
        let mut arrays: Vec<&[u8]> = vec![
            bytemuck::cast_slice(samples.positions()),
            bytemuck::cast_slice(samples.normals()),
            bytemuck::cast_slice(samples.spacing()),
        ];
        arrays.extend(input.attributes().iter().map(|a| bytemuck::cast_slice(a.values())));
        arrays.extend(input.regions().iter().map(|r| bytemuck::cast_slice(r.weights())));
        let triangles = input.triangles().map(Triangles::indices);
        arrays.extend(triangles.map(bytemuck::cast_slice));
        let graph = input.graph();
        if let Some(graph) = graph {
            arrays.push(bytemuck::cast_slice(graph.starts()));
            arrays.push(bytemuck::cast_slice(graph.all()));
        }
        arrays.extend(input.rest_positions().map(bytemuck::cast_slice));
        let others = input.part().map_or(&[][..], OtherModels::all);
        let others = others.iter().map(|model| OtherRecord::new(model, &mut arrays)).collect();
        let attribute = |a: &Attribute<'_>| (a.name().to_owned(), a.kind.0);
        let joint = |j: &Joint<'_>| (j.id().to_owned(), j.position, j.parent);
        let record = Self {
            range: ArenaRange { offset: 0, len: 0 },
            count: samples.positions().len(),
            normals: !samples.normals().is_empty(),
            spacing: !samples.spacing().is_empty(),
            attributes: input.part::<Attributes<'_>>().map(|a| a.all().iter().map(attribute).collect()),
            roles: input.regions().iter().map(|r| r.role.0).collect(),
            triangles: triangles.map(<[_]>::len),
            graph: graph.map(|g| g.all().len()),
            rest: input.rest_positions().is_some(),
            bounds: [input.bounds.min, input.bounds.max],
            params: input.params().iter().map(ParamRecord::from).collect(),
            joints: input.part::<Joints<'_>>().map(|j| j.all().iter().map(joint).collect()),
            frame: input.frame().map(|f| (f.origin, f.scale)),
            others,
        };
        (record, arrays)
    }

    /// Calls with the input, whose arrays are in `bytes`. `None` if these are too few.
    pub fn with<T>(&self, bytes: &[u8], call: impl FnOnce(&PrepareInput<'_>) -> T) -> Option<T> {
        let mut arrays = Arrays(bytes);
        let rest = &mut arrays;
        let samples = self.take_samples(rest)?;
        let attributes = self.take_attributes(rest)?;
        let weights: Vec<&[f32]> = self.roles.iter().map(|_| rest.take(self.count)).collect::<Option<_>>()?;
        let regions: Vec<Region<'_>> =
            self.roles.iter().zip(weights).map(|(role, w)| Region::new(Role(*role), w)).collect();
        let triangles = match self.triangles {
            Some(count) => Some(Triangles::new(rest.take(count)?)),
            None => None,
        };
        let graph = match self.graph {
            Some(all) => Some(Graph::new(rest.take(self.count + 1)?, rest.take(all)?)),
            None => None,
        };
        let at_rest = if self.rest { Some(RestPositions::new(rest.take(self.count)?)) } else { None };
        let their_arrays: Vec<OtherArrays<'_>> =
            self.others.iter().map(|of| of.take(rest)).collect::<Option<_>>()?;
        let others: Vec<OtherModel<'_>> =
            their_arrays.iter().zip(&self.others).map(|(arrays, of)| arrays.view(of)).collect();
        let others = OtherModels::new(&others);
        let params: Vec<Param<'_>> = self.params.iter().map(ParamRecord::view).collect();
        let joints: Option<Vec<Joint<'_>>> = self
            .joints
            .as_ref()
            .map(|joints| joints.iter().map(|(id, at, parent)| Joint::new(id, *at, *parent)).collect());
        let joints = joints.as_ref().map(|joints| Joints::new(joints));
        let mut parts: Vec<Part<'_>> = graph.iter().map(Part::new).collect();
        parts.extend(triangles.iter().map(Part::new));
        parts.extend(at_rest.iter().map(Part::new));
        if !others.all().is_empty() {
            parts.push(Part::new(&others));
        }
        parts.extend(joints.iter().map(Part::new));
        let frame = self.frame.map(|(origin, scale)| ModelFrame { origin, scale });
        parts.extend(frame.iter().map(Part::new));
        let attributes = attributes.as_deref().map(Attributes::new);
        parts.extend(attributes.iter().map(Part::new));
        Some(call(&PrepareInput::new(samples, bounds(self.bounds), &regions, &params).with_parts(&parts)))
    }

    /// Input of a deformation: the samples, of whose arrays nothing is copied, and their attributes, where
    /// they are asked for.
    pub fn samples<'a>(&'a self, bytes: &'a [u8]) -> Option<(Samples<'a>, Option<Vec<Attribute<'a>>>)> {
        let mut arrays = Arrays(bytes);
        Some((self.take_samples(&mut arrays)?, self.take_attributes(&mut arrays)?))
    }

    fn take_attributes<'a>(&'a self, rest: &mut Arrays<'a>) -> Option<Option<Vec<Attribute<'a>>>> {
        let Some(attributes) = &self.attributes else { return Some(None) };
        let mut one = |(name, kind): &'a (String, u32)| {
            Some(Attribute::new(name, AttributeKind(*kind), rest.take(self.count)?))
        };
        attributes.iter().map(&mut one).collect::<Option<_>>().map(Some)
    }

    fn take_samples<'a>(&self, rest: &mut Arrays<'a>) -> Option<Samples<'a>> {
        let optional = |there: bool| if there { self.count } else { 0 };
        Some(Samples::new(
            rest.take(self.count)?,
            rest.take(optional(self.normals))?,
            rest.take(optional(self.spacing))?,
        ))
    }

    /// The model's box.
    pub fn bounds(&self) -> simod_plugin_api::Bounds {
        bounds(self.bounds)
    }
}

fn bounds([min, max]: [[f64; 3]; 2]) -> simod_plugin_api::Bounds {
    simod_plugin_api::Bounds { min, max }
}

/// Arrays one after the other.
struct Arrays<'a>(&'a [u8]);

impl<'a> Arrays<'a> {
    /// A copy of `count` values, which may begin at any byte.
    fn take_copy<T: bytemuck::Pod>(&mut self, count: usize) -> Option<Vec<T>> {
        let bytes: &[u8] = self.take(count.checked_mul(size_of::<T>())?)?;
        Some(bytemuck::pod_collect_to_vec(bytes))
    }

    fn take<T: bytemuck::Pod>(&mut self, count: usize) -> Option<&'a [T]> {
        let (taken, rest) = self.0.split_at_checked(count.checked_mul(size_of::<T>())?)?;
        self.0 = rest;
        bytemuck::try_cast_slice(taken).ok()
    }
}

/// A [`Param`].
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct ParamRecord {
    id: String,
    kind: u32,
    numbers: Vec<f64>,
    text: String,
}

impl From<&Param<'_>> for ParamRecord {
    fn from(p: &Param<'_>) -> Self {
        let (id, text) = (p.id().to_owned(), p.as_text().to_owned());
        Self { id, kind: p.kind().0, numbers: p.as_numbers().to_vec(), text }
    }
}

impl ParamRecord {
    fn view(&self) -> Param<'_> {
        let kind = ParamKind(self.kind);
        if is_text(kind) {
            Param::text(&self.id, kind, &self.text)
        } else {
            Param::numbers(&self.id, kind, &self.numbers)
        }
    }
}

/// Content of a [`DeformInput`] beside the samples and the box, which are the state's.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct MotionRecord {
    transforms: Vec<[[f64; 4]; 3]>,
    params: Vec<ParamRecord>,
    handles: Option<Vec<[[f64; 4]; 3]>>,
    strokes: Option<Vec<StrokeRecord>>,
    effort: Option<u32>,
    time: Option<(i64, f64)>,
}

#[derive(Clone, Serialize, Deserialize)]
struct StrokeRecord {
    key: u64,
    radius: f64,
    strength: f64,
    points: Vec<[f64; 3]>,
    pressures: Vec<f32>,
    params: Vec<ParamRecord>,
}

impl MotionRecord {
    pub fn new(input: &DeformInput<'_>) -> Self {
        let rows = |maps: &[Affine]| maps.iter().map(|a| a.rows).collect();
        let records = |params: simod_plugin_api::Params<'_>| params.iter().map(ParamRecord::from).collect();
        let stroke = |s: &Stroke<'_>| StrokeRecord {
            key: s.key,
            radius: s.radius,
            strength: s.strength,
            points: s.points().to_vec(),
            pressures: s.pressures().to_vec(),
            params: records(s.params()),
        };
        Self {
            transforms: rows(input.transforms()),
            params: records(input.params()),
            handles: input.part::<HandleMotions<'_>>().map(|h| rows(h.all())),
            strokes: input.part::<Strokes<'_>>().map(|s| s.all().iter().map(stroke).collect()),
            effort: input.part::<Effort>().map(|e| e.0),
            time: input.part::<Time>().map(|t| (t.frame, t.seconds)),
        }
    }

    /// Calls with the input of a deformation of these samples, with these attributes.
    pub fn with<T>(
        &self,
        samples: Samples<'_>,
        attributes: Option<Vec<Attribute<'_>>>,
        bounds: simod_plugin_api::Bounds,
        call: impl FnOnce(&DeformInput<'_>) -> T,
    ) -> T {
        let affine = |rows: &Vec<[[f64; 4]; 3]>| -> Vec<Affine> {
            rows.iter().map(|rows| Affine { rows: *rows }).collect()
        };
        let transforms = affine(&self.transforms);
        let params: Vec<Param<'_>> = self.params.iter().map(ParamRecord::view).collect();
        let handles = self.handles.as_ref().map(affine);
        let handles = handles.as_ref().map(|all| HandleMotions::new(all));
        let records = self.strokes.as_deref().unwrap_or_default();
        let values: Vec<Vec<Param<'_>>> =
            records.iter().map(|s| s.params.iter().map(ParamRecord::view).collect()).collect();
        let strokes: Vec<Stroke<'_>> = records
            .iter()
            .zip(&values)
            .map(|(s, params)| Stroke::new(s.key, s.radius, s.strength, &s.points, &s.pressures, params))
            .collect();
        let strokes = self.strokes.is_some().then(|| Strokes::new(&strokes));
        let mut parts: Vec<Part<'_>> = handles.iter().map(Part::new).collect();
        parts.extend(strokes.iter().map(Part::new));
        let effort = self.effort.map(Effort);
        parts.extend(effort.iter().map(Part::new));
        let time = self.time.map(|(frame, seconds)| Time { frame, seconds });
        parts.extend(time.iter().map(Part::new));
        let attributes = attributes.as_deref().map(Attributes::new);
        parts.extend(attributes.iter().map(Part::new));
        call(&DeformInput::new(samples, bounds, &transforms, &params).with_parts(&parts))
    }
}

/// Writes a message.
pub(super) fn send(to: &mut impl Write, message: &impl Serialize) -> Result<()> {
    let bytes = postcard::to_stdvec(message).map_err(Error::other)?;
    let len = u32::try_from(bytes.len()).ok().filter(|len| *len <= LONGEST);
    let len = len.ok_or_else(|| Error::other("a message is too long"))?;
    to.write_all(&[&len.to_le_bytes()[..], &bytes].concat())?;
    to.flush()
}

/// Reads a message; nothing where the other side has ended.
pub(super) fn receive<T: DeserializeOwned>(from: &mut impl Read) -> Result<Option<T>> {
    let mut len = [0; 4];
    match from.read_exact(&mut len) {
        Err(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => return Ok(None),
        read => read?,
    }
    let len = u32::from_le_bytes(len);
    if len > LONGEST {
        return Err(Error::other("a message is too long"));
    }
    let mut bytes = vec![0; len as usize];
    from.read_exact(&mut bytes)?;
    postcard::from_bytes(&bytes).map(Some).map_err(Error::other)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deformer::Capabilities;
    use proptest::prelude::*;
    use simod_plugin_api::Descriptor;
    use simod_tests::damage::{damage, damaged, runner};

    /// Replies of a plugin's process may be any bytes: they give an error or a message, no panic, and take no
    /// memory for what is not there.
    #[test]
    fn damaged_messages_do_no_harm() {
        let (descriptor, capabilities) = (Descriptor::new("x", "X", "1.0.0"), Capabilities::default());
        let about = About { descriptor, capabilities, migration: None };
        let failure = || PluginFailure { code: 1, message: "what".to_owned(), hint: "why".to_owned() };
        let setting =
            SettingRecord { id: "a".to_owned(), kind: 1, numbers: vec![1.0; 9], text: String::new() };
        let descs = [0, 1, 2].map(|i| HandleDesc::new(&format!("{i},3"), [1.0, 2.0, 3.0])).to_vec();
        let handles = OwnHandles { descs, faces: vec![vec![0, 1, 2]] };
        let replies = [
            Reply::Loaded(Ok(Box::new(about))),
            Reply::Log { level: 2, text: "a line".to_owned() },
            Reply::Made(Ok(7)),
            Reply::Done(Err(failure())),
            Reply::Handles(Ok(handles.into())),
            Reply::Settings(Ok(vec![setting])),
        ];
        let good = replies.map(|reply| {
            let mut bytes = Vec::new();
            send(&mut bytes, &reply).expect("a message");
            bytes
        });
        let all = (prop::collection::vec(damage(), 1..4), 0..good.len());
        let tested = runner(1000).run(&all, |(all, which)| {
            let bytes = damaged(&good[which], good[which].len(), &all);
            // A plugin has the whole length to lie in, as far as a message may be long: `receive` makes room
            // for it.
            let short = bytes.get(..4).is_some_and(|len| len[3] == 0 && len[2] < 16);
            if short && let Ok(Some(Reply::Handles(Ok(handles)))) = receive::<Reply>(&mut &bytes[..]) {
                drop(crate::deformer::check_handles(&handles.into()));
            }
            Ok(())
        });
        tested.expect("no panic");
    }
}
