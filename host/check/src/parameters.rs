//! Rules on parameters: any value in range is answered, and the preparation depends on the declared
//! parameters alone.

use crate::answer::PluginRefusal;
use crate::case::Case;
use crate::finding::{Checked, Finding, Verdict};
use crate::inputs::{FEW, all_calls, calls_with};
use crate::meaning::difference;
use crate::random::Random;
use crate::subject::Subject;
use simod_plugin_api::{ParamDesc, ParamKind};
use toml::Value;

/// Number of settings with random values.
const RANDOM: usize = 32;

/// Number of other values that are tried of a parameter that does not invalidate the preparation.
const CHANGES: usize = 4;

/// Any setting in range is answered. Settings that do not invalidate the preparation of the defaults are
/// tried with that one, as in a session: preparing with them is the subject of the rule on [invalidation].
pub(crate) fn bounds(subject: &Subject) -> Checked<Finding> {
    let plugin = &subject.plugin;
    if plugin.params().is_empty() {
        return Ok(Finding::skip("it has no parameters"));
    }
    let case = Case::bumpy_sphere(plugin, FEW)?;
    let tables = settings(subject);
    let mut usual = None;
    let mut try_with = |given: &toml::Table| {
        let changed = case.with_params(plugin, given)?;
        if !changed.is_prepared_as(&case, plugin) {
            return all_calls(subject, &changed);
        }
        let state = match usual.take() {
            Some(state) => state,
            None => subject.prepare(&changed)?,
        };
        match usual.insert(state) {
            Ok(state) => calls_with(subject, &changed, state),
            Err(refusal) => Ok(Err(PluginRefusal(refusal.0.clone()))),
        }
    };
    let mut refused = Vec::new();
    for given in &tables {
        match try_with(given) {
            Ok(Ok(())) => {}
            // Handles that cannot be placed with these parameters are a refusal as any other.
            Ok(Err(PluginRefusal(why))) | Err(Finding { verdict: Verdict::Skip, found: why, .. }) => {
                refused.push(format!("{} ({why})", text(given)));
            }
            Err(finding) => {
                let found = format!("with {}: {}", text(given), finding.found);
                return Err(Finding { found, ..finding });
            }
        }
    }
    let all = tables.len();
    Ok(Finding::pass(match refused.first() {
        None => format!("{all} settings give finite positions"),
        Some(first) => format!("{all} settings, {} of them refused, as {first}", refused.len()),
    }))
}

pub(crate) fn invalidation(subject: &Subject) -> Checked<Finding> {
    let plugin = &subject.plugin;
    let free: Vec<&ParamDesc> = plugin.params().iter().filter(|d| !d.invalidates_preparation).collect();
    if free.is_empty() {
        return Ok(Finding::skip("no parameter is said not to matter to the preparation"));
    }
    let case = Case::bumpy_sphere(plugin, FEW)?;
    let old = subject.prepare(&case)?.map_err(PluginRefusal::of_ordinary)?;
    let mut random = Random::new(subject.seed);
    let mut compared = 0;
    for d in &free {
        for value in ends(d).into_iter().chain((0..CHANGES).map(|_| any(d, &mut random))) {
            let given = one(d, value);
            let changed = case.with_params(plugin, &given)?;
            // A setting that is refused with a new preparation gives no result to compare with.
            let Ok((_, fresh)) = subject.run(&changed)? else { continue };
            let what = match subject.deform(&changed, &old, &mut subject.scratch()?)? {
                Ok(kept) => difference(&fresh, &kept),
                Err(refusal) => Some(format!("the old one is refused: {}", refusal.0)),
            };
            if let Some(what) = what {
                return Err(Finding::fail(
                    format!(
                        "with {} the old state gives another result than a fresh one: {what}",
                        text(&given)
                    ),
                    format!("declare `{}` with `invalidates_preparation`, or read it in deform", d.id),
                ));
            }
            compared += 1;
        }
    }
    Ok(Finding::pass(format!("{compared} changes of {} parameters need no new preparation", free.len())))
}

/// Settings of each parameter at the ends of its range, and settings of all parameters at random.
fn settings(subject: &Subject) -> Vec<toml::Table> {
    let params = subject.plugin.params();
    let mut random = Random::new(subject.seed);
    let of_ends = params.iter().flat_map(|d| ends(d).into_iter().map(|value| one(d, value)));
    let mut tables: Vec<toml::Table> = of_ends.collect();
    for _ in 0..RANDOM {
        tables.push(params.iter().map(|d| (d.id.to_string(), any(d, &mut random))).collect());
    }
    tables
}

/// A setting of one parameter.
fn one(d: &ParamDesc, value: Value) -> toml::Table {
    [(d.id.to_string(), value)].into_iter().collect()
}

