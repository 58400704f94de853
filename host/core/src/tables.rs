//! Tables of TOML read into what serde derives reading for, with the values of the crate `toml`, which
//! parses them; but no tables as tuples, and no keys as numbers, which nobody here asks for. Complaints are
//! about the same places, in words for who writes such tables by hand: serde's own name types of Rust.
//!
//! The crate `toml` has a deserializer for tables, and others for values with their place, for keys, names
//! and dates: derived code is compiled for each of them. Here is one for all, so that it is compiled once.

use serde::de::{
    DeserializeOwned, DeserializeSeed, EnumAccess, Error as _, Expected, IgnoredAny, MapAccess, SeqAccess,
    Unexpected, VariantAccess, Visitor,
};
use serde::{Deserialize, Deserializer, Serialize, Serializer, forward_to_deserialize_any};
use std::borrow::{Borrow, Cow};
use std::cmp::Ordering;
use std::fmt;
use std::marker::PhantomData;
use std::ops::Range;
use toml::Spanned as Placed;
use toml::de::{DeTable, DeValue};
use toml::value::Datetime;

/// Error of a text that is not the table that was asked for: the message, and the bytes of the text that it
/// is about, where these are known.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TableError {
    message: String,
    span: Option<Range<usize>>,
}

impl TableError {
    fn new(message: impl Into<String>) -> Self {
        Self { message: message.into(), span: None }
    }

    /// Message; it may have several lines.
    pub fn message(&self) -> &str {
        &self.message
    }

    /// Range of the text that the error is about, in bytes; `None` if unknown.
    pub fn span(&self) -> Option<Range<usize>> {
        self.span.clone()
    }

    /// Copy of this error with the range `span`, unless the error has a range already.
    fn located(self, span: Option<&Range<usize>>) -> Self {
        Self { span: self.span.or_else(|| span.cloned()), ..self }
    }
}

impl fmt::Display for TableError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for TableError {}

impl serde::de::Error for TableError {
    fn custom<T: fmt::Display>(message: T) -> Self {
        Self::new(message.to_string())
    }

    fn invalid_type(found: Unexpected<'_>, wanted: &dyn Expected) -> Self {
        let wanted = wanted.to_string();
        let told = format!("{} stands where {} is wanted", name_found(found), name_wanted(&wanted));
        Self::new(match (found, wanted.as_str()) {
            (Unexpected::Map, "a sequence") => format!("{told}, in which each table begins with `[[...]]`"),
            _ => told,
        })
    }

    fn invalid_value(found: Unexpected<'_>, wanted: &dyn Expected) -> Self {
        Self::invalid_type(found, wanted)
    }

    fn missing_field(key: &'static str) -> Self {
        Self::new(format!("the key `{key}` is missing"))
    }
}

/// What stands in the text, as its writer would call it.
fn name_found(found: Unexpected<'_>) -> String {
    match found {
        Unexpected::Bool(value) => format!("`{value}`"),
        Unexpected::Unsigned(number) => format!("the number {number}"),
        Unexpected::Signed(number) => format!("the number {number}"),
        Unexpected::Float(number) => format!("the number {number:?}"),
        Unexpected::Str(text) => format!("the text {text:?}"),
        Unexpected::Seq => "a list".to_owned(),
        Unexpected::Map => "a table".to_owned(),
        Unexpected::UnitVariant => "a name alone".to_owned(),
        other => other.to_string(),
    }
}

/// What serde `expected`, in the words of TOML instead of those of Rust's types.
fn name_wanted(expected: &str) -> &str {
    match expected {
        "a boolean" => "`true` or `false`",
        "a string" => "a text in quotes",
        "path string" => "a path in quotes",
        "a sequence" => "a list",
        "a map" => "a table",
        "newtype variant" | "tuple variant" | "struct variant" => "a table with this name as its key",
        "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number that is not negative",
        "i8" | "i16" | "i32" | "i64" | "isize" => "a whole number",
        "f32" | "f64" => "a number",
        structure if structure.starts_with("struct ") => "a table",
        other => other,
    }
}

