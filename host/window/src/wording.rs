//! Messages of steps and their plugins, in the window's words: the messages speak of session files, which
//! users of the window may never have seen.

use crate::numbers::{count, number};
use crate::widgets::values::number_of;
use simod_plugin_api::{ParamDesc, ParamKind};
use simod_session::Plugin;
use toml::{Table, Value};

/// Names of a step's tables in a session file, and the window's words for them.
const TABLES: [(&str, &str); 4] =
    [("joint", "joints"), ("handle", "handles"), ("region", "regions"), ("stroke", "strokes")];

/// Text in the window's words. Parameters of the plugin have the names that its panel shows.
pub fn in_window(text: &str, plugin: Option<&Plugin>) -> String {
    // The plugin's name stands above already.
    let named = plugin.and_then(|plugin| text.strip_prefix(&format!("plugin {}: ", plugin.id())));
    let mut text = named.unwrap_or(text).to_owned();
    for role in ["handle", "fixed", "mask"] {
        let told = format!("add a [[step.region]] with role = \"{role}\"");
        let article = if role == "handle" { "a handle" } else { &*format!("a {role} region") };
        text = text.replace(&told, &format!("select samples, and make {article} of them"));
    }
    for (table, name) in TABLES {
        text = text.replace(&format!("the [[step.{table}]]"), &format!("its {name}"));
        let tool = if table == "joint" { " (with the tool for them: J)" } else { "" };
        text = text.replace(&format!("some by [[step.{table}]]"), &format!("some {name}{tool}"));
        text = text.replace(&format!("[[step.{table}]]"), name);
    }
    let params = plugin.map(|plugin| plugin.params()).unwrap_or_default();
    for param in params {
        text = text.replace(&format!("`{}`", param.id), &format!("\u{201c}{}\u{201d}", param.name));
    }
    for piece in text.clone().split('`').skip(1).step_by(2) {
        if let Some((param, value)) = assigned(piece, params) {
            let told = format!("\u{201c}{}: {}\u{201d}", param.name, shown(param, &value));
            text = text.replace(&format!("`{piece}`"), &told);
        }
    }
    text
}

/// The parameter and its value in a text such as `align = "rigid"`, of a parameter that is switched, or has
/// choices.
fn assigned<'a>(text: &str, params: &'a [ParamDesc]) -> Option<(&'a ParamDesc, Value)> {
    let table: Table = toml::from_str(text).ok()?;
    let (id, value) = table.into_iter().next()?;
    let desc = params.iter().find(|desc| desc.id == id.as_str())?;
    let is_sound = match &value {
        Value::Boolean(_) => desc.kind == ParamKind::BOOL,
        Value::String(choice) => {
            desc.kind == ParamKind::CHOICE && desc.choices.iter().any(|known| known.id == choice.as_str())
        }
        _ => false,
    };
    is_sound.then_some((desc, value))
}

/// A value as the panel shows it.
fn shown(desc: &ParamDesc, value: &Value) -> String {
    match value {
        Value::Boolean(true) => "on".to_owned(),
        Value::Boolean(false) => "off".to_owned(),
        other => {
            let id = other.as_str().unwrap_or_default();
            let label =
                desc.choices.iter().find(|choice| choice.id == id).map(|choice| choice.label.to_string());
            label.unwrap_or_else(|| id.to_owned())
        }
    }
}

/// Remedy that sets a parameter to a choice, or switches it, unless the parameter has that value already.
fn setting(desc: &ParamDesc, value: Value, now: Option<&Value>) -> Option<Remedy> {
    let is_default = || match &value {
        Value::Boolean(on) => desc.default_numbers.first().is_some_and(|x| *x != 0.0) == *on,
        other => other.as_str() == Some(desc.default_text.as_str()),
    };
    if now.map_or_else(is_default, |now| *now == value) {
        return None;
    }
    let text = match &value {
        Value::Boolean(on) => format!("Switch {} {}", desc.name, if *on { "on" } else { "off" }),
        _ => format!("Set {} to {}", desc.name, shown(desc, &value)),
    };
    Some(Remedy { id: desc.id.to_string(), value, text })
}

