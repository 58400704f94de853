//! `#[derive(Choice)]`.

use std::collections::HashSet;

use proc_macro2::TokenStream;
use quote::quote;
use syn::{Data, DeriveInput, Error, Fields};

use crate::names;
use crate::words::ChoiceWords;

/// The implementation of the trait.
pub fn expand(input: &DeriveInput) -> syn::Result<TokenStream> {
    let ident = &input.ident;
    let Data::Enum(data) = &input.data else {
        return Err(Error::new_spanned(ident, "a choice is an enum"));
    };
    if data.variants.is_empty() {
        return Err(Error::new_spanned(ident, "a choice has at least one alternative"));
    }
    let mut used = HashSet::new();
    let (mut variants, mut ids, mut labels) = (Vec::new(), Vec::new(), Vec::new());
    for variant in &data.variants {
        if !matches!(variant.fields, Fields::Unit) {
            let what = "an alternative has no fields: what depends on it are parameters of their own";
            return Err(Error::new_spanned(variant, what));
        }
        let words = ChoiceWords::parse(&variant.attrs)?;
        ids.push(names::id(&variant.ident, words.id.as_ref(), &mut used)?);
        labels.push(words.label.map_or_else(|| names::sentence(&variant.ident), |label| label.value()));
        variants.push(&variant.ident);
    }
    Ok(quote! {
        #[automatically_derived]
        impl ::simod_plugin_api::Choice for #ident {
            const ALL: &'static [Self] = &[#(Self::#variants),*];

            fn id(&self) -> &'static str {
                match self { #(Self::#variants => #ids),* }
            }

            fn label(&self) -> &'static str {
                match self { #(Self::#variants => #labels),* }
            }
        }
    })
}