/// Reads a value from a text in TOML.
///
/// # Errors
/// The text is no TOML, or another table: what is wrong, and where.
pub fn read<T: DeserializeOwned>(text: &str) -> Result<T, TableError> {
    let table =
        DeTable::parse(text).map_err(|e| TableError { message: e.message().to_owned(), span: e.span() })?;
    T::deserialize(TableNode { what: NodeContent::Table(table.get_ref()), span: None })
}

/// Value with the bytes of the text that it stands at, if [`read`] reads it. Spanned values are compared by
/// the value alone.
#[derive(Debug, Clone, Default)]
pub struct Spanned<T> {
    span: Range<usize>,
    value: T,
}

impl<T> Spanned<T> {
    /// A value at a place.
    pub fn new(span: Range<usize>, value: T) -> Self {
        Self { span, value }
    }

    /// Range of the value in the text, in bytes.
    pub fn span(&self) -> Range<usize> {
        self.span.clone()
    }

    /// The value.
    pub fn get_ref(&self) -> &T {
        &self.value
    }

    /// The value, without its place.
    pub fn into_inner(self) -> T {
        self.value
    }
}

impl<T: PartialEq> PartialEq for Spanned<T> {
    fn eq(&self, other: &Self) -> bool {
        self.value == other.value
    }
}

impl<T: Eq> Eq for Spanned<T> {}

impl<T: Ord> PartialOrd for Spanned<T> {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl<T: Ord> Ord for Spanned<T> {
    fn cmp(&self, other: &Self) -> Ordering {
        self.value.cmp(&other.value)
    }
}

impl Borrow<str> for Spanned<String> {
    fn borrow(&self) -> &str {
        &self.value
    }
}

/// The name by which [`Spanned`] asks for a place.
const SPANNED: &str = "simod::Spanned";
/// The only key of the table that a date is to serde, as [`toml::Value`] expects it.
const DATE: &str = "$__toml_private_datetime";

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Spanned<T> {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct SpannedVisitor<T>(PhantomData<T>);

        impl<'de, T: Deserialize<'de>> Visitor<'de> for SpannedVisitor<T> {
            type Value = Spanned<T>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a spanned value")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut parts: A) -> Result<Self::Value, A::Error> {
                let missing = || A::Error::custom("value is missing a span");
                let (_, start) = parts.next_entry::<IgnoredAny, usize>()?.ok_or_else(missing)?;
                let (_, end) = parts.next_entry::<IgnoredAny, usize>()?.ok_or_else(missing)?;
                let (_, value) = parts.next_entry::<IgnoredAny, T>()?.ok_or_else(missing)?;
                Ok(Spanned { span: start..end, value })
            }
        }

        from.deserialize_struct(SPANNED, &[], SpannedVisitor(PhantomData))
    }
}

impl<T: Serialize> Serialize for Spanned<T> {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        self.value.serialize(to)
    }
}

/// Part of a text that is read, and where it stands. The whole has no place.
#[derive(Clone)]
struct TableNode<'a> {
    what: NodeContent<'a>,
    span: Option<Range<usize>>,
}

