//! Rules on the meaning of a deformation: no motion gives no motion, the same input the same result.

use crate::answer::{PluginRefusal, answer};
use crate::case::{Case, Other, motion};
use crate::finding::{Checked, Finding};
use crate::inputs::{FEW, ORDINARY};
use crate::subject::Subject;
use glam::DVec3;
use simod_model::bounds::Bounds;
use simod_plugin_api::Time;
use simod_session::stack::rows;

/// Greatest distance from the image by a rigid motion, in units of the diagonal.
const RIGID: f64 = 1e-4;

/// Greatest distance between the map of space and the samples, in units of the diagonal.
const AGREES: f64 = 1e-5;

/// Threads that deform with one state at once.
const THREADS: usize = 4;

/// Positions as bits: equal results are equal to the last bit.
fn bits(positions: &[[f32; 3]]) -> Vec<[u32; 3]> {
    positions.iter().map(|p| p.map(f32::to_bits)).collect()
}

/// Difference of two results in any bit, in words: the number of positions that differ, and the first of
/// them; nothing where none do.
pub(crate) fn difference(a: &[[f32; 3]], b: &[[f32; 3]]) -> Option<String> {
    let (a, b) = (bits(a), bits(b));
    let count = a.iter().zip(&b).filter(|(a, b)| a != b).count();
    let first = a.iter().zip(&b).position(|(a, b)| a != b)?;
    Some(format!("{count} of {} positions differ, the first at index {first}", a.len()))
}

pub(crate) fn ordinary(subject: &Subject) -> Checked<Finding> {
    let case = Case::bumpy_sphere(&subject.plugin, ORDINARY)?;
    match subject.run(&case)? {
        Ok((_, positions)) => Ok(match difference(&case.positions, &positions) {
            Some(_) => Finding::pass("it is deformed"),
            None => Finding::pass("nothing moves"),
        }),
        Err(PluginRefusal(what)) => {
            let hint = "choose defaults that deform any model, and use what the description asks for alone";
            Err(Finding::fail(format!("it refuses a sphere with bumps: {what}"), hint))
        }
    }
}

pub(crate) fn identity(subject: &Subject) -> Checked<Finding> {
    let case = Case::bumpy_sphere(&subject.plugin, ORDINARY)?;
    if case.transforms.is_empty() && case.handles.is_empty() && case.strokes.is_empty() {
        return Ok(Finding::skip("it has neither handles nor strokes"));
    }
    let case = case.at_rest();
    let (_, positions) = subject.run_ordinary(&case)?;
    let Some(what) = difference(&case.positions, &positions) else {
        return Ok(Finding::pass("nothing moved"));
    };
    if says_that_it_moves(subject, &case)? {
        return Ok(Finding::pass(format!("its defaults do something, as its `is_identity` says: {what}")));
    }
    Ok(Finding::fail(
        format!("samples move though no handle does, and nothing is painted: {what}"),
        "add displacements to the rest positions, so that no motion is exactly none; a tool whose defaults do something by \
         themselves says so by `IsIdentity`, which then gives `false` here (`SIMOD_IS_IDENTITY` in C)",
    ))
}

/// Whether the plugin itself says that it moves something here.
fn says_that_it_moves(subject: &Subject, case: &Case) -> Checked<bool> {
    let plugin = &subject.plugin;
    if !plugin.capabilities().is_identity {
        return Ok(false);
    }
    let told = answer("is_identity", case.deform_input(|input| plugin.code().is_identity(input)))?;
    told.map(|is_identity| !is_identity).map_err(PluginRefusal::of_ordinary)
}

