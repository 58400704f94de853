//! The derives of `simod-plugin-api`, which exports them and documents their use: `ParamSet` for a struct of
//! a plugin's parameters, and `Choice` for an enum of alternatives.

mod choice;
mod names;
mod param_set;
mod words;

use proc_macro::TokenStream;
use syn::{DeriveInput, parse_macro_input};

/// Describes a struct's fields as parameters, and reads their values. See the trait of the same name.
#[proc_macro_derive(ParamSet, attributes(param))]
pub fn param_set(input: TokenStream) -> TokenStream {
    let input = parse_macro_input!(input as DeriveInput);
    param_set::expand(&input).unwrap_or_else(syn::Error::into_compile_error).into()
}

/// Makes an enum without fields a parameter's alternatives. See the trait of the same name.
#[proc_macro_derive(Choice, attributes(choice))]
pub fn choice(input: TokenStream) -> TokenStream {
    let input = parse_macro_input!(input as DeriveInput);
    choice::expand(&input).unwrap_or_else(syn::Error::into_compile_error).into()
}
