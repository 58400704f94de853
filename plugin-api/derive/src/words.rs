//! The words of `#[param(…)]` and `#[choice(…)]`.

use syn::meta::ParseNestedMeta;
use syn::{Attribute, Error, Expr, ExprRange, Ident, LitStr, RangeLimits};

/// Kinds that a field's type does not tell: the word for each, which is also the function of `ParamDesc` that
/// makes it, and the method of `Params` that reads it. Those that the type tells implement `ParamType`.
const KINDS: [(&str, &str); 3] = [("colour", "colour"), ("direction", "vec3"), ("point", "vec3")];

/// A kind that is named, where the type does not tell it.
pub struct KindFunctions {
    /// The function of `ParamDesc` that makes it.
    pub make: Ident,
    /// The method of `Params` that reads it.
    pub read: Ident,
}

/// All that can be said of a parameter.
#[derive(Default)]
pub struct ParamWords {
    pub id: Option<LitStr>,
    pub name: Option<LitStr>,
    pub hint: Option<LitStr>,
    pub group: Option<LitStr>,
    pub default: Option<Expr>,
    /// A constant of `Unit`.
    pub unit: Option<Ident>,
    pub hard: Option<ExprRange>,
    pub soft: Option<ExprRange>,
    pub kind: Option<KindFunctions>,
    pub invalidates_preparation: bool,
}

impl ParamWords {
    pub fn parse(attributes: &[Attribute]) -> syn::Result<Self> {
        let mut words = Self::default();
        for attribute in attributes.iter().filter(|a| a.path().is_ident("param")) {
            attribute.parse_nested_meta(|meta| words.take(&meta))?;
        }
        Ok(words)
    }

    fn take(&mut self, meta: &ParseNestedMeta<'_>) -> syn::Result<()> {
        let word = meta.path.get_ident().map(Ident::to_string).unwrap_or_default();
        if let Some((_, read)) = KINDS.iter().find(|(kind, _)| *kind == word) {
            let span = meta.path.segments[0].ident.span();
            let kind = KindFunctions { make: Ident::new(&word, span), read: Ident::new(read, span) };
            return match self.kind.replace(kind) {
                Some(_) => Err(meta.error("a parameter has one kind")),
                None => Ok(()),
            };
        }
        match word.as_str() {
            "id" => set(&mut self.id, meta, text),
            "name" => set(&mut self.name, meta, text),
            "hint" => set(&mut self.hint, meta, text),
            "group" => set(&mut self.group, meta, text),
            "default" => set(&mut self.default, meta, |meta| meta.value()?.parse()),
            "unit" => set(&mut self.unit, meta, unit),
            "hard" => set(&mut self.hard, meta, range),
            "soft" => set(&mut self.soft, meta, range),
            "invalidates_preparation" => {
                self.invalidates_preparation = true;
                Ok(())
            }
            _ => {
                let kinds: Vec<String> = KINDS.iter().map(|(kind, _)| format!("`{kind}`")).collect();
                Err(meta.error(format!(
                    "unknown word; there are `default`, `name`, `unit`, `hard`, `soft`, `group`, `hint`, `id`, \
                     `invalidates_preparation`, and the kinds {}",
                    kinds.join(", ")
                )))
            }
        }
    }
}

/// All that can be said of an alternative.
#[derive(Default)]
pub struct ChoiceWords {
    pub id: Option<LitStr>,
    pub label: Option<LitStr>,
}

impl ChoiceWords {
    pub fn parse(attributes: &[Attribute]) -> syn::Result<Self> {
        let mut words = Self::default();
        for attribute in attributes.iter().filter(|a| a.path().is_ident("choice")) {
            attribute.parse_nested_meta(|meta| {
                if meta.path.is_ident("id") {
                    set(&mut words.id, &meta, text)
                } else if meta.path.is_ident("label") {
                    set(&mut words.label, &meta, text)
                } else {
                    Err(meta.error("unknown word; there are `id` and `label`"))
                }
            })?;
        }
        Ok(words)
    }
}

/// Takes what follows a word, which may be said once.
fn set<T>(
    place: &mut Option<T>,
    meta: &ParseNestedMeta<'_>,
    value: impl Fn(&ParseNestedMeta<'_>) -> syn::Result<T>,
) -> syn::Result<()> {
    match place.replace(value(meta)?) {
        Some(_) => Err(meta.error("said twice")),
        None => Ok(()),
    }
}

fn text(meta: &ParseNestedMeta<'_>) -> syn::Result<LitStr> {
    meta.value()?.parse()
}

/// A constant of `Unit` by its name in kebab-case. Whether there is such a one, the compiler says.
fn unit(meta: &ParseNestedMeta<'_>) -> syn::Result<Ident> {
    let text = text(meta)?;
    let name = text.value();
    if name.is_empty() || !name.chars().all(|c| c.is_ascii_lowercase() || c == '-') {
        let what = "a unit is a constant of `Unit` in kebab-case, as \"degrees\" or \"model-length\"";
        return Err(Error::new(text.span(), what));
    }
    Ok(Ident::new(&name.to_uppercase().replace('-', "_"), text.span()))
}

fn range(meta: &ParseNestedMeta<'_>) -> syn::Result<ExprRange> {
    let range: Expr = meta.value()?.parse()?;
    match range {
        Expr::Range(ExprRange { end: Some(_), limits: RangeLimits::HalfOpen(_), .. }) => {
            Err(Error::new_spanned(range, "a range has its end: write `..=`"))
        }
        Expr::Range(range) => Ok(range),
        other => Err(Error::new_spanned(other, "give a range, as `0.0..=1.0`, `0.0..` or `..=1.0`")),
    }
}
