//! Names and comments of the code as ids, names for the user, and hints.

use std::collections::HashSet;

use heck::ToKebabCase;
use syn::ext::IdentExt;
use syn::{Attribute, Error, Expr, ExprLit, Ident, Lit, LitStr, Meta};

/// The stable id of a field or a variant: as given, or its name in kebab-case. Each id can be used once.
pub fn id(ident: &Ident, given: Option<&LitStr>, used: &mut HashSet<String>) -> syn::Result<String> {
    let (id, span) = match given {
        Some(given) => (given.value(), given.span()),
        None => (ident.unraw().to_string().to_kebab_case(), ident.span()),
    };
    if id.is_empty() || !id.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-') {
        let what =
            format!("`{id}` is no id: give one of small letters, digits and hyphens, as `id = \"max-size\"`");
        return Err(Error::new(span, what));
    }
    if !used.insert(id.clone()) {
        return Err(Error::new(span, format!("the id `{id}` is used twice")));
    }
    Ok(id)
}

/// Name of an item for the user: its name in the code as words, the first one capitalised.
pub fn sentence(ident: &Ident) -> String {
    let words = ident.unraw().to_string().to_kebab_case().replace('-', " ");
    let mut letters = words.chars();
    letters.next().into_iter().flat_map(char::to_uppercase).chain(letters).collect()
}

/// The first paragraph of the documentation, as a line without a full stop; empty where there is none.
pub fn first_paragraph(attributes: &[Attribute]) -> String {
    let lines = attributes.iter().filter(|a| a.path().is_ident("doc")).filter_map(|a| match &a.meta {
        Meta::NameValue(doc) => match &doc.value {
            Expr::Lit(ExprLit { lit: Lit::Str(text), .. }) => Some(text.value()),
            _ => None,
        },
        _ => None,
    });
    // A block comment has all of its lines in one attribute.
    let lines: Vec<String> = lines
        .flat_map(|text| text.split('\n').map(|line| line.trim().to_owned()).collect::<Vec<_>>())
        .collect();
    let paragraph: Vec<&str> = lines
        .iter()
        .map(String::as_str)
        .skip_while(|line| line.is_empty())
        .take_while(|line| !line.is_empty())
        .collect();
    let paragraph = paragraph.join(" ");
    paragraph.strip_suffix('.').unwrap_or(&paragraph).to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use syn::parse_quote;

    fn ident(text: &str) -> Ident {
        syn::parse_str(text).unwrap()
    }

    #[test]
    fn ids_and_names_follow_from_names_in_the_code() {
        for (name, expected, words) in [
            ("angle", "angle", "Angle"),
            ("max_centers", "max-centers", "Max centers"),
            ("r#type", "type", "Type"),
            ("ProjectedBarycentric", "projected-barycentric", "Projected barycentric"),
        ] {
            let name = if name == "r#type" { parse_quote!(r#type) } else { ident(name) };
            assert_eq!(id(&name, None, &mut HashSet::new()).unwrap(), expected);
            assert_eq!(sentence(&name), words);
        }
    }

    #[test]
    fn ids_are_kebab_case_and_used_once() {
        let mut used = HashSet::new();
        let mut with = |name, given: Option<&str>| {
            let given = given.map(|g| LitStr::new(g, proc_macro2::Span::call_site()));
            id(&ident(name), given.as_ref(), &mut used)
        };
        assert_eq!(with("a", None).unwrap(), "a");
        assert_eq!(with("b", Some("first-b")).unwrap(), "first-b");
        assert!(with("c", Some("first-b")).unwrap_err().to_string().contains("used twice"));
        for bad in ["", "Big", "a b", "a_b", "größe"] {
            assert!(with("d", Some(bad)).unwrap_err().to_string().contains("small letters"), "{bad}");
        }
        assert!(with("größe", None).is_err());
    }

    #[test]
    fn a_hint_is_the_first_paragraph() {
        let hint = |attributes: Vec<Attribute>| first_paragraph(&attributes);
        assert_eq!(hint(vec![]), "");
        assert_eq!(
            hint(vec![
                parse_quote!(#[doc = " Turned at the end,"]),
                parse_quote!(#[param(point)]),
                parse_quote!(#[doc = " not at the start."]),
                parse_quote!(#[doc = ""]),
                parse_quote!(#[doc = " More."]),
            ]),
            "Turned at the end, not at the start"
        );
        assert_eq!(hint(vec![parse_quote!(#[doc = "\n  In a\n  block\n\n  comment "])]), "In a block");
    }
}