/// The remedy for something that a plugin tells: another value of a parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct Remedy {
    /// The parameter's id.
    pub id: String,
    /// The parameter's new value.
    pub value: Value,
    /// The text of the button.
    pub text: String,
}

/// Remedies that a plugin's text names: to "raise `id`", or "lower `id` to 3", or the effect of `id =
/// "choice"` or `id = true`, as many as the text names. Where the text says no number, the new value is
/// twice or half of the present one, within the parameter's range.
pub fn remedies(text: &str, params: &[ParamDesc], values: &Table) -> Vec<Remedy> {
    let pieces: Vec<&str> = text.split('`').collect();
    let mut raises = None;
    let mut found = Vec::new();
    for at in (1..pieces.len()).step_by(2) {
        raises = match [pieces[at - 1].rfind("raise "), pieces[at - 1].rfind("lower ")] {
            [None, None] => raises,
            [up, down] => Some(up > down),
        };
        if let Some((desc, value)) = assigned(pieces[at], params) {
            found.extend(setting(desc, value, values.get(desc.id.as_str())));
            continue;
        }
        let desc = params.iter().find(|desc| desc.id == pieces[at]);
        if let (Some(raises), Some(desc)) = (raises, desc) {
            let after = pieces.get(at + 1).copied().unwrap_or_default();
            found.extend(remedy(desc, values.get(pieces[at]), raises, after));
        }
    }
    found
}

fn remedy(desc: &ParamDesc, value: Option<&Value>, raises: bool, after: &str) -> Option<Remedy> {
    let is_whole = desc.kind == ParamKind::INT;
    if !is_whole && desc.kind != ParamKind::FLOAT {
        return None;
    }
    let now = number_of(desc, value);
    let said = after.strip_prefix(" to ").and_then(|rest| {
        let end = rest.find(|c: char| c == ',' || c.is_whitespace()).unwrap_or(rest.len());
        rest[..end].trim_end_matches('.').parse::<f64>().ok()
    });
    let to = said.unwrap_or(if raises { 2.0 * now } else { 0.5 * now });
    let to = to.clamp(desc.hard_range[0], desc.hard_range[1]);
    let to = if is_whole { to.round() } else { to };
    let is_better = if raises { to > now } else { to < now };
    let value = if is_whole { Value::Integer(to as i64) } else { Value::Float(to) };
    let verb = if raises { "Raise" } else { "Lower" };
    let shown = if is_whole { count(to as u64) } else { number(to) };
    let text = format!("{verb} {} to {shown}", desc.name);
    is_better.then(|| Remedy { id: desc.id.to_string(), value, text })
}

