//! A plugin's description of itself and its capabilities, in a form that can be kept and sent.

use serde::{Deserialize, Serialize};
use simod_plugin_api::{
    AliasDesc, ChoiceDesc, Descriptor, InputDesc, MigrationDesc, ParamDesc, ParamKind, Unit,
};

/// A plugin's description and capabilities.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct About {
    #[serde(with = "DescriptorRecord")]
    pub descriptor: Descriptor,
    pub capabilities: Capabilities,
    /// Migration of older sessions, if the plugin keeps them working.
    pub migration: Option<Migration>,
}

/// Abilities of a plugin besides deforming samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Capabilities {
    /// The plugin knows its map at any point of space.
    pub evaluate: bool,
    /// The plugin places handles of its own.
    pub handles: bool,
    /// The plugin tells when it would do nothing.
    pub is_identity: bool,
}

/// A [`MigrationDesc`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Migration {
    /// Version of the plugin's state in sessions now.
    pub state_version: u32,
    /// Former ids of parameters, and the ids of now.
    pub aliases: Vec<(String, String)>,
}

impl From<MigrationDesc> for Migration {
    fn from(desc: MigrationDesc) -> Self {
        let alias = |alias: AliasDesc| (alias.former.into(), alias.now.into());
        Self { state_version: desc.state_version, aliases: desc.aliases.into_iter().map(alias).collect() }
    }
}

/// A [`Descriptor`].
#[derive(Serialize, Deserialize)]
struct DescriptorRecord {
    id: String,
    name: String,
    version: String,
    summary: String,
    citation: String,
    author: String,
    url: String,
    params: Vec<ParamDescRecord>,
    inputs: Vec<(String, u32)>,
}

/// A [`ParamDesc`]. Numbers are kept as their bits: JSON has neither infinities nor NaN.
#[derive(Serialize, Deserialize)]
struct ParamDescRecord {
    id: String,
    name: String,
    hint: String,
    group: String,
    kind: u32,
    unit: u32,
    hard: [u64; 2],
    soft: [u64; 2],
    numbers: Vec<u64>,
    text: String,
    choices: Vec<(String, String)>,
    invalidates: bool,
}

impl DescriptorRecord {
    fn serialize<S: serde::Serializer>(d: &Descriptor, serializer: S) -> Result<S::Ok, S::Error> {
        let record = Self {
            id: d.id.to_string(),
            name: d.name.to_string(),
            version: d.version.to_string(),
            summary: d.summary.to_string(),
            citation: d.citation.to_string(),
            author: d.author.to_string(),
            url: d.url.to_string(),
            params: d.params.iter().map(ParamDescRecord::from).collect(),
            inputs: d.inputs.iter().map(|i| (i.id.to_string(), i.at_least)).collect(),
        };
        Serialize::serialize(&record, serializer)
    }

    fn deserialize<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<Descriptor, D::Error> {
        let r: Self = Deserialize::deserialize(deserializer)?;
        let input = |(id, at_least): (String, u32)| InputDesc { id: id.into(), at_least };
        Ok(Descriptor {
            citation: r.citation.into(),
            params: r.params.into_iter().map(ParamDesc::from).collect(),
            inputs: r.inputs.into_iter().map(input).collect(),
            ..Descriptor::new(&r.id, &r.name, &r.version).summary(&r.summary).author(&r.author).url(&r.url)
        })
    }
}

impl From<&ParamDesc> for ParamDescRecord {
    fn from(d: &ParamDesc) -> Self {
        Self {
            id: d.id.to_string(),
            name: d.name.to_string(),
            hint: d.hint.to_string(),
            group: d.group.to_string(),
            kind: d.kind.0,
            unit: d.unit.0,
            hard: d.hard_range.map(f64::to_bits),
            soft: d.soft_range.map(f64::to_bits),
            numbers: d.default_numbers.iter().map(|x| x.to_bits()).collect(),
            text: d.default_text.to_string(),
            choices: d.choices.iter().map(|c| (c.id.to_string(), c.label.to_string())).collect(),
            invalidates: d.invalidates_preparation,
        }
    }
}

impl From<ParamDescRecord> for ParamDesc {
    fn from(r: ParamDescRecord) -> Self {
        let choice = |(id, label): (String, String)| ChoiceDesc { id: id.into(), label: label.into() };
        Self {
            id: r.id.into(),
            name: r.name.into(),
            hint: r.hint.into(),
            group: r.group.into(),
            kind: ParamKind(r.kind),
            unit: Unit(r.unit),
            hard_range: r.hard.map(f64::from_bits),
            soft_range: r.soft.map(f64::from_bits),
            default_numbers: r.numbers.into_iter().map(f64::from_bits).collect(),
            default_text: r.text.into(),
            choices: r.choices.into_iter().map(choice).collect(),
            invalidates_preparation: r.invalidates,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_kept_comes_back() {
        let descriptor = Descriptor::new("x", "X", "1.0.0")
            .summary("Does")
            .citation("Somebody, 1999")
            .author("me")
            .url("there")
            .param(ParamDesc::float("a", "A", 0.1).hint("h").group("g").hard(0.0, f64::INFINITY))
            .param(ParamDesc::choice("b", "B", "y", &[("x", "X"), ("y", "Y")]).invalidates_preparation())
            .param(ParamDesc::point("c", "C", [0.5; 3]).unit(Unit::MODEL_LENGTH))
            .consumes(simod_plugin_api::Consumes {
                handle_regions: true,
                min_handles: 2,
                ..Default::default()
            });
        let capabilities = Capabilities { evaluate: true, ..Capabilities::default() };
        let migration = Some(MigrationDesc::new(2).alias("z", "a").into());
        let about = About { descriptor, capabilities, migration };
        let text = serde_json::to_string(&about).unwrap();
        assert_eq!(serde_json::from_str::<About>(&text).unwrap(), about);
        let bytes = postcard::to_stdvec(&about).unwrap();
        assert_eq!(postcard::from_bytes::<About>(&bytes).unwrap(), about);
    }
}
