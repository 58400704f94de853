//! `#[derive(ParamSet)]` and `#[derive(Choice)]`: the same descriptions as by hand, and the values in their
//! fields.
#![allow(clippy::unwrap_used, reason = "a panic is how a test fails")]

use simod_plugin_api::{
    Bounds, Choice, Descriptor, ErrorCode, Param, ParamDesc, ParamKind, ParamSet, PrepareInput, Samples, Unit,
};

#[derive(ParamSet, Debug, PartialEq)]
struct Everything {
    /// Turned at the end,
    /// not at the start.
    ///
    /// More on that.
    #[param(default = 90.0, unit = "degrees", soft = -360.0..=360.0)]
    angle: f64,
    #[param(default = 0.1, unit = "model-length", hard = f64::MIN_POSITIVE.., group = "Size")]
    #[param(name = "Reach", hint = "How far", id = "max-reach")]
    reach: f64,
    #[param(default = 1000, hard = 8..=5000, soft = ..=2000, invalidates_preparation)]
    max_centers: i64,
    /** Whether it stays */
    #[param(default = true)]
    r#static: bool,
    #[param(point, default = [0.5; 3])]
    center: [f64; 3],
    #[param(direction, default = [0.0, 1.0, 0.0])]
    axis: [f64; 3],
    #[param(default = Growth::Smoothstep)]
    growth: Growth,
}

/// Curve by which something grows.
#[derive(Choice, Debug, Clone, Copy, PartialEq)]
enum Growth {
    /// A ramp.
    InStraightLines,
    #[choice(id = "smooth", label = "Smooth (no kinks)")]
    Smoothstep,
}

fn by_hand() -> Vec<ParamDesc> {
    let growths = [("in-straight-lines", "In straight lines"), ("smooth", "Smooth (no kinks)")];
    vec![
        ParamDesc::float("angle", "Angle", 90.0)
            .unit(Unit::DEGREES)
            .soft(-360.0, 360.0)
            .hint("Turned at the end, not at the start"),
        ParamDesc::float("max-reach", "Reach", 0.1)
            .unit(Unit::MODEL_LENGTH)
            .hard(f64::MIN_POSITIVE, f64::INFINITY)
            .group("Size")
            .hint("How far"),
        ParamDesc::int("max-centers", "Max centers", 1000)
            .hard(8.0, 5000.0)
            .soft(f64::NEG_INFINITY, 2000.0)
            .invalidates_preparation(),
        ParamDesc::bool("static", "Static", true).hint("Whether it stays"),
        ParamDesc::point("center", "Center", [0.5; 3]),
        ParamDesc::direction("axis", "Axis", [0.0, 1.0, 0.0]),
        ParamDesc::choice("growth", "Growth", "smooth", &growths),
    ]
}

fn values() -> [Param<'static>; 7] {
    [
        Param::numbers("angle", ParamKind::FLOAT, &[30.0]),
        Param::numbers("max-reach", ParamKind::FLOAT, &[0.25]),
        Param::numbers("max-centers", ParamKind::INT, &[9.0]),
        Param::numbers("static", ParamKind::BOOL, &[0.0]),
        Param::numbers("center", ParamKind::POINT, &[1.0, 2.0, 3.0]),
        Param::numbers("axis", ParamKind::DIRECTION, &[0.0, 0.0, -2.0]),
        Param::text("growth", ParamKind::CHOICE, "in-straight-lines"),
    ]
}

fn read<T: ParamSet>(params: &[Param<'_>]) -> simod_plugin_api::PluginResult<T> {
    let bounds = Bounds { min: [0.0; 3], max: [1.0; 3] };
    PrepareInput::new(Samples::new(&[], &[], &[]), bounds, &[], params).params().read()
}

#[test]
fn descriptions_are_those_made_by_hand() {
    assert_eq!(Everything::describe(), by_hand());
    let last = ParamDesc::bool("last", "Last", false);
    let descriptor =
        Descriptor::new("x", "X", "1.0.0").param(last.clone()).param_set::<Everything>().param(last.clone());
    assert_eq!(descriptor.params.len(), 9);
    assert_eq!((&descriptor.params[0], &descriptor.params[8]), (&last, &last));
    assert_eq!(descriptor.params[1..8], by_hand());
}

#[test]
fn values_come_in_their_fields() {
    let expected = Everything {
        angle: 30.0,
        reach: 0.25,
        max_centers: 9,
        r#static: false,
        center: [1.0, 2.0, 3.0],
        axis: [0.0, 0.0, -2.0],
        growth: Growth::InStraightLines,
    };
    // By ids: the order does not matter.
    let mut values = values();
    assert_eq!(read::<Everything>(&values).unwrap(), expected);
    values.reverse();
    assert_eq!(read::<Everything>(&values).unwrap(), expected);
}

#[test]
fn what_was_not_described_is_an_error() {
    let error = read::<Everything>(&values()[1..]).unwrap_err();
    assert_eq!(error.code, ErrorCode::INTERNAL);
    assert!(error.message.contains("`angle`"), "{error}");
    let mut values = values();
    values[6] = Param::text("growth", ParamKind::CHOICE, "Smoothstep");
    let error = read::<Everything>(&values).unwrap_err();
    assert_eq!(error.code, ErrorCode::INVALID_PARAMETER);
    assert!(
        error.message.contains("`growth`") && error.hint.contains("in-straight-lines, smooth"),
        "{error:?}"
    );
}