#[derive(Clone, Copy)]
enum NodeContent<'a> {
    Value(&'a DeValue<'a>),
    Table(&'a DeTable<'a>),
    /// A key, or the name of a variant.
    Name(&'a str),
    /// An end of a place.
    Byte(usize),
    Date(&'a Datetime),
}

/// A value in the form that serde takes.
enum Plain<'a> {
    Text(&'a str),
    Date(String),
    Integer(i64),
    /// An integer beyond those with a sign.
    Unsigned(u64),
    /// An integer that no type here holds.
    Other(String),
    Float(f64),
    Bool(bool),
    List(Elements<'a>),
    Table(Entries<'a>),
}

impl<'a> TableNode<'a> {
    fn value(value: &'a Placed<DeValue<'a>>) -> Self {
        Self { what: NodeContent::Value(value.get_ref()), span: Some(value.span()) }
    }

    fn name(name: &'a str, span: Option<Range<usize>>) -> Self {
        Self { what: NodeContent::Name(name), span }
    }

    fn byte(byte: usize) -> Self {
        Self { what: NodeContent::Byte(byte), span: None }
    }

    fn table(&self) -> Option<&'a DeTable<'a>> {
        match self.what {
            NodeContent::Table(table) | NodeContent::Value(DeValue::Table(table)) => Some(table),
            _ => None,
        }
    }

    fn plain(&self) -> Result<Plain<'a>, TableError> {
        let value = match self.what {
            NodeContent::Value(value) => value,
            NodeContent::Table(table) => return Ok(Plain::Table(Entries::of_table(table))),
            NodeContent::Name(name) => return Ok(Plain::Text(name)),
            NodeContent::Byte(byte) => return Ok(Plain::Unsigned(byte as u64)),
            NodeContent::Date(date) => return Ok(Plain::Date(date.to_string())),
        };
        Ok(match value {
            DeValue::String(text) => Plain::Text(text),
            DeValue::Integer(number) => return integer(number.as_str(), number.radix()),
            DeValue::Float(number) => match number.as_str().parse::<f64>() {
                Ok(float) if float.is_finite() || float.is_nan() || number.as_str().contains("inf") => {
                    Plain::Float(float)
                }
                _ => return Err(TableError::new("floating-point number overflowed")),
            },
            DeValue::Boolean(value) => Plain::Bool(*value),
            DeValue::Datetime(date) => Plain::Table(Entries::of_date(date)),
            DeValue::Array(array) => Plain::List(Elements(array.iter())),
            DeValue::Table(table) => Plain::Table(Entries::of_table(table)),
        })
    }

    /// The variant of an enumeration: a name, or a table with it as its only key.
    fn variant(&self) -> Result<Variant<'a>, TableError> {
        if let NodeContent::Value(DeValue::String(name)) = self.what {
            return Ok(Variant { name: TableNode::name(name, self.span.clone()), content: None });
        }
        let Some(table) = self.table() else {
            return Err(TableError::new("a name, or a table with one key, is wanted"));
        };
        let mut entries = table.iter();
        match (entries.next(), entries.next()) {
            (None, _) => Err(TableError::new("a table with one key is wanted, and this one has none")),
            (Some(_), Some(_)) => {
                Err(TableError::new("a table with one key is wanted, and this one has more"))
            }
            (Some((name, content)), None) => Ok(Variant {
                name: TableNode::name(name.get_ref(), Some(name.span())),
                content: Some(TableNode::value(content)),
            }),
        }
    }

    /// A variant's table has no other keys than its fields.
    fn check_keys(&self, fields: &[&str]) -> Result<(), TableError> {
        let Some(table) = self.table() else { return Ok(()) };
        let extra: Vec<_> = table.keys().filter(|key| !fields.contains(&key.get_ref().as_ref())).collect();
        let Some(first) = extra.first() else { return Ok(()) };
        let names: Vec<&str> = extra.iter().map(|key| key.get_ref().as_ref()).collect();
        let (names, fields) = (names.join(", "), fields.join(", "));
        Err(TableError::new(format!("unexpected keys in table: {names}, available keys: {fields}"))
            .located(Some(&first.span())))
    }
}

fn integer<'a>(digits: &str, radix: u32) -> Result<Plain<'a>, TableError> {
    let signed = i64::from_str_radix(digits, radix).map(Plain::Integer);
    let unsigned = || u64::from_str_radix(digits, radix).map(Plain::Unsigned);
    let long = || i128::from_str_radix(digits, radix).map(|n| Plain::Other(format!("integer `{n}` as i128")));
    let longer =
        || u128::from_str_radix(digits, radix).map(|n| Plain::Other(format!("integer `{n}` as u128")));
    let read = signed.or_else(|_| unsigned()).or_else(|_| long()).or_else(|_| longer());
    read.map_err(|_| TableError::new("integer number overflowed"))
}

impl<'a> Deserializer<'a> for TableNode<'a> {
    type Error = TableError;

    fn deserialize_any<V: Visitor<'a>>(self, visitor: V) -> Result<V::Value, TableError> {
        let read = self.plain().and_then(|plain| match plain {
            Plain::Text(text) => visitor.visit_str(text),
            Plain::Date(date) => visitor.visit_str(&date),
            Plain::Integer(number) => visitor.visit_i64(number),
            Plain::Unsigned(number) => visitor.visit_u64(number),
            Plain::Other(number) => Err(TableError::invalid_type(Unexpected::Other(&number), &visitor)),
            Plain::Float(number) => visitor.visit_f64(number),
            Plain::Bool(value) => visitor.visit_bool(value),
            Plain::List(list) => visitor.visit_seq(list),
            Plain::Table(table) => visitor.visit_map(table),
        });
        read.map_err(|e| e.located(self.span.as_ref()))
    }

    fn deserialize_option<V: Visitor<'a>>(self, visitor: V) -> Result<V::Value, TableError> {
        let span = self.span.clone();
        visitor.visit_some(self).map_err(|e| e.located(span.as_ref()))
    }

    fn deserialize_newtype_struct<V: Visitor<'a>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, TableError> {
        let span = self.span.clone();
        visitor.visit_newtype_struct(self).map_err(|e| e.located(span.as_ref()))
    }

    fn deserialize_struct<V: Visitor<'a>>(
        self,
        name: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, TableError> {
        match &self.span {
            Some(span) if name == SPANNED => visitor.visit_map(Entries::of_place(span.clone(), self)),
            _ => self.deserialize_any(visitor),
        }
    }

    fn deserialize_enum<V: Visitor<'a>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, TableError> {
        self.variant()
            .and_then(|variant| visitor.visit_enum(variant))
            .map_err(|e| e.located(self.span.as_ref()))
    }

    forward_to_deserialize_any! { <V: Visitor<'a>>
        bool u8 u16 u32 u64 u128 i8 i16 i32 i64 i128 f32 f64 char str string seq bytes byte_buf map unit
        ignored_any unit_struct tuple_struct tuple identifier
    }
}