/// A setting as a user would write it.
fn text(given: &toml::Table) -> String {
    given.iter().map(|(id, value)| format!("{id} = {value}")).collect::<Vec<_>>().join(", ")
}

/// Values at the ends of a parameter's range, or all values if these are few.
fn ends(d: &ParamDesc) -> Vec<Value> {
    let vectors = |all: &[[f64; 3]]| all.iter().map(|v| vector(*v)).collect();
    match d.kind {
        ParamKind::FLOAT | ParamKind::INT => range(d).into_iter().flatten().map(|x| number(d, x)).collect(),
        ParamKind::BOOL => vec![false.into(), true.into()],
        ParamKind::CHOICE => d.choices.iter().map(|c| c.id.as_str().into()).collect(),
        ParamKind::DIRECTION => {
            vectors(&[[0.0; 3], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1e-30], [1e30, 1.0, 0.0]])
        }
        ParamKind::COLOUR => vec![numbers(&[0.0; 4]), numbers(&[1.0; 4])],
        ParamKind::CURVE => vec![curve(&[0.0, 0.0]), curve(&[1.0, 1.0]), curve(&[0.0, 1.0, 0.0, 1.0])],
        // The only file that is known here is none; the content of files is another rule's subject.
        ParamKind::FILE | ParamKind::MODEL => vec!["".into()],
        _ => vectors(&[[0.0; 3], [-1.0; 3], [1e6, 0.0, -1e6]]),
    }
}

/// A random value in a parameter's range.
fn any(d: &ParamDesc, random: &mut Random) -> Value {
    match d.kind {
        ParamKind::FLOAT | ParamKind::INT => {
            let [min, max] = range(d);
            let about = d.default_numbers.first().copied().unwrap_or(0.0);
            // A range without an end ends some way from the default, or from the other end.
            let min = min.unwrap_or_else(|| about.min(max.unwrap_or(about)) - 10.0);
            let max = max.unwrap_or_else(|| about.max(min) + 10.0);
            number(d, random.within([min, max]))
        }
        ParamKind::BOOL => (random.below(2) == 1).into(),
        ParamKind::CHOICE => d.choices[random.below(d.choices.len())].id.as_str().into(),
        ParamKind::COLOUR => numbers(&std::array::from_fn::<_, 4, _>(|_| random.within([0.0, 1.0]))),
        ParamKind::CURVE => {
            let heights: Vec<f64> = (0..2 + random.below(4)).map(|_| random.within([0.0, 1.0])).collect();
            curve(&heights)
        }
        ParamKind::FILE | ParamKind::MODEL => "".into(),
        _ => vector(std::array::from_fn(|_| random.within([-1.0, 1.0]))),
    }
}

/// Ends of a parameter's range: the hard one, or else the slider's, or nothing.
fn range(d: &ParamDesc) -> [Option<f64>; 2] {
    std::array::from_fn(|i| [d.hard_range[i], d.soft_range[i]].into_iter().find(|x| x.is_finite()))
}

/// Number of the parameter's kind. Whole numbers stay within the range by rounding inwards.
fn number(d: &ParamDesc, x: f64) -> Value {
    if d.kind != ParamKind::INT {
        return x.into();
    }
    let [min, max] = d.hard_range;
    // Exact whole numbers end at 2^53.
    const MOST: f64 = 9_007_199_254_740_992.0;
    Value::Integer(x.round().clamp(min.ceil().max(-MOST), max.floor().min(MOST).max(min.ceil())) as i64)
}

fn vector(v: [f64; 3]) -> Value {
    numbers(&v)
}

fn numbers(numbers: &[f64]) -> Value {
    numbers.iter().copied().map(Value::from).collect::<Vec<_>>().into()
}

/// A curve of the given heights, evenly spaced from 0 to 1.
fn curve(heights: &[f64]) -> Value {
    let last = (heights.len() - 1) as f64;
    let points = heights.iter().enumerate().map(|(i, y)| numbers(&[i as f64 / last, *y]));
    points.collect::<Vec<_>>().into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_in_range() {
        let mut random = Random::new(1);
        let d = ParamDesc::int("count", "Count", 3).hard(0.5, 6.5);
        assert_eq!(ends(&d), [Value::Integer(1), Value::Integer(6)]);
        assert!((0..100).all(|_| (1..=6).contains(&any(&d, &mut random).as_integer().unwrap())));
        let d = ParamDesc::float("x", "X", 3.0).hard(2.0, f64::INFINITY).soft(0.0, 5.0);
        assert_eq!(ends(&d), [Value::Float(2.0), Value::Float(5.0)]);
        let d = ParamDesc::float("x", "X", 3.0);
        assert!(ends(&d).is_empty());
        assert!((0..100).all(|_| any(&d, &mut random).as_float().unwrap().is_finite()));
    }
}