pub(crate) fn rigid(subject: &Subject) -> Checked<Finding> {
    let consumes = subject.plugin.consumes();
    if !consumes.handle_regions && !subject.plugin.capabilities().handles {
        return Ok(Finding::skip("it has no handles"));
    }
    if consumes.min_fixed > 0 {
        return Ok(Finding::skip("it needs fixed samples"));
    }
    let case = Case::bumpy_sphere(&subject.plugin, ORDINARY)?;
    let corner = DVec3::from_array;
    let bounds = Bounds { min: corner(case.bounds.min), max: corner(case.bounds.max) };
    let moved = rows(motion(&bounds, 0));
    let regions = if consumes.handle_regions { consumes.min_handles.max(1) as usize } else { 0 };
    let mut case = case.all_handles(regions, moved);
    case.strokes.clear();
    let still = case.clone().at_rest();
    // As in a drag, one preparation is for both motions.
    let (state, unmoved) = subject.run_ordinary(&still)?;
    if difference(&still.positions, &unmoved).is_some() {
        return Ok(Finding::skip("samples move before any handle does: there is nothing to compare with"));
    }
    let moved_by_all = subject.deform(&case, &state, &mut subject.scratch()?)?;
    let positions = moved_by_all.map_err(PluginRefusal::of_ordinary)?;
    let left = case.positions.iter().zip(&positions).filter(|(p, q)| p == q).count();
    if left > 0 {
        // Where each handle has a reach beyond which nothing follows, nothing moves as a whole.
        let all = positions.len();
        return Ok(Finding::skip(format!("{left} of {all} samples are out of the handles' reach")));
    }
    let exact: Vec<_> = case.positions.iter().map(|p| moved.apply(p.map(f64::from))).collect();
    let missed = |i: usize| DVec3::from(exact[i]).distance(DVec3::from(positions[i].map(f64::from)));
    let at = (0..exact.len()).max_by(|a, b| missed(*a).total_cmp(&missed(*b))).unwrap_or(0);
    let worst = missed(at) / bounds.diagonal();
    Ok(if worst <= RIGID {
        Finding::pass(format!("the motion is met to {worst:.1e} of the diagonal"))
    } else {
        Finding::warn(
            format!(
                "all handles and samples are moved by one rigid motion, and sample {at} ends {worst:.1e} of the diagonal \
                 from where that takes it, more than {RIGID:.0e}"
            ),
            "users expect that what is moved as a whole keeps its shape: let displacements follow the handles' motions in \
             full where all weights are 1; if the tool is meant to lag behind or to bend, nothing needs to be done",
        )
    })
}

/// The largest distance of points from those of the same index.
fn farthest(a: impl Iterator<Item = [f64; 3]>, b: impl Iterator<Item = [f64; 3]>) -> f64 {
    a.zip(b).map(|(a, b)| DVec3::from(a).distance(DVec3::from(b))).fold(0.0, f64::max)
}

pub(crate) fn repeatable(subject: &Subject) -> Checked<Finding> {
    let case = Case::bumpy_sphere(&subject.plugin, ORDINARY)?;
    let (state, first) = subject.run_ordinary(&case)?;
    let hint = "let the result depend on the input alone: no clocks, no order of threads or of hash maps";
    let differs = |how: &str, what: &str| Finding::fail(format!("{how}: {what}"), hint);

    let (_, again) = subject.run_ordinary(&case)?;
    if let Some(what) = difference(&first, &again) {
        return Err(differs("prepared and deformed again", &what));
    }
    let one = || -> Checked<()> {
        let mut scratch = subject.scratch()?;
        // The second call uses a scratch that was used before.
        for _ in 0..2 {
            let positions =
                subject.deform(&case, &state, &mut scratch)?.map_err(PluginRefusal::of_ordinary)?;
            if let Some(what) = difference(&first, &positions) {
                return Err(differs("deformed again with the same state, by several threads", &what));
            }
        }
        Ok(())
    };
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..THREADS).map(|_| scope.spawn(one)).collect();
        threads.into_iter().try_for_each(|thread| {
            thread.join().unwrap_or_else(|_| Err(Finding::fail("a thread panicked outside the plugin", "")))
        })
    })?;
    Ok(Finding::pass(format!("the same bytes from two states and {THREADS} threads")))
}

pub(crate) fn input_unchanged(subject: &Subject) -> Checked<Finding> {
    let case = Case::bumpy_sphere(&subject.plugin, ORDINARY)?;
    let before = case.fingerprint();
    let unchanged = |call: &str| {
        if case.fingerprint() == before {
            return Ok(());
        }
        let hint = "write into `out` alone; all input is the host's, and other layers and threads read it";
        Err(Finding::fail(format!("{call} changed its input"), hint))
    };
    let state = subject.prepare(&case)?;
    unchanged("prepare")?;
    let state = state.map_err(PluginRefusal::of_ordinary)?;
    let deformed = subject.deform(&case, &state, &mut subject.scratch()?);
    unchanged("deform")?;
    deformed?.map_err(PluginRefusal::of_ordinary)?;
    let points = case.positions.iter().map(|p| p.map(f64::from)).collect();
    let evaluated = subject.evaluate(&case, &state, points);
    unchanged("evaluate")?;
    evaluated?;
    Ok(Finding::pass("samples, regions, motions and parameters are as before"))
}