/// The elements of an array.
struct Elements<'a>(std::slice::Iter<'a, Placed<DeValue<'a>>>);

impl<'a> SeqAccess<'a> for Elements<'a> {
    type Error = TableError;

    fn next_element_seed<T: DeserializeSeed<'a>>(&mut self, seed: T) -> Result<Option<T::Value>, TableError> {
        self.0.next().map(|value| seed.deserialize(TableNode::value(value))).transpose()
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.0.len())
    }
}

/// Keys and values: of a table, of a value with its place, or of a date.
struct Entries<'a> {
    left: std::vec::IntoIter<(TableNode<'a>, TableNode<'a>)>,
    value: Option<TableNode<'a>>,
}

impl<'a> Entries<'a> {
    fn new(all: Vec<(TableNode<'a>, TableNode<'a>)>) -> Self {
        Self { left: all.into_iter(), value: None }
    }

    fn of_table(table: &'a DeTable<'a>) -> Self {
        let entry = |(key, value): (&'a Placed<Cow<'a, str>>, _)| {
            (TableNode::name(key.get_ref(), Some(key.span())), TableNode::value(value))
        };
        Self::new(table.iter().map(entry).collect())
    }

    fn of_place(span: Range<usize>, value: TableNode<'a>) -> Self {
        let parts =
            [("start", TableNode::byte(span.start)), ("end", TableNode::byte(span.end)), ("value", value)];
        Self::new(parts.map(|(name, part)| (TableNode::name(name, None), part)).into())
    }

