//! Tests of the whole plugin, as the host calls it.

use super::*;
use proptest::prelude::*;
use simod_plugin_api::{Bounds, ErrorCode, OtherModels, Param, ParamKind, Part, RestPositions, Samples};

const BOUNDS: Bounds = Bounds { min: [-1.0; 3], max: [1.0; 3] };

fn samples(count: usize) -> Vec<[f32; 3]> {
    let at = |i: usize, by: f64| ((i as f64 * by).fract() * 2.0 - 1.0) as f32;
    (0..count).map(|i| [at(i, 0.618_034), at(i, 0.754_878), at(i, 0.569_84)]).collect()
}

/// Points of a target, their ids, and the amount.
type Given<'a> = (&'a [[f64; 3]], &'a [u64], f64);

/// The samples with two targets.
fn run(
    [rest, now]: [&[[f32; 3]]; 2],
    targets: [Given<'_>; 2],
    kind: PointsKind,
) -> PluginResult<Vec<[f32; 3]>> {
    let normals = vec![[0.0, 0.0, 1.0]; rest.len() * 2];
    let ids = [target(1), target(2)];
    let models: Vec<OtherModel<'_>> = ids
        .iter()
        .zip(&targets)
        .map(|(id, (to, which, _))| {
            OtherModel::new((id, kind, to.len() as u64), to, &normals[..to.len()], which, &[])
        })
        .collect();
    let names: Vec<String> = (1..=TARGETS).flat_map(|n| [target(n), amount(n)]).collect();
    let amounts: Vec<[f64; 1]> =
        (0..TARGETS).map(|n| [targets.get(n).map_or(1.0, |(.., amount)| *amount)]).collect();
    let params: Vec<Param<'_>> = (0..2 * TARGETS)
        .map(|i| match i % 2 {
            0 => Param::text(&names[i], ParamKind::MODEL, if i < 4 { "target.ply" } else { "" }),
            _ => Param::numbers(&names[i], ParamKind::FLOAT, &amounts[i / 2]),
        })
        .collect();
    let (models, before) = (OtherModels::new(&models), RestPositions::new(rest));
    let parts = [Part::new(&models), Part::new(&before)];
    let (samples, host) = (Samples::new(now, &[], &[]), Host::new(&()));
    let input = PrepareInput::new(samples, BOUNDS, &[], &params).with_parts(&parts);
    let state = Blendshapes::prepare(&input, &host)?;
    let mut out = vec![[f32::NAN; 3]; now.len()];
    Blendshapes::deform(&state, &DeformInput::new(samples, BOUNDS, &[], &params), &mut (), &mut out, &host)?;
    Ok(out)
}

fn moved(rest: &[[f32; 3]], by: impl Fn(usize) -> [f64; 3]) -> Vec<[f64; 3]> {
    let to = |(i, p): (usize, &[f32; 3])| [0, 1, 2].map(|a| f64::from(p[a]) + by(i)[a]);
    rest.iter().enumerate().map(to).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(50))]

    /// Displacements add up by their amounts, whatever the order of points, and on top of the displacements
    /// by earlier steps.
    #[test]
    fn displacements_add_up(a in -3.0..3.0_f64, b in -3.0..3.0_f64, turn in 0..40_usize) {
        let rest = samples(40);
        let now: Vec<[f32; 3]> = rest.iter().map(|p| [p[0] + 0.25, p[1], p[2]]).collect();
        let by = |i: usize| if i < 20 { [0.0; 3] } else { [0.1, 0.02 * i as f64, -0.3] };
        let mut first = moved(&rest, by);
        let second = moved(&rest, |i| [0.0, 0.0, 0.01 * i as f64]);
        let mut ids: Vec<u64> = (0..40).collect();
        let whole = ids.clone();
        first.rotate_left(turn);
        ids.rotate_left(turn);
        let out = run([&rest, &now], [(&first, &ids, a), (&second, &whole, b)], PointsKind::SAMPLES).unwrap();
        for i in 0..40 {
            for axis in 0..3 {
                let to = f64::from(now[i][axis]) + a * by(i)[axis] + [0.0, 0.0, b * 0.01 * i as f64][axis];
                prop_assert!((f64::from(out[i][axis]) - to).abs() < 1e-5);
            }
        }
        let alone = run([&rest, &now], [(&first, &ids, a), (&second, &whole, 0.0)], PointsKind::SAMPLES).unwrap();
        prop_assert_eq!(&alone[..20], &now[..20], "what no target moves stays to the last bit");
    }
}

#[test]
fn targets_of_other_samplings_are_refused() {
    let (rest, more) = (samples(40), samples(41));
    let (to, ids): (Vec<[f64; 3]>, Vec<u64>) = (moved(&more, |_| [0.1; 3]), (0..41).collect());
    let refused = |to: &[[f64; 3]], ids: &[u64], kind: PointsKind| {
        run([&rest, &rest], [(to, ids, 1.0), (to, ids, 1.0)], kind).unwrap_err()
    };
    let error = refused(&to, &ids, PointsKind::SAMPLES);
    assert!(error.message.contains("`target-1` is of another sampling: it has a sample 40"), "{error}");
    assert!(!error.hint.is_empty() && error.code == ErrorCode::INVALID_PARAMETER);
    let error = refused(&to, &[], PointsKind::SAMPLED);
    assert!(error.message.contains("no ids") && !error.hint.is_empty(), "{error}");
    let far = moved(&rest, |_| [0.0, 1e30, 0.0]);
    let error = refused(&far, &ids[..40], PointsKind::SAMPLES);
    assert!(error.message.contains("far away") && error.hint.contains("unit"), "{error}");
    // A part of the samples is a target of these alone.
    let out =
        run([&rest, &rest], [(&to[..5], &ids[..5], 1.0), (&to[..1], &ids[..1], 1.0)], PointsKind::SAMPLES);
    let out = out.unwrap();
    assert!(out[5..] == rest[5..] && (out[3][0] - rest[3][0] - 0.1).abs() < 1e-6);
    assert!((out[0][0] - rest[0][0] - 0.2).abs() < 1e-6);
}