pub(crate) fn evaluate(subject: &Subject) -> Checked<Finding> {
    if !subject.plugin.capabilities().evaluate {
        return Ok(Finding::skip("it does not evaluate"));
    }
    let case = Case::bumpy_sphere(&subject.plugin, ORDINARY)?;
    let (state, positions) = subject.run_ordinary(&case)?;
    let points = case.positions.iter().map(|p| p.map(f64::from)).collect();
    let images = match subject.evaluate(&case, &state, points)? {
        Some(Ok(images)) => images,
        Some(Err(refusal)) => {
            let what = format!("evaluate refuses what deform does: {}", refusal.0);
            return Err(Finding::fail(what, "both are the same map"));
        }
        None => return Ok(Finding::skip("it does not evaluate")),
    };
    let worst = farthest(positions.iter().map(|p| p.map(f64::from)), images.into_iter());
    let worst = worst / case.bounds.diagonal();
    let text = format!("deform and evaluate agree to {worst:.1e} of the diagonal");
    Ok(if worst <= AGREES { Finding::pass(text) } else { Finding::fail(text, "both are the same map") })
}

pub(crate) fn handles(subject: &Subject) -> Checked<Finding> {
    let plugin = &subject.plugin;
    if !plugin.capabilities().handles {
        return Ok(Finding::skip("it places no handles"));
    }
    let case = Case::bumpy_sphere(plugin, ORDINARY)?;
    let placed = case.placed_handles(plugin)?;
    if placed != case.placed_handles(plugin)? {
        let hint = "let the handles depend on the input alone";
        return Err(Finding::fail("asked again it places other handles", hint));
    }
    // Users who grab a handle expect that something moves.
    let rest = case.clone().at_rest();
    // As in a drag, one preparation is for all motions.
    let (state, still) = subject.run_ordinary(&rest)?;
    let mut scratch = subject.scratch()?;
    let mut dead = |i: usize| -> Checked<bool> {
        let mut one = rest.clone();
        one.handles[i] = case.handles[i];
        let moved = subject.deform(&one, &state, &mut scratch)?.map_err(PluginRefusal::of_ordinary)?;
        Ok(bits(&moved) == bits(&still))
    };
    const TRIED: usize = 8;
    let step = placed.descs.len().div_ceil(TRIED).max(1);
    for i in (0..placed.descs.len()).step_by(step) {
        if dead(i)? {
            let hint = "place handles where they reach something, or leave them out";
            return Ok(Finding::warn(format!("the handle `{}` moves nothing", placed.descs[i].id), hint));
        }
    }
    let faces = match placed.faces.len() {
        0 => String::new(),
        faces => format!(", and {faces} faces between them"),
    };
    Ok(Finding::pass(format!("{} handles{faces}", placed.descs.len())))
}

pub(crate) fn is_identity(subject: &Subject) -> Checked<Finding> {
    let plugin = &subject.plugin;
    if !plugin.capabilities().is_identity {
        return Ok(Finding::skip("it does not tell"));
    }
    let ask = |case: &Case| {
        let told = answer("is_identity", case.deform_input(|input| plugin.code().is_identity(input)))?;
        told.map_err(PluginRefusal::of_ordinary)
    };
    let moved = Case::bumpy_sphere(plugin, ORDINARY)?;
    let rest = moved.clone().at_rest();
    for (case, what) in [(&moved, "moved"), (&rest, "at rest")] {
        if ask(case)? {
            let (_, positions) = subject.run_ordinary(case)?;
            if let Some(difference) = difference(&case.positions, &positions) {
                return Err(Finding::fail(
                    format!("it says that nothing moves ({what}), and deform moves something: {difference}"),
                    "say `false` where in doubt",
                ));
            }
        }
    }
    Ok(Finding::pass("what it says holds"))
}

