//! The header for plugins in C: it is what the sources make of it, and a C compiler sees what Rust has.
//!
//! After a change of `src/c.rs` or `cbindgen.toml`: `SIMOD_WRITE_HEADER=1 cargo test -p simod-plugin-api`.

use std::mem::{offset_of, size_of};
use std::path::{Path, PathBuf};
use std::process::Command;

use cbindgen::{Builder, Config};
use simod_plugin_api::c::*;
use simod_plugin_api::{
    AttributeKind, Attributes, Consumes, Effort, ErrorCode, EvaluateExtension, ExtensionInterface, Gizmo,
    Graph, HandleDesc, HandleFacesExtension, HandleMotions, HandlesExtension, InputPart, IsIdentityExtension,
    Joint, Joints, LogLevel, MigrationExtension, ModelFrame, NearestService, OtherModels, ParamKind,
    PointsKind, Pose, RestPositions, Role, Strokes, SurfaceService, Time, Triangles, Unit,
};

/// A path in this crate.
fn path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

fn header() -> String {
    std::fs::read_to_string(path("include/simod_plugin.h")).unwrap_or_default()
}

#[test]
fn the_header_is_in_step() {
    let config = Config::from_file(path("cbindgen.toml")).expect("a configuration");
    let bindings = Builder::new().with_config(config).with_src(path("src/c.rs")).generate();
    let mut bytes = Vec::new();
    bindings.expect("a header").write(&mut bytes);
    let now = String::from_utf8(bytes).expect("UTF-8");
    if std::env::var_os("SIMOD_WRITE_HEADER").is_some() {
        #[expect(clippy::disallowed_methods, reason = "a file of the sources, for their author")]
        std::fs::write(path("include/simod_plugin.h"), &now).expect("the file can be written");
    }
    for (known, now) in header().lines().zip(now.lines()) {
        assert_eq!(known, now, "write the header anew: SIMOD_WRITE_HEADER=1");
    }
    assert!(header() == now, "write the header anew: SIMOD_WRITE_HEADER=1");
}

