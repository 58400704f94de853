//! The interface's shape, written down: it cannot change unnoticed.
//!
//! A plugin and a host that were built with different shapes of one version would be refused only when they
//! meet, on a user's machine. `shape.txt` has every type that crosses the boundary. After a wanted change
//! raise the minor version of this crate (until the first release: not needed), and write the file anew with
//! `SIMOD_WRITE_SHAPE=1 cargo test`.

use std::collections::BTreeMap;
use std::path::Path;

use abi_stable::StableAbi;
use abi_stable::type_layout::{TLField, TypeLayout};
use simod_plugin_api::{
    Attributes, Effort, EvaluateExtension, Graph, HandleFacesExtension, HandleMotions, HandlesExtension,
    IsIdentityExtension, Joints, MigrationExtension, ModelFrame, NearestService, OtherModels, PluginModRef,
    RestPositions, Strokes, SurfaceService, Time, Triangles,
};

/// Each type of ours by name: its size and alignment (on 64 bits), and its fields in order.
type Shape = BTreeMap<String, String>;

/// The fields of a type, and the types that it is generic over.
fn fields(layout: &'static TypeLayout) -> Vec<TLField> {
    let fields = layout.get_fields().into_iter().flat_map(|fields| fields.iter());
    fields.chain(layout.phantom_fields().iter()).collect()
}

fn is_ours(layout: &TypeLayout) -> bool {
    layout.package().as_str() == env!("CARGO_PKG_NAME")
}

/// A type's name, and for one of abi_stable or of the language what it is made of, as far as that tells
/// anything.
fn name(layout: &'static TypeLayout, depth: usize) -> String {
    let name = layout.full_type().to_string();
    let is_known =
        |name: &str| ["RString", "RStr<", "PhantomData", "PrefixRef<"].iter().any(|k| name.starts_with(k));
    if is_ours(layout) || is_known(&name) || depth == 0 {
        return name;
    }
    let parts = fields(layout).into_iter().map(|field| crate::name(field.layout(), depth - 1));
    let parts: Vec<String> = parts.filter(|part| !part.starts_with("PhantomData")).collect();
    if parts.is_empty() { name } else { format!("{name} {{ {} }}", parts.join(", ")) }
}

fn describe(layout: &'static TypeLayout, shape: &mut Shape) {
    let key = name(layout, 4);
    if shape.contains_key(&key) {
        return;
    }
    let mut text = format!("{} bytes, aligned to {}\n", layout.size(), layout.alignment());
    let mut others = Vec::new();
    for field in fields(layout) {
        let mut types = Vec::new();
        for function in field.function_range().iter() {
            others.extend(function.param_type_layouts.iter().map(|layout| layout()));
            let parameters = function.param_type_layouts.iter().map(|layout| name(layout(), 4));
            let returned = function.return_type_layout().map_or("()".to_owned(), |layout| {
                others.push(layout());
                name(layout(), 4)
            });
            types.push(format!("fn({}) -> {returned}", parameters.collect::<Vec<_>>().join(", ")));
        }
        if types.is_empty() {
            types.push(name(field.layout(), 4));
        }
        text.push_str(&format!("    {}: {}\n", field.name(), types.join(", ")));
        others.push(field.layout());
    }
    shape.insert(key, if is_ours(layout) { text } else { String::new() });
    others.into_iter().for_each(|layout| describe(layout, shape));
}

#[test]
#[cfg(target_pointer_width = "64")]
fn the_shape_changes_with_the_version_alone() {
    let mut shape = Shape::new();
    describe(PluginModRef::LAYOUT, &mut shape);
    // Tables and inputs that are asked for by an id.
    let others = [
        EvaluateExtension::LAYOUT,
        HandlesExtension::LAYOUT,
        HandleFacesExtension::LAYOUT,
        IsIdentityExtension::LAYOUT,
        Triangles::LAYOUT,
        Graph::LAYOUT,
        Joints::LAYOUT,
        HandleMotions::LAYOUT,
        Strokes::LAYOUT,
        ModelFrame::LAYOUT,
        Effort::LAYOUT,
        MigrationExtension::LAYOUT,
        NearestService::LAYOUT,
        SurfaceService::LAYOUT,
        Time::LAYOUT,
        RestPositions::LAYOUT,
        Attributes::LAYOUT,
        OtherModels::LAYOUT,
    ];
    others.into_iter().for_each(|layout| describe(layout, &mut shape));
    shape.retain(|_, text| !text.is_empty());
    assert!(shape.len() > 15, "{:?} is not all", shape.keys());

    let version = concat!(env!("CARGO_PKG_VERSION_MAJOR"), ".", env!("CARGO_PKG_VERSION_MINOR"));
    let types: Vec<String> = shape.iter().map(|(name, text)| format!("{name}: {text}")).collect();
    let now = format!("interface {version}\n\n{}", types.join("\n"));
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/shape.txt");
    if std::env::var_os("SIMOD_WRITE_SHAPE").is_some() {
        #[expect(clippy::disallowed_methods, reason = "a file of the sources, for their author")]
        std::fs::write(&path, &now).expect("the file can be written");
    }
    let known = std::fs::read_to_string(&path).unwrap_or_default();
    for (known, now) in known.lines().zip(now.lines()) {
        assert_eq!(known, now, "the interface changed: raise its version, and write the shape down");
    }
    assert!(known == now, "the interface changed: raise its version, and write the shape down");
}
