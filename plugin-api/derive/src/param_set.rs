//! `#[derive(ParamSet)]`.

use std::collections::HashSet;

use proc_macro2::TokenStream;
use quote::{quote, quote_spanned};
use syn::spanned::Spanned;
use syn::{Data, DataStruct, DeriveInput, Error, ExprRange, Field, Fields, Ident, Type};

use crate::names;
use crate::words::{KindFunctions, ParamWords};

/// The implementation of the trait.
pub fn expand(input: &DeriveInput) -> syn::Result<TokenStream> {
    let Data::Struct(DataStruct { fields: Fields::Named(fields), .. }) = &input.data else {
        return Err(Error::new_spanned(&input.ident, "a set of parameters is a struct with named fields"));
    };
    let mut used = HashSet::new();
    let (mut descriptions, mut reads) = (Vec::new(), Vec::new());
    let mut errors: Option<Error> = None;
    for field in &fields.named {
        match parameter(field, &mut used) {
            Ok(parameter) => {
                descriptions.push(parameter.description);
                reads.push(parameter.read);
            }
            // All that is wrong is told at once.
            Err(error) => match &mut errors {
                Some(errors) => errors.combine(error),
                None => errors = Some(error),
            },
        }
    }
    if let Some(errors) = errors {
        return Err(errors);
    }
    let ident = &input.ident;
    let (impl_generics, ty_generics, where_clause) = input.generics.split_for_impl();
    Ok(quote! {
        #[automatically_derived]
        impl #impl_generics ::simod_plugin_api::ParamSet for #ident #ty_generics #where_clause {
            fn describe() -> ::std::vec::Vec<::simod_plugin_api::ParamDesc> {
                ::std::vec![#(#descriptions),*]
            }

            fn read(
                params: &::simod_plugin_api::Params<'_>,
            ) -> ::simod_plugin_api::PluginResult<Self> {
                ::std::result::Result::Ok(Self { #(#reads),* })
            }
        }
    })
}

struct Parameter {
    /// An expression: its `ParamDesc`.
    description: TokenStream,
    /// The field with its value, as in a struct's expression.
    read: TokenStream,
}

fn parameter(field: &Field, used: &mut HashSet<String>) -> syn::Result<Parameter> {
    let Some(ident) = &field.ident else { return Err(Error::new_spanned(field, "the field has no name")) };
    let ty = &field.ty;
    let words = ParamWords::parse(&field.attrs)?;
    let id = names::id(ident, words.id.as_ref(), used)?;
    let name = words.name.as_ref().map_or_else(|| names::sentence(ident), |name| name.value());
    let hint = words.hint.as_ref().map_or_else(|| names::first_paragraph(&field.attrs), |hint| hint.value());
    let Some(default) = &words.default else {
        let what = format!("the parameter `{ident}` has no default: give one, as `#[param(default = …)]`");
        return Err(Error::new_spanned(ident, what));
    };

    let (make, read) = match &words.kind {
        Some(kind) => named_kind(kind, ty, &id, &name, default),
        None => {
            let ty_spanned = quote_spanned!(ty.span()=> <#ty as ::simod_plugin_api::ParamType>);
            (quote!(#ty_spanned::describe(#id, #name, #default)), quote!(#ty_spanned::read(params, #id)?))
        }
    };
    let group = words.group.map(|group| quote!(.group(#group)));
    let unit = words.unit.map(|unit| quote!(.unit(::simod_plugin_api::Unit::#unit)));
    let hard = words.hard.map(|range| limits(&Ident::new("hard", range.span()), &range, ty));
    let soft = words.soft.map(|range| limits(&Ident::new("soft", range.span()), &range, ty));
    let invalidates = words.invalidates_preparation.then(|| quote!(.invalidates_preparation()));
    Ok(Parameter {
        description: quote!(#make.hint(#hint) #group #unit #hard #soft #invalidates),
        read: quote!(#ident: #read),
    })
}

/// Code that describes and reads a parameter whose kind its type does not tell. The compiler checks that the
/// type fits.
fn named_kind(
    KindFunctions { make, read }: &KindFunctions,
    ty: &Type,
    id: &str,
    name: &str,
    default: &syn::Expr,
) -> (TokenStream, TokenStream) {
    let value = quote_spanned!(ty.span()=> params.#read(#id)?);
    (quote!(::simod_plugin_api::ParamDesc::#make(#id, #name, #default)), value)
}

/// `.hard(from, to)` or `.soft(from, to)`; infinite where the range has no end.
fn limits(method: &Ident, range: &ExprRange, ty: &Type) -> TokenStream {
    let bound = |bound: &Option<Box<syn::Expr>>, otherwise: TokenStream| match bound {
        Some(x) => quote_spanned!(x.span()=> <#ty as ::simod_plugin_api::Ranged>::bound(#x)),
        None => otherwise,
    };
    let from = bound(&range.start, quote!(::std::primitive::f64::NEG_INFINITY));
    let to = bound(&range.end, quote!(::std::primitive::f64::INFINITY));
    quote!(.#method(#from, #to))
}