/// Numbers and ids mean the same on both sides.
#[test]
fn codes_and_ids_are_those_of_the_rust_interface() {
    let codes = [
        (SIMOD_INVALID_PARAMETER, ErrorCode::INVALID_PARAMETER.0),
        (SIMOD_INVALID_INPUT, ErrorCode::INVALID_INPUT.0),
        (SIMOD_NOT_CONVERGED, ErrorCode::NOT_CONVERGED.0),
        (SIMOD_CANCELLED, ErrorCode::CANCELLED.0),
        (SIMOD_INTERNAL, ErrorCode::INTERNAL.0),
        (SIMOD_UNSUPPORTED, ErrorCode::UNSUPPORTED.0),
        (SIMOD_PARAM_FLOAT, ParamKind::FLOAT.0),
        (SIMOD_PARAM_INT, ParamKind::INT.0),
        (SIMOD_PARAM_BOOL, ParamKind::BOOL.0),
        (SIMOD_PARAM_CHOICE, ParamKind::CHOICE.0),
        (SIMOD_PARAM_DIRECTION, ParamKind::DIRECTION.0),
        (SIMOD_PARAM_POINT, ParamKind::POINT.0),
        (SIMOD_PARAM_COLOUR, ParamKind::COLOUR.0),
        (SIMOD_PARAM_CURVE, ParamKind::CURVE.0),
        (SIMOD_PARAM_FILE, ParamKind::FILE.0),
        (SIMOD_PARAM_MODEL, ParamKind::MODEL.0),
        (SIMOD_UNIT_NONE, Unit::NONE.0),
        (SIMOD_UNIT_DEGREES, Unit::DEGREES.0),
        (SIMOD_UNIT_MODEL_LENGTH, Unit::MODEL_LENGTH.0),
        (SIMOD_UNIT_DIAGONAL, Unit::DIAGONAL.0),
        (SIMOD_UNIT_RATIO, Unit::RATIO.0),
        (SIMOD_ROLE_FIXED, Role::FIXED.0),
        (SIMOD_ROLE_HANDLE, Role::HANDLE.0),
        (SIMOD_LOG_DEBUG, LogLevel::DEBUG.0),
        (SIMOD_LOG_INFO, LogLevel::INFO.0),
        (SIMOD_LOG_WARNING, LogLevel::WARNING.0),
        (SIMOD_GIZMO_TRANSLATE, Gizmo::TRANSLATE.0),
        (SIMOD_GIZMO_ROTATE, Gizmo::ROTATE.0),
        (SIMOD_GIZMO_SCALE, Gizmo::SCALE.0),
        (SIMOD_EFFORT_FULL, Effort::FULL.0),
        (SIMOD_EFFORT_DRAFT, Effort::DRAFT.0),
        (SIMOD_POSE_CURRENT, Pose::CURRENT.0),
        (SIMOD_POSE_REST, Pose::REST.0),
        (SIMOD_ATTRIBUTE_I8, AttributeKind::I8.0),
        (SIMOD_ATTRIBUTE_U8, AttributeKind::U8.0),
        (SIMOD_ATTRIBUTE_I16, AttributeKind::I16.0),
        (SIMOD_ATTRIBUTE_U16, AttributeKind::U16.0),
        (SIMOD_ATTRIBUTE_I32, AttributeKind::I32.0),
        (SIMOD_ATTRIBUTE_U32, AttributeKind::U32.0),
        (SIMOD_ATTRIBUTE_F32, AttributeKind::F32.0),
        (SIMOD_ATTRIBUTE_F64, AttributeKind::F64.0),
        (SIMOD_POINTS_SAMPLED, PointsKind::SAMPLED.0),
        (SIMOD_POINTS_SAMPLES, PointsKind::SAMPLES.0),
        (SIMOD_ROOT, Joint::ROOT),
        (SIMOD_ROOT, HandleDesc::ROOT),
    ];
    assert!(codes.iter().all(|(c, rust)| c == rust), "{codes:?}");
    let version = concat!(env!("CARGO_PKG_VERSION_MAJOR"), ".", env!("CARGO_PKG_VERSION_MINOR"));
    assert_eq!(format!("{SIMOD_INTERFACE_MAJOR}.{SIMOD_INTERFACE_MINOR}"), version);
    let ids = [
        ("INPUT_FIXED_REGIONS", Consumes::FIXED_REGIONS),
        ("INPUT_HANDLE_REGIONS", Consumes::HANDLE_REGIONS),
        ("INPUT_NORMALS", Consumes::NORMALS),
        ("INPUT_TRIANGLES", <Triangles<'_> as InputPart<'_>>::ID),
        ("INPUT_GRAPH", <Graph<'_> as InputPart<'_>>::ID),
        ("INPUT_JOINTS", <Joints<'_> as InputPart<'_>>::ID),
        ("INPUT_STROKES", <Strokes<'_> as InputPart<'_>>::ID),
        ("INPUT_HANDLE_MOTIONS", <HandleMotions<'_> as InputPart<'_>>::ID),
        ("INPUT_MODEL_FRAME", <ModelFrame as InputPart<'_>>::ID),
        ("INPUT_EFFORT", <Effort as InputPart<'_>>::ID),
        ("INPUT_TIME", <Time as InputPart<'_>>::ID),
        ("INPUT_REST_POSITIONS", <RestPositions<'_> as InputPart<'_>>::ID),
        ("INPUT_ATTRIBUTES", <Attributes<'_> as InputPart<'_>>::ID),
        ("INPUT_OTHER_MODELS", <OtherModels<'_> as InputPart<'_>>::ID),
        ("EVALUATE", EvaluateExtension::ID),
        ("HANDLES", HandlesExtension::ID),
        ("HANDLE_FACES", HandleFacesExtension::ID),
        ("IS_IDENTITY", IsIdentityExtension::ID),
        ("MIGRATION", MigrationExtension::ID),
        ("NEAREST", NearestService::ID),
        ("SURFACE", SurfaceService::ID),
    ];
    for (name, id) in ids {
        let line = format!("#define SIMOD_{name} \"{id}\"\n");
        assert!(header().contains(&line), "{line}");
    }
}

/// Runs a compiler on a source, which it has to take without a warning.
fn compile(compiler: &str, options: &[&str], name: &str, source: &str) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join(name);
    #[expect(clippy::disallowed_methods, reason = "a temporary file")]
    std::fs::write(&file, source).expect("the file can be written");
    let mut command = Command::new(compiler);
    command.args(options).args(["-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsyntax-only"]);
    let output = command.arg("-I").arg(path("include")).arg(&file).output().expect("the compiler runs");
    assert!(output.status.success(), "{compiler}: {}", String::from_utf8_lossy(&output.stderr));
}

/// The size of each struct and the place of each field, as Rust has them.
macro_rules! layout {
    ($($name:ident { $($field:ident),+ $(,)? })+) => {
        [$((
            format!("sizeof({})", stringify!($name)),
            size_of::<$name>(),
            vec![$((format!("offsetof({}, {})", stringify!($name), stringify!($field)), offset_of!($name, $field))),+],
        )),+]
    };
}

#[test]
#[cfg(unix)]
fn a_c_compiler_sees_the_same_structs() {
    let all = layout! {
        SimodChoiceDesc { id, label }
        SimodParamDesc {
            id, name, hint, group, kind, unit, hard_range, soft_range, default_numbers, default_list,
            default_list_length, default_text, choices, choice_count, invalidates_preparation,
        }
        SimodInputDesc { id, at_least }
        SimodDescriptor {
            id, name, version, summary, citation, author, url, params, param_count, inputs, input_count,
        }
        SimodParam { id, kind, numbers, count, text }
        SimodSamples { count, positions, normals, spacing }
        SimodBounds { min, max }
        SimodRegion { role, weights }
        SimodAffine { rows }
        SimodPart { id, data }
        SimodPrepareInput {
            samples, bounds, regions, region_count, params, param_count, parts, part_count,
        }
        SimodDeformInput {
            samples, bounds, transforms, transform_count, params, param_count, parts, part_count,
        }
        SimodTriangles { indices, count }
        SimodGraph { starts, neighbours }
        SimodModelFrame { origin, scale }
        SimodEffort { effort }
        SimodTime { frame, seconds }
        SimodRestPositions { positions }
        SimodAttribute { name, kind, values }
        SimodAttributes { attributes, count }
        SimodOtherModel {
            param, kind, vertices, count, positions, normals, ids, triangles, triangle_count,
        }
        SimodOtherModels { models, count }
        SimodJoint { id, position, parent }
        SimodJoints { joints, count }
        SimodHandleMotions { motions, count }
        SimodStroke {
            key, radius, strength, points, point_count, pressures, params, param_count,
        }
        SimodStrokes { strokes, count }
        SimodHost { context, progress, log, error, parallel_for, extension }
        SimodPlugin {
            interface_major, interface_minor, size, describe, prepare, drop_state, new_scratch, drop_scratch,
            deform, extension,
        }
        SimodEvaluate { evaluate }
        SimodHandleDesc { id, name, position, gizmo, parent }
        SimodHandleList { context, add }
        SimodHandles { handles }
        SimodFaceList { context, add }
        SimodHandleFaces { handle_faces }
        SimodIsIdentity { is_identity }
        SimodAlias { former, now }
        SimodSettingList { context, set }
        SimodMigration { state_version, aliases, alias_count, migrate }
        SimodNearest { find }
        SimodSurfacePoint { triangle, weights, position, distance }
        SimodSurface { has, closest, ray }
    };
    let header = header();
    let structs = header.lines().filter(|l| l.starts_with("typedef struct ")).count();
    assert_eq!(all.len(), structs, "all structs of the header");
    let claims = all.into_iter().flat_map(|(size, n, fields)| fields.into_iter().chain([(size, n)]));
    let claims: String = claims.map(|(what, n)| format!("_Static_assert({what} == {n}, \"\");\n")).collect();
    compile("cc", &["-std=c11"], "layout.c", &format!("#include \"simod_plugin.h\"\n{claims}"));
}

/// The header stands alone, in the oldest C and C++ that have what it needs.
#[test]
#[cfg(unix)]
fn the_header_compiles_without_a_warning() {
    let source = "#include \"simod_plugin.h\"\n#include \"simod_plugin.h\"\nint main(void) { return 0; }\n";
    for standard in ["-std=c99", "-std=c11", "-std=c17"] {
        compile("cc", &[standard], "alone.c", source);
    }
    if Command::new("c++").arg("--version").output().is_err() {
        return println!("skipped: there is no C++ compiler");
    }
    for standard in ["-std=c++11", "-std=c++17"] {
        compile("c++", &[standard], "alone.cpp", source);
    }
}

/// The plugin in the header's first comment is one.
#[test]
#[cfg(unix)]
fn the_header_s_example_compiles() {
    let header = header();
    let lines = header.lines().map_while(|l| l.strip_prefix("//"));
    let example = lines.skip_while(|l| !l.contains("#include")).take_while(|l| !l.contains("cc -O2"));
    let example: String = example.map(|l| format!("{l}\n")).collect();
    assert!(example.contains("simod_plugin_entry"), "{example}");
    compile("cc", &["-std=c99", "-Wno-unused-parameter"], "example.c", &example);
}
