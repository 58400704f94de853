//! A C plugin's description, in the words of the Rust interface.

use super::read::{list, one, text, text_or_none};
use crate::deformer::Migration;
use abi_stable::std_types::{RString, RVec};
use simod_plugin_api::c::{SimodDescriptor, SimodHandleDesc, SimodMigration, SimodParam, SimodParamDesc};
use simod_plugin_api::{
    ChoiceDesc, Descriptor, Gizmo, HandleDesc, InputDesc, ParamDesc, ParamKind, PluginResult, Setting, Unit,
};

/// A plugin's description.
///
/// # Safety
/// The pointer and those in what it points to are NULL or as the header says.
pub(super) unsafe fn descriptor(pointer: *const SimodDescriptor) -> PluginResult<Descriptor> {
    // SAFETY: by the contract, for all that follow.
    unsafe {
        let d = one(pointer, "the description")?;
        let params = list(d.params, d.param_count, "the parameters")?.iter();
        let params = params.enumerate().map(|(i, p)| param(p, i)).collect::<PluginResult<RVec<_>>>()?;
        let inputs = list(d.inputs, d.input_count, "the inputs")?.iter().map(|input| {
            Ok(InputDesc { id: text(input.id, "the id of an input")?.into(), at_least: input.at_least })
        });
        Ok(Descriptor {
            id: text(d.id, "the plugin's id")?.into(),
            name: text(d.name, "the plugin's name")?.into(),
            version: text(d.version, "the plugin's version")?.into(),
            summary: text(d.summary, "the plugin's summary")?.into(),
            citation: text_or_none(d.citation, "the plugin's citation")?.into(),
            author: text_or_none(d.author, "the plugin's author")?.into(),
            url: text_or_none(d.url, "the plugin's address")?.into(),
            params,
            inputs: inputs.collect::<PluginResult<_>>()?,
        })
    }
}

/// A parameter's description.
///
/// # Safety
/// The pointers in it are NULL or as the header says.
unsafe fn param(d: &SimodParamDesc, index: usize) -> PluginResult<ParamDesc> {
    // SAFETY: by the contract, for all that follow.
    unsafe {
        let id = text(d.id, &format!("the id of parameter {index}"))?;
        let of = |what: &str| format!("the {what} of parameter `{id}`");
        let kind = ParamKind(d.kind);
        // A kind that this version does not know has no fixed count of numbers: it is refused.
        let fixed = match kind {
            ParamKind::FLOAT | ParamKind::INT | ParamKind::BOOL | ParamKind::MODEL => 1,
            ParamKind::DIRECTION | ParamKind::POINT => 3,
            ParamKind::COLOUR => 4,
            _ => 0,
        };
        let more = list(d.default_list, d.default_list_length, &of("default numbers"))?;
        let choices = list(d.choices, d.choice_count, &of("choices"))?.iter().map(|choice| {
            let id = text(choice.id, &of("id of a choice"))?;
            let label = text_or_none(choice.label, &of("label of a choice"))?;
            Ok(ChoiceDesc { label: or(label, &id), id: id.into() })
        });
        Ok(ParamDesc {
            name: or(text_or_none(d.name, &of("name"))?, &id),
            hint: text_or_none(d.hint, &of("hint"))?.into(),
            group: text_or_none(d.group, &of("group"))?.into(),
            kind,
            unit: Unit(d.unit),
            hard_range: range(d.hard_range),
            soft_range: range(d.soft_range),
            default_numbers: d.default_numbers[..fixed].iter().chain(more).copied().collect(),
            default_text: text_or_none(d.default_text, &of("default"))?.into(),
            choices: choices.collect::<PluginResult<_>>()?,
            invalidates_preparation: d.invalidates_preparation != 0,
            id: id.into(),
        })
    }
}

/// A text, or another one where it is empty.
fn or(text: String, other: &str) -> RString {
    if text.is_empty() { other.into() } else { text.into() }
}

/// A range that was left out has no end.
fn range(range: [f64; 2]) -> [f64; 2] {
    if range == [0.0; 2] { [f64::NEG_INFINITY, f64::INFINITY] } else { range }
}

/// A handle that a plugin places.
///
/// # Safety
/// The pointer and those in what it points to are NULL or as the header says.
pub(super) unsafe fn handle(pointer: *const SimodHandleDesc) -> PluginResult<HandleDesc> {
    // SAFETY: by the contract, for all that follow.
    unsafe {
        let d = one(pointer, "a handle")?;
        let gizmo = if d.gizmo == 0 { Gizmo::TRANSLATE } else { Gizmo(d.gizmo) };
        let name = text_or_none(d.name, "the name of a handle")?;
        let handle = HandleDesc::new(&text(d.id, "the id of a handle")?, d.position);
        Ok(handle.name(&name).gizmo(gizmo).parent(d.parent))
    }
}

/// Reads a plugin's description of its older sessions.
///
/// # Safety
/// The pointers in `m` are NULL or as the header says.
pub(super) unsafe fn migration(m: &SimodMigration) -> PluginResult<Migration> {
    // SAFETY: by the contract, for all that follow.
    unsafe {
        let aliases = list(m.aliases, m.alias_count, "the aliases")?.iter();
        let alias =
            aliases.map(|a| Ok((text(a.former, "an alias")?, text(a.now, "the id that an alias is of")?)));
        Ok(Migration { state_version: m.state_version, aliases: alias.collect::<PluginResult<_>>()? })
    }
}

