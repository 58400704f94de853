//! Inputs of a C plugin, in C's words: borrowed as they are, but for texts, which need an end.

use simod_plugin_api::c::{
    SimodAffine, SimodAttribute, SimodAttributes, SimodBounds, SimodDeformInput, SimodEffort, SimodGraph,
    SimodHandleMotions, SimodJoint, SimodJoints, SimodModelFrame, SimodOtherModel, SimodOtherModels,
    SimodParam, SimodPart, SimodPrepareInput, SimodRegion, SimodRestPositions, SimodSamples, SimodStroke,
    SimodStrokes, SimodTime, SimodTriangles,
};
use simod_plugin_api::{
    Affine, Attribute, Attributes, Bounds, DeformInput, Effort, Joint, OtherModel, OtherModels, Params,
    PluginError, PluginResult, PrepareInput, Samples, Setting, Stroke, Time,
};
use std::ffi::{CStr, CString, c_void};
use std::ptr::null;

/// The start of a list; NULL if there is nothing in it.
fn start<T>(list: &[T]) -> *const T {
    if list.is_empty() { null() } else { list.as_ptr() }
}

fn samples(samples: &Samples<'_>) -> SimodSamples {
    SimodSamples {
        count: samples.positions().len(),
        positions: start(samples.positions()),
        normals: start(samples.normals()),
        spacing: start(samples.spacing()),
    }
}

fn bounds(bounds: &Bounds) -> SimodBounds {
    SimodBounds { min: bounds.min, max: bounds.max }
}

/// Affine maps are laid out alike.
fn affine(maps: &[Affine]) -> *const SimodAffine {
    const { assert!(size_of::<Affine>() == size_of::<SimodAffine>()) };
    start(maps).cast()
}

fn c_text(text: &str) -> PluginResult<CString> {
    CString::new(text).map_err(|_| PluginError::input(format!("there is a zero in the text `{text}`")))
}

/// Parameters' ids and texts, with an end.
struct Texts(Vec<(CString, CString)>);

impl Texts {
    fn gather(params: Params<'_>) -> PluginResult<Self> {
        params
            .iter()
            .map(|p| Ok((c_text(p.id())?, c_text(p.as_text())?)))
            .collect::<PluginResult<_>>()
            .map(Self)
    }

    /// Returns the parameters as C has them; they point to the texts of `self`.
    fn params(&self, params: Params<'_>) -> Vec<SimodParam> {
        let params = params.iter().zip(&self.0).map(|(p, (id, text))| SimodParam {
            id: id.as_ptr(),
            kind: p.kind().0,
            numbers: start(p.as_numbers()),
            count: p.as_numbers().len(),
            text: text.as_ptr(),
        });
        params.collect()
    }
}

/// Calls with settings of a session, which live during the call.
pub(super) fn with_settings<T>(
    settings: &[Setting],
    call: impl FnOnce(*const SimodParam, usize) -> T,
) -> PluginResult<T> {
    let texts = settings.iter().map(|s| Ok((c_text(&s.id)?, c_text(&s.text)?)));
    let texts = texts.collect::<PluginResult<Vec<_>>>()?;
    let settings = settings.iter().zip(&texts).map(|(s, (id, text))| SimodParam {
        id: id.as_ptr(),
        kind: s.kind.0,
        numbers: start(&s.numbers),
        count: s.numbers.len(),
        text: text.as_ptr(),
    });
    let settings: Vec<SimodParam> = settings.collect();
    Ok(call(start(&settings), settings.len()))
}

/// An input that is known by an id.
fn part<T>(id: &'static CStr, data: &T) -> SimodPart {
    SimodPart { id: id.as_ptr(), data: std::ptr::from_ref(data).cast::<c_void>() }
}

/// Attributes of the samples, whose names have an end.
struct NamedAttributes(Vec<CString>, Vec<SimodAttribute>);

impl NamedAttributes {
    fn gather(attributes: Option<&Attributes<'_>>) -> PluginResult<Option<Self>> {
        let Some(all) = attributes.map(Attributes::all) else { return Ok(None) };
        let names: Vec<CString> = all.iter().map(|a| c_text(a.name())).collect::<PluginResult<_>>()?;
        let attribute = |(a, name): (&Attribute<'_>, &CString)| SimodAttribute {
            name: name.as_ptr(),
            kind: a.kind.0,
            values: start(a.values()),
        };
        let attributes = all.iter().zip(&names).map(attribute).collect();
        Ok(Some(Self(names, attributes)))
    }

    /// Returns the attributes as an input of C's; it points to the names of `self`.
    fn input(&self) -> SimodAttributes {
        SimodAttributes { attributes: start(&self.1), count: self.0.len() }
    }
}