/// Purpose of a plugin that comes with the program, for those who do not know its method; empty for other
/// plugins.
pub fn purpose(plugin: &str) -> &'static str {
    match plugin {
        "blendshapes" => "For expressions and variants: mix shapes that others made.",
        "cage" => "For limbs and bodies that shall bend softly as a whole, by few points around them.",
        "control-points" => "For bringing a scan into line with landmarks that are known.",
        "curve" => "For hems, rims, cables: draw a line, and bend what is around it.",
        "displacement-paint" => {
            "For touching up by hand: swell, dig, smooth or sharpen what the brush meets."
        }
        "elastic" => "For flesh and cloth: what sags, bulges and touches itself.",
        "laplacian" => "For posing a surface with few handles: its details turn along.",
        "lattice" => "For proportions: make parts longer, thicker or leaning, by points about them.",
        "rbf" => "For soft changes of anything, scans and clouds too: move some parts, hold others.",
        "skinning" => "For characters and plants: bend them by bones.",
        "smooth" => "For noise of scans, or for more or less detail.",
        "smooth-handle" => "For quick drags of large parts with a soft border.",
        "warp" => "For twists, bends and tapers of the whole model along a line.",
        _ => "",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_text_says_of_parameters_can_be_done() {
        let params = [
            ParamDesc::int("max-centers", "Most centres", 1000).hard(8.0, 3000.0),
            ParamDesc::float("tolerance", "Tolerance", 1e-3).hard(0.0, 1.0),
            ParamDesc::float("support", "Support", 0.25).hard(0.0, 0.4),
        ];
        let told = |text: &str, values: &str| -> Vec<(String, Value, String)> {
            let found = remedies(text, &params, &toml::from_str(values).unwrap());
            found.into_iter().map(|r| (r.id, r.value, r.text)).collect()
        };
        let text = "it is met to 88 %: raise `max-centers` to 2000, or `tolerance` to 0.2. They are held all the same";
        let found = told(text, "");
        assert_eq!(found[0].1, Value::Integer(2000));
        assert_eq!(found[0].2, "Raise Most centres to 2\u{2009}000");
        assert_eq!((&*found[1].0, &found[1].1), ("tolerance", &Value::Float(0.2)));
        // A change to the present value, or to an impossible one, is no remedy.
        assert_eq!(told(text, "max-centers = 2000").len(), 1);
        assert_eq!(told("raise `max-centers` to 9000", "")[0].1, Value::Integer(3000));
        assert_eq!(told("bumps of their own: raise `support`", "")[0].1, Value::Float(0.4));
        assert_eq!(told("bumps of their own: raise `support`", "support = 0.4").len(), 0);
        assert_eq!(told("lower `support`, please", "")[0].1, Value::Float(0.125));
        assert!(told("`support` is what it is", "").is_empty());
        assert!(told("raise `nothing` or the roof", "").is_empty());
        assert!(told("raise `", "").is_empty());
    }

    #[test]
    fn choices_that_a_text_names_are_buttons() {
        let choices = [("none", "As It Is"), ("rigid", "Turned and Moved")];
        let params = [
            ParamDesc::choice("align", "Alignment", "none", &choices),
            ParamDesc::bool("any-turn", "Any turn", false),
        ];
        let told = |text: &str, values: &str| -> Vec<(Value, String)> {
            let found = remedies(text, &params, &toml::from_str(values).unwrap());
            found.into_iter().map(|r| (r.value, r.text)).collect()
        };
        let text = "they do not overlap: give `align = \"rigid\"`, or `any-turn = true`";
        let expected = [
            (Value::String("rigid".to_owned()), "Set Alignment to Turned and Moved".to_owned()),
            (Value::Boolean(true), "Switch Any turn on".to_owned()),
        ];
        assert_eq!(told(text, ""), expected);
        assert_eq!(told(text, "align = \"rigid\""), expected[1..]);
        assert!(told("`align = \"none\"` or `any-turn = false`", "").is_empty(), "it is so already");
        for nothing in ["`align = \"best\"`", "`align = 3`", "`other = true`", "`any-turn = \"yes\"`"] {
            assert!(told(nothing, "").is_empty(), "{nothing}");
        }
        let (desc, value) = assigned("align = \"rigid\"", &params).unwrap();
        assert_eq!(shown(desc, &value), "Turned and Moved");
    }

    #[test]
    fn nobody_reads_of_tables() {
        let told = |text: &str| in_window(text, None);
        assert_eq!(
            told("add a [[step.region]] with role = \"handle\""),
            "select samples, and make a handle of them"
        );
        assert_eq!(told("remove the [[step.stroke]]"), "remove its strokes");
        let joints = told("place some by [[step.joint]], or give a file with a skeleton as `skeleton`");
        assert!(joints.starts_with("place some joints (") && !joints.contains("[["), "{joints}");
        assert_eq!(told("nothing of the kind"), "nothing of the kind");
    }
}