/// A plugin that takes the time deforms at any time, and at the same one always in the same way, whatever
/// was done between.
pub(crate) fn time(subject: &Subject) -> Checked<Finding> {
    let case = Case::bumpy_sphere(&subject.plugin, ORDINARY)?;
    if !subject.plugin.consumes().time {
        return Ok(Finding::skip("it does not take the time"));
    }
    let (state, first) = subject.run_ordinary(&case)?;
    let mut scratch = subject.scratch()?;
    let mut moved = 0;
    for (frame, seconds) in [(0, 0.0), (-24, -1.0), (1, 1.0 / 24.0), (2_400_000, 1e5), (12, 0.5)] {
        let at = case.clone().at_time(Time { frame, seconds });
        // The plugin may refuse a time, politely.
        let Ok(positions) = subject.deform(&at, &state, &mut scratch)? else { continue };
        match difference(&first, &positions) {
            Some(what) if frame == 12 => {
                let found = format!("at the time of before, after others, {what}");
                return Err(Finding::fail(found, "let the result depend on the input and the state alone"));
            }
            Some(_) => moved += 1,
            None => {}
        }
    }
    Ok(if moved > 0 {
        Finding::pass("it moves with the time")
    } else {
        Finding::pass("no time makes a difference")
    })
}

/// A plugin that takes attributes of the samples works without them, and with values that it does not
/// expect.
pub(crate) fn attributes(subject: &Subject) -> Checked<Finding> {
    let case = Case::bumpy_sphere(&subject.plugin, ORDINARY)?;
    let Some(usual) = case.attributes.clone() else {
        return Ok(Finding::skip("it takes no attributes of the samples"));
    };
    let (_, first) = subject.run_ordinary(&case)?;
    let names: Vec<&str> = usual.iter().map(|(name, _)| name.as_str()).collect();
    let cases = [
        case.clone().with_attributes(&[], |_| 0.0),
        case.clone().with_attributes(&["scalar_Scalar field #1", "vertex-confidence"], |i| i as f32),
        case.clone().with_attributes(&names, |_| 0.0),
        case.clone().with_attributes(&names, |i| if i % 2 == 0 { f32::MAX } else { f32::MIN }),
    ];
    let mut moved = 0;
    for case in &cases {
        // The plugin may refuse attributes, politely.
        let Ok((_, positions)) = subject.run(case)? else { continue };
        moved += usize::from(difference(&first, &positions).is_some());
    }
    Ok(if moved > 0 { Finding::pass("it moves with them") } else { Finding::pass("they make no difference") })
}

/// A plugin that takes other models works without them, and with any.
pub(crate) fn other_models(subject: &Subject) -> Checked<Finding> {
    let case = Case::bumpy_sphere(&subject.plugin, FEW)?;
    let Some(usual) = case.other.clone() else {
        return Ok(Finding::skip("it takes no other models"));
    };
    let (_, first) = subject.run_ordinary(&case)?;
    let of = |map: &dyn Fn([f64; 3]) -> [f64; 3]| {
        let positions = usual.positions.iter().map(|p| map(*p)).collect();
        Some(Other { positions, ..usual.clone() })
    };
    let few = |count: usize| {
        let (positions, normals) = (usual.positions[..count].to_vec(), usual.normals[..count].to_vec());
        Some(Other { positions, normals, ids: usual.ids[..count].to_vec(), triangles: Vec::new() })
    };
    let others = [
        None,
        few(1),
        few(2),
        few(FEW / 2),
        Some(Other { ids: Vec::new(), triangles: Vec::new(), ..usual.clone() }),
        Some(Other { ids: usual.ids.iter().map(|id| u64::MAX - id).collect(), ..usual.clone() }),
        // The points are all in one place; in a plane; turned inside out; in another unit; elsewhere; as
        // far as numbers go.
        of(&|_| [0.5; 3]),
        of(&|[x, y, _]| [x, y, 0.0]),
        of(&|[x, y, z]| [-x, y, z]),
        of(&|p| p.map(|x| 1000.0 * x)),
        of(&|p| p.map(|x| x + 1e6)),
        of(&|p| p.map(|x| 1e300 * x)),
    ];
    let (mut moved, mut refused) = (0, 0);
    for other in others {
        match subject.run(&case.clone().with_other(other))? {
            Ok((_, positions)) => moved += usize::from(difference(&first, &positions).is_some()),
            Err(_) => refused += 1,
        }
    }
    let found = if moved > 0 { "it moves with them" } else { "they make no difference" };
    Ok(Finding::pass(format!("{found}; it refuses {refused} that are strange")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_of_bits() {
        assert_eq!(difference(&[[0.0; 3]], &[[0.0; 3]]), None);
        let found = difference(&[[1.0; 3], [0.0; 3]], &[[1.0; 3], [-0.0, 0.0, 0.0]]).unwrap();
        assert_eq!(found, "1 of 2 positions differ, the first at index 1");
    }
}