/// Another model; `param` is its parameter's id, with an end.
fn other_model((model, param): (&OtherModel<'_>, &CString)) -> SimodOtherModel {
    SimodOtherModel {
        param: param.as_ptr(),
        kind: model.kind.0,
        vertices: model.vertices,
        count: model.positions().len(),
        positions: start(model.positions()),
        normals: start(model.normals()),
        ids: start(model.ids()),
        triangles: start(model.triangles()),
        triangle_count: model.triangles().len(),
    }
}

/// Calls with the input of a preparation, which lives during the call.
pub(super) fn with_prepare_input<T>(
    input: &PrepareInput<'_>,
    call: impl FnOnce(*const SimodPrepareInput) -> T,
) -> PluginResult<T> {
    let texts = Texts::gather(input.params())?;
    let params = texts.params(input.params());
    let regions = input.regions().iter().map(|r| SimodRegion { role: r.role.0, weights: start(r.weights()) });
    let regions: Vec<_> = regions.collect();

    let triangles = input.triangles().map(|t| t.indices());
    let triangles = triangles.map(|t| SimodTriangles { indices: start(t), count: t.len() });
    let graph = input.graph().map(|g| SimodGraph { starts: start(g.starts()), neighbours: start(g.all()) });
    let frame = input.frame().map(|f| SimodModelFrame { origin: f.origin, scale: f.scale });
    let ids: Vec<CString> = input.joints().iter().map(|j| c_text(j.id())).collect::<PluginResult<_>>()?;
    let joint = |(j, id): (&Joint<'_>, &CString)| SimodJoint {
        id: id.as_ptr(),
        position: j.position,
        parent: j.parent,
    };
    let joints: Vec<SimodJoint> = input.joints().iter().zip(&ids).map(joint).collect();
    let joints = SimodJoints { joints: start(&joints), count: joints.len() };

    let mut parts = Vec::new();
    parts.extend(triangles.as_ref().map(|t| part(c"simod.triangles/1", t)));
    parts.extend(graph.as_ref().map(|g| part(c"simod.graph/1", g)));
    parts.extend(frame.as_ref().map(|f| part(c"simod.model-frame/1", f)));
    let rest = input.rest_positions().map(|p| SimodRestPositions { positions: start(p) });
    parts.extend(rest.as_ref().map(|r| part(c"simod.rest-positions/1", r)));
    let attributes = NamedAttributes::gather(input.part())?;
    let attributes = attributes.as_ref().map(NamedAttributes::input);
    parts.extend(attributes.as_ref().map(|a| part(c"simod.attributes/1", a)));
    parts.extend((joints.count > 0).then(|| part(c"simod.joints/1", &joints)));
    let others = input.part().map_or(&[][..], OtherModels::all);
    let named: Vec<CString> = others.iter().map(|m| c_text(m.param())).collect::<PluginResult<_>>()?;
    let others: Vec<SimodOtherModel> = others.iter().zip(&named).map(other_model).collect();
    let others = SimodOtherModels { models: start(&others), count: others.len() };
    parts.extend((others.count > 0).then(|| part(c"simod.other-models/1", &others)));
    let input = SimodPrepareInput {
        samples: samples(&input.samples),
        bounds: bounds(&input.bounds),
        regions: start(&regions),
        region_count: regions.len(),
        params: start(&params),
        param_count: params.len(),
        parts: start(&parts),
        part_count: parts.len(),
    };
    Ok(call(&input))
}

/// Calls with the input of a deformation, which lives during the call.
pub(super) fn with_deform_input<T>(
    input: &DeformInput<'_>,
    call: impl FnOnce(*const SimodDeformInput) -> T,
) -> PluginResult<T> {
    let texts = Texts::gather(input.params())?;
    let params = texts.params(input.params());
    let motions = input.handle_motions();
    let motions = SimodHandleMotions { motions: affine(motions), count: motions.len() };
    let stroke_texts: Vec<Texts> =
        input.strokes().iter().map(|s| Texts::gather(s.params())).collect::<PluginResult<_>>()?;
    let stroke_params = input.strokes().iter().zip(&stroke_texts).map(|(s, texts)| texts.params(s.params()));
    let stroke_params: Vec<Vec<SimodParam>> = stroke_params.collect();
    let stroke = |(s, params): (&Stroke<'_>, &Vec<SimodParam>)| SimodStroke {
        key: s.key,
        radius: s.radius,
        strength: s.strength,
        points: start(s.points()),
        point_count: s.points().len(),
        pressures: start(s.pressures()),
        params: start(params),
        param_count: params.len(),
    };
    let strokes: Vec<SimodStroke> = input.strokes().iter().zip(&stroke_params).map(stroke).collect();
    let strokes = SimodStrokes { strokes: start(&strokes), count: strokes.len() };
    let effort = input.part::<Effort>().map(|e| SimodEffort { effort: e.0 });

    let mut parts = Vec::new();
    parts.extend((motions.count > 0).then(|| part(c"simod.handle-motions/1", &motions)));
    parts.extend((strokes.count > 0).then(|| part(c"simod.strokes/1", &strokes)));
    parts.extend(effort.as_ref().map(|e| part(c"simod.effort/1", e)));
    let time = input.part::<Time>().map(|t| SimodTime { frame: t.frame, seconds: t.seconds });
    parts.extend(time.as_ref().map(|t| part(c"simod.time/1", t)));
    let attributes = NamedAttributes::gather(input.part())?;
    let attributes = attributes.as_ref().map(NamedAttributes::input);
    parts.extend(attributes.as_ref().map(|a| part(c"simod.attributes/1", a)));
    let input = SimodDeformInput {
        samples: samples(&input.samples),
        bounds: bounds(&input.bounds),
        transforms: affine(input.transforms()),
        transform_count: input.transforms().len(),
        params: start(&params),
        param_count: params.len(),
        parts: start(&parts),
        part_count: parts.len(),
    };
    Ok(call(&input))
}