/// A setting that a plugin gives.
///
/// # Safety
/// The pointer and those in what it points to are NULL or as the header says.
pub(super) unsafe fn setting(pointer: *const SimodParam) -> PluginResult<Setting> {
    // SAFETY: by the contract, for all that follow.
    unsafe {
        let s = one(pointer, "a setting")?;
        let id = text(s.id, "the id of a setting")?;
        let numbers = list(s.numbers, s.count, &format!("the numbers of the setting `{id}`"))?;
        let text = text_or_none(s.text, &format!("the text of the setting `{id}`"))?;
        Ok(Setting { kind: ParamKind(s.kind), numbers: numbers.into(), text: text.into(), id: id.into() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use simod_plugin_api::c::{
        SIMOD_PARAM_CHOICE, SIMOD_PARAM_CURVE, SIMOD_PARAM_POINT, SIMOD_ROOT, SimodChoiceDesc, SimodInputDesc,
    };
    use std::ffi::c_char;
    use std::ptr::null;

    /// Description of a parameter that C's empty initialiser gives.
    const NOTHING: SimodParamDesc = SimodParamDesc {
        id: null(),
        name: null(),
        hint: null(),
        group: null(),
        kind: 0,
        unit: 0,
        hard_range: [0.0; 2],
        soft_range: [0.0; 2],
        default_numbers: [0.0; 4],
        default_list: null(),
        default_list_length: 0,
        default_text: null(),
        choices: null(),
        choice_count: 0,
        invalidates_preparation: 0,
    };

    const UNNAMED: SimodDescriptor = SimodDescriptor {
        id: c"x".as_ptr(),
        name: c"X".as_ptr(),
        version: c"1.0.0".as_ptr(),
        summary: c"Does x".as_ptr(),
        citation: null(),
        author: null(),
        url: null(),
        params: null(),
        param_count: 0,
        inputs: null(),
        input_count: 0,
    };

    /// The description of a plugin with these parameters.
    fn describe(params: &[SimodParamDesc]) -> PluginResult<Descriptor> {
        let d = SimodDescriptor { params: params.as_ptr(), param_count: params.len(), ..UNNAMED };
        // SAFETY: all pointers are good, or NULL.
        unsafe { descriptor(&d) }
    }

    #[test]
    fn what_is_left_out_has_a_meaning() {
        let choices = [c"near", c"far"].map(|id| SimodChoiceDesc { id: id.as_ptr(), label: null() });
        let curve = [0.0, 1.0, 1.0, 0.0];
        let params = [
            SimodParamDesc { id: c"by".as_ptr(), kind: 1, default_numbers: [2.0; 4], ..NOTHING },
            SimodParamDesc {
                id: c"at".as_ptr(),
                kind: SIMOD_PARAM_POINT,
                default_numbers: [0.5; 4],
                ..NOTHING
            },
            SimodParamDesc {
                id: c"reach".as_ptr(),
                kind: SIMOD_PARAM_CHOICE,
                choices: choices.as_ptr(),
                choice_count: 2,
                default_text: c"far".as_ptr(),
                ..NOTHING
            },
            SimodParamDesc {
                id: c"falloff".as_ptr(),
                kind: SIMOD_PARAM_CURVE,
                default_list: curve.as_ptr(),
                default_list_length: 4,
                hard_range: [0.0, 1.0],
                ..NOTHING
            },
        ];
        let d = describe(&params).unwrap();
        let expected = [
            ParamDesc::float("by", "by", 2.0),
            ParamDesc::point("at", "at", [0.5; 3]),
            ParamDesc::choice("reach", "reach", "far", &[("near", "near"), ("far", "far")]),
            ParamDesc::curve("falloff", "falloff", &[[0.0, 1.0], [1.0, 0.0]]).hard(0.0, 1.0),
        ];
        assert_eq!(d.params.as_slice(), expected);
        assert_eq!(
            d,
            Descriptor { params: d.params.clone(), ..Descriptor::new("x", "X", "1.0.0").summary("Does x") }
        );
    }

    #[test]
    fn what_is_wrong_is_named() {
        let told = |params: &[SimodParamDesc], what: &str| {
            let error = describe(params).unwrap_err();
            assert!(error.message.contains(what), "{error}");
        };
        let by = SimodParamDesc { id: c"by".as_ptr(), kind: 1, ..NOTHING };
        told(&[by, NOTHING], "the id of parameter 1 is NULL");
        told(&[SimodParamDesc { hint: c"\xc3".as_ptr(), ..by }], "the hint of parameter `by` is not UTF-8");
        told(
            &[SimodParamDesc { choice_count: 3, ..by }],
            "choices of parameter `by` are said to be 3, and are NULL",
        );
        // SAFETY: all pointers are good, or NULL.
        unsafe {
            assert!(descriptor(null()).unwrap_err().message.contains("the description is NULL"));
            let input = SimodInputDesc { id: null(), at_least: 1 };
            let error =
                descriptor(&SimodDescriptor { inputs: &input, input_count: 1, ..UNNAMED }).unwrap_err();
            assert!(error.message.contains("the id of an input is NULL"), "{error}");
        }
    }

    #[test]
    fn handles_are_copied() {
        let described = |id: *const c_char| {
            let d =
                SimodHandleDesc { id, name: null(), position: [1.0, 2.0, 3.0], gizmo: 0, parent: SIMOD_ROOT };
            // SAFETY: all pointers are good, or NULL.
            unsafe { handle(&d) }
        };
        assert_eq!(described(c"3,3".as_ptr()), Ok(HandleDesc::new("3,3", [1.0, 2.0, 3.0])));
        assert!(described(null()).is_err());
    }
}