    fn of_date(date: &'a Datetime) -> Self {
        Self::new(vec![(
            TableNode::name(DATE, None),
            TableNode { what: NodeContent::Date(date), span: None },
        )])
    }
}

impl<'a> MapAccess<'a> for Entries<'a> {
    type Error = TableError;

    fn next_key_seed<K: DeserializeSeed<'a>>(&mut self, seed: K) -> Result<Option<K::Value>, TableError> {
        let Some((key, value)) = self.left.next() else { return Ok(None) };
        self.value = Some(value);
        let span = key.span.clone();
        seed.deserialize(key).map(Some).map_err(|e| e.located(span.as_ref()))
    }

    fn next_value_seed<V: DeserializeSeed<'a>>(&mut self, seed: V) -> Result<V::Value, TableError> {
        let value = self.value.take().ok_or_else(|| TableError::new("a value is read before its key"))?;
        let span = value.span.clone();
        seed.deserialize(value).map_err(|e| e.located(span.as_ref()))
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.left.len())
    }
}

/// Variant of an enumeration, with its content if it is more than a name.
struct Variant<'a> {
    name: TableNode<'a>,
    content: Option<TableNode<'a>>,
}

impl<'a> Variant<'a> {
    fn content(self, expected: &str) -> Result<TableNode<'a>, TableError> {
        self.content.ok_or_else(|| TableError::invalid_type(Unexpected::UnitVariant, &expected))
    }
}

impl<'a> EnumAccess<'a> for Variant<'a> {
    type Error = TableError;
    type Variant = Self;

    fn variant_seed<V: DeserializeSeed<'a>>(self, seed: V) -> Result<(V::Value, Self), TableError> {
        let name = self.name.clone();
        let variant = seed.deserialize(name).map_err(|e| e.located(self.name.span.as_ref()))?;
        Ok((variant, self))
    }
}

