//! Rules on the library and its description of itself.

use crate::answer::answer;
use crate::finding::{Checked, Finding};
use crate::subject::Subject;
use simod_plugin_api::{Descriptor, InputDesc, ParamDesc, ParamKind};
use simod_session::deformer::{is_raw, limits};
use simod_session::params::{check_description, check_migration, is_id};
use simod_session::plugins::{aborts_on_panic, standard_folders};
use simod_session::{PluginOptions, PluginRegistry};
use std::path::Path;

/// The library loads: without that there would be no subject.
pub(crate) fn loads(subject: &Subject) -> Checked<Finding> {
    let plugin = &subject.plugin;
    Ok(Finding::pass(format!("{} {}", plugin.id(), plugin.version())))
}

/// Whether the host would not use a plugin with this description.
pub(crate) fn is_wrong(subject: &Subject) -> bool {
    wrong(subject.plugin.descriptor()).is_some()
}

/// The description makes sense, and is always the same.
pub(crate) fn descriptor(subject: &Subject) -> Checked<Finding> {
    let descriptor = subject.plugin.descriptor();
    if let Some(what) = subject.plugin.migration().and_then(|m| check_migration(descriptor, m).err()) {
        return Err(Finding::fail(what, "correct what `Migrate::migration` gives"));
    }
    let fail = |what| Err(Finding::fail(what, "correct what `Deformer::descriptor` gives"));
    if let Some(what) = wrong(descriptor) {
        return fail(what);
    }
    match answer("descriptor", subject.plugin.code().descriptor())? {
        Ok(again) if again == *descriptor => {}
        Ok(_) => return fail("the description is another one when asked twice".to_owned()),
        Err(refusal) => return fail(format!("asked twice, it says {}", refusal.0)),
    }
    let lacking: Vec<String> = descriptor.params.iter().filter_map(lacking).collect();
    if let Some(first) = lacking.first() {
        let more =
            if lacking.len() > 1 { format!(", and {} more", lacking.len() - 1) } else { String::new() };
        return Ok(Finding::warn(format!("{first}{more}"), "tell users what they need to know"));
    }
    Ok(Finding::pass(format!("{} parameters", descriptor.params.len())))
}

/// No text for users has an effect on a terminal, and each is as long as it may be.
pub(crate) fn texts(subject: &Subject) -> Checked<Finding> {
    let descriptor = subject.plugin.descriptor();
    if let Err(what) = limits::check(descriptor) {
        return Err(Finding::fail(what, "say less: users read names and hints in one line"));
    }
    let texts = limits::texts(descriptor);
    if let Some((text, what)) = texts.iter().find(|(text, _)| text.chars().any(is_raw)) {
        let raw = text.chars().find(|c| is_raw(*c)).unwrap_or_default();
        let hint = "write one line of plain text, without line breaks, tabs and escape sequences";
        return Err(Finding::fail(format!("{what} has a character U+{:04X} in it", u32::from(raw)), hint));
    }
    /// Most characters of a text that is read in one line.
    const LINE: usize = 500;
    if let Some((text, what)) = texts.iter().find(|(text, _)| text.chars().count() > LINE) {
        let found = format!("{what} is {} characters long", text.chars().count());
        return Ok(Finding::warn(found, "users read it in one line: say less"));
    }
    Ok(Finding::pass(format!("{} texts", texts.len())))
}

/// A panic reaches the shims that make an error of it.
pub(crate) fn unwinds(file: &Path) -> Finding {
    match aborts_on_panic(file) {
        None => Finding::skip("it is not in Rust, or not known what a panic does"),
        Some(false) => Finding::pass("panics unwind"),
        Some(true) => Finding::fail(
            "it was built with `panic = \"abort\"`: a panic ends the process that it runs in",
            "take `panic = \"abort\"` out of the profile in Cargo.toml, and build it again",
        ),
    }
}

/// The plugin's id is none of those that came with the program, so that nobody who installs it loses one.
pub(crate) fn own_id(subject: &Subject) -> Checked<Finding> {
    let plugin = &subject.plugin;
    let shipped = standard_folders().into_iter().filter(|folder| folder.shipped).collect();
    let registry = PluginRegistry::discover(&PluginOptions::in_process(shipped));
    let place = |path: &Path| path.canonicalize().ok();
    match registry.plugins().iter().find(|other| other.id() == plugin.id()) {
        Some(other) if place(other.path()) != place(plugin.path()) => Err(Finding::fail(
            format!("the id `{}` is that of a plugin that comes with the program", plugin.id()),
            "choose another id: of two plugins with one id, one is not used",
        )),
        _ => Ok(Finding::pass(format!("no plugin that comes with the program is called `{}`", plugin.id()))),
    }
}

/// Defect of a description, in words.
fn wrong(descriptor: &Descriptor) -> Option<String> {
    if let Err(what) = check_description(descriptor) {
        return Some(what);
    }
    let numbers: Vec<&str> = descriptor.version.split(['-', '+']).next().unwrap_or("").split('.').collect();
    if numbers.len() != 3 || numbers.iter().any(|n| n.parse::<u64>().is_err()) {
        return Some(format!("the version `{}` is not of three numbers", descriptor.version));
    }
    if descriptor.summary.trim().is_empty() {
        return Some("the summary is empty".to_owned());
    }
    let twice = |(i, input): &(usize, &InputDesc)| descriptor.inputs[..*i].iter().any(|o| o.id == input.id);
    if let Some((_, input)) = descriptor.inputs.iter().enumerate().find(twice) {
        return Some(format!("it names the input `{}` twice", input.id));
    }
    descriptor.params.iter().find_map(wrong_choices)
}

/// Defect of a choice's alternatives, in words.
fn wrong_choices(d: &ParamDesc) -> Option<String> {
    if let Some(choice) = d.choices.iter().find(|c| !is_id(&c.id)) {
        return Some(format!("parameter `{}` has a choice `{}`, which is not kebab-case", d.id, choice.id));
    }
    let twice = d.choices.iter().enumerate().find(|(i, c)| d.choices[..*i].iter().any(|o| o.id == c.id));
    twice.map(|(_, c)| format!("parameter `{}` has two choices `{}`", d.id, c.id))
}

/// Text that a parameter's description lacks, in words.
fn lacking(d: &ParamDesc) -> Option<String> {
    if d.name.trim().is_empty() {
        return Some(format!("parameter `{}` has no name", d.id));
    }
    if d.hint.trim().is_empty() {
        return Some(format!("parameter `{}` has no hint", d.id));
    }
    let is_number = [ParamKind::FLOAT, ParamKind::INT].contains(&d.kind);
    let ([hard_min, hard_max], [soft_min, soft_max]) = (d.hard_range, d.soft_range);
    let has_soft = soft_min.is_finite() || soft_max.is_finite();
    if is_number && has_soft && (soft_min < hard_min || soft_max > hard_max) {
        return Some(format!("parameter `{}` has a slider that shows more than its range", d.id));
    }
    let outside = |x: &f64| *x < soft_min || *x > soft_max;
    if is_number && d.default_numbers.iter().any(outside) {
        return Some(format!("parameter `{}` has a default that its slider does not show", d.id));
    }
    None
}