impl<'a> VariantAccess<'a> for Variant<'a> {
    type Error = TableError;

    fn unit_variant(self) -> Result<(), TableError> {
        let Some(TableNode { what, span }) = self.content else { return Ok(()) };
        let wrong = match what {
            NodeContent::Value(DeValue::Array(array)) if array.is_empty() => return Ok(()),
            NodeContent::Value(DeValue::Table(table)) if table.is_empty() => return Ok(()),
            NodeContent::Value(DeValue::Array(_)) => "expected empty array".to_owned(),
            NodeContent::Value(value) if !value.is_table() => {
                format!("expected table, found {}", value.type_str())
            }
            _ => "expected empty table".to_owned(),
        };
        Err(TableError::new(wrong).located(span.as_ref()))
    }

    fn newtype_variant_seed<T: DeserializeSeed<'a>>(self, seed: T) -> Result<T::Value, TableError> {
        seed.deserialize(self.content("newtype variant")?)
    }

    fn tuple_variant<V: Visitor<'a>>(self, count: usize, visitor: V) -> Result<V::Value, TableError> {
        let content = self.content("tuple variant")?;
        match content.what {
            NodeContent::Value(DeValue::Array(array)) if array.len() == count => {
                content.deserialize_any(visitor)
            }
            _ => {
                Err(TableError::new(format!("expected tuple with length {count}"))
                    .located(content.span.as_ref()))
            }
        }
    }

    fn struct_variant<V: Visitor<'a>>(
        self,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, TableError> {
        let content = self.content("struct variant")?;
        content.check_keys(fields).map_err(|e| e.located(content.span.as_ref()))?;
        content.deserialize_any(visitor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    #[derive(Debug, Deserialize, PartialEq)]
    #[serde(rename_all = "kebab-case", deny_unknown_fields)]
    struct Everything {
        text: Option<String>,
        count: Option<u32>,
        long: Option<i64>,
        size: Option<f64>,
        on: Option<bool>,
        axis: Option<[f64; 3]>,
        names: Option<Names>,
        role: Option<Role>,
        shape: Option<Shape>,
        #[serde(default)]
        inner: Vec<Inner>,
        #[serde(default)]
        params: BTreeMap<String, toml::Value>,
        exact: Option<Exact>,
    }

    #[derive(Debug, Deserialize, PartialEq)]
    #[serde(untagged)]
    enum Names {
        One(String),
        Several(Vec<String>),
    }

    #[derive(Debug, Deserialize, PartialEq)]
    #[serde(rename_all = "kebab-case")]
    enum Role {
        Fixed,
        Handle,
    }

    #[derive(Debug, Deserialize, PartialEq)]
    #[serde(rename_all = "kebab-case", deny_unknown_fields)]
    enum Shape {
        Ball { center: [f64; 3], radius: f64 },
        Points(Vec<f64>),
        Pair(f64, f64),
        All,
    }

    #[derive(Debug, Deserialize, PartialEq)]
    #[serde(deny_unknown_fields)]
    struct Inner {
        name: String,
        more: Option<Box<Inner>>,
    }

    #[derive(Debug, Deserialize, PartialEq)]
    struct Exact(#[serde(deserialize_with = "two")] Vec<f64>);

    fn two<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<f64>, D::Error> {
        let numbers = Vec::<f64>::deserialize(from)?;
        if numbers.len() == 2 { Ok(numbers) } else { Err(D::Error::custom("expected two numbers")) }
    }

    const VALUES: [&str; 42] = [
        "3",
        "-3",
        "0x10",
        "1_000",
        "9223372036854775808",
        "-9223372036854775809",
        "340282366920938463463374607431768211455",
        "999999999999999999999999999999999999999999",
        "3.5",
        "1e400",
        "-inf",
        "nan",
        "true",
        "'text'",
        "\"te\\u0078t\"",
        "'fixed'",
        "'all'",
        "'ball'",
        "'points'",
        "'pair'",
        "1979-05-27",
        "1979-05-27T07:32:00Z",
        "[]",
        "[1, 2]",
        "[1, 2, 3.5]",
        "[1, 'x', 2]",
        "['a', 'b']",
        "{}",
        "{ all = {} }",
        "{ all = [] }",
        "{ all = [1] }",
        "{ all = { x = 1 } }",
        "{ all = 3 }",
        "{ ball = { center = [0, 0, 0], radius = 1 } }",
        "{ ball = { center = [0, 0], radius = 1 } }",
        "{ ball = { center = [0, 0, 0], radius = 'x', y = 1 } }",
        "{ ball = { center = [0, 0, 0] } }",
        "{ points = [1, 2, true] }",
        "{ pair = [1, 2] }",
        "{ pair = [1] }",
        "{ fixed = {}, handle = {} }",
        "{ name = 'x', more = { name = 3 } }",
    ];

    const KEYS: [&str; 14] = [
        "text", "count", "long", "size", "on", "axis", "names", "role", "shape", "inner", "params", "exact",
        "other", "params.x",
    ];

    /// Texts with every value below every key, alone and in a list, and texts that are no TOML.
    fn texts() -> impl Iterator<Item = String> {
        let of_key =
            |key| VALUES.map(|value| [format!("# é\n{key} = {value}\n"), format!("{key} = [{value}]")]);
        let tables =
            ["", "[[inner]]\nname = 'x'\n[[inner]]\n", "[inner]\n", "a = ", "text = 'x'\ntext = 'y'"];
        let tables = tables.into_iter().map(str::to_owned);
        KEYS.into_iter().flat_map(of_key).flatten().chain(tables)
    }

    #[test]
    fn what_is_read_and_what_is_refused_is_as_toml_has_it() {
        // What is told in other words than there, by how it begins there.
        let reworded =
            ["invalid type", "invalid value", "missing field", "wanted exactly 1", "wanted string or"];
        let (mut read_well, mut refused) = (0, 0);
        for text in texts() {
            let theirs = toml::from_str::<Everything>(&text);
            match (read::<Everything>(&text), theirs) {
                (Ok(ours), Ok(theirs)) => {
                    read_well += 1;
                    // Not a number is equal to nothing.
                    assert!(ours == theirs || format!("{ours:?}") == format!("{theirs:?}"), "{text}");
                }
                (Err(ours), Err(theirs)) => {
                    refused += 1;
                    assert_eq!(ours.span(), theirs.span(), "{text}");
                    let is_reworded = reworded.iter().any(|words| theirs.message().starts_with(words));
                    assert_eq!(ours.message() == theirs.message(), !is_reworded, "{text}: {ours}");
                }
                (ours, theirs) => panic!("{text}: {ours:?}, {theirs:?}"),
            }
        }
        assert!(read_well > 100 && refused > 500, "{read_well}, {refused}");
    }

    #[test]
    fn complaints_are_in_the_words_of_who_writes_tables() {
        for (text, told) in [
            (
                "count = 'many'",
                "the text \"many\" stands where a whole number that is not negative is wanted",
            ),
            ("count = -5", "the number -5 stands where a whole number that is not negative is wanted"),
            ("size = true", "`true` stands where a number is wanted"),
            ("on = 'yes'", "the text \"yes\" stands where `true` or `false` is wanted"),
            ("text = 3", "the number 3 stands where a text in quotes is wanted"),
            ("text = { x = 1 }", "a table stands where a text in quotes is wanted"),
            ("inner = 2.5", "the number 2.5 stands where a list is wanted"),
            ("inner = [3]", "the number 3 stands where a table is wanted"),
            ("[inner]\n", "a table stands where a list is wanted, in which each table begins with `[[...]]`"),
            ("inner = [{ more = { name = 'x' } }]", "the key `name` is missing"),
            ("shape = 'ball'", "a name alone stands where a table with this name as its key is wanted"),
            ("shape = {}", "a table with one key is wanted, and this one has none"),
            ("shape = { all = {}, pair = [1, 2] }", "a table with one key is wanted, and this one has more"),
            ("shape = 3", "a name, or a table with one key, is wanted"),
        ] {
            assert_eq!(read::<Everything>(text).unwrap_err().message(), told, "{text}");
        }
    }

    /// Tables whose texts and numbers come with their places, which only one reading knows.
    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Places<Text: Ord, Numbers> {
        params: BTreeMap<Text, Numbers>,
    }

    #[test]
    fn places_are_as_toml_has_them() {
        type Ours = Places<Spanned<String>, Spanned<Vec<Spanned<f64>>>>;
        type Theirs = Places<Placed<String>, Placed<Vec<Placed<f64>>>>;
        let text = "[params]\nx = [1.5, 2.5]\n'ä y' = [ ]\n";
        let (ours, theirs) = (read::<Ours>(text).unwrap(), toml::from_str::<Theirs>(text).unwrap());
        assert_eq!(ours.params.len(), 2);
        for ((key, numbers), (their_key, theirs)) in ours.params.iter().zip(&theirs.params) {
            assert_eq!((key.get_ref(), key.span()), (their_key.get_ref(), their_key.span()));
            assert_eq!(numbers.span(), theirs.span());
            let ours = numbers.get_ref().iter().map(|n| (*n.get_ref(), n.span()));
            assert!(ours.eq(theirs.get_ref().iter().map(|n| (*n.get_ref(), n.span()))));
        }
        for text in ["[params]\nx = 3", "[params]\nx = [1.5, 'y']", "params.x = [[1.0]]", "params = 1"] {
            let (ours, theirs) =
                (read::<Ours>(text).unwrap_err(), toml::from_str::<Theirs>(text).unwrap_err());
            assert_eq!(ours.span(), theirs.span(), "{text}: {ours}, {theirs}");
        }
    }
}
