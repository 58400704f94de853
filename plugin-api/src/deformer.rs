//! What a plugin's author implements, and the shims between it and the boundary.

use crate::{
    DeformInput, Descriptor, EvaluateExtension, Extension, ExtensionInterface, Host, PluginError, PluginMod,
    PluginModRef, PluginResult, PrepareInput, Scratch, State,
};
use abi_stable::{
    prefix_type::PrefixTypeTrait,
    std_types::{ROption, RResult, RSliceMut, RStr},
};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// A deformation method: prepared once, then deforming interactively.
pub trait Deformer: Sized + 'static {
    /// What the preparation gives: factorisations, weights. Immutable, shared by threads.
    type State: Send + Sync + 'static;
    /// Working memory that `deform` keeps from one call to the next. Never a place for results.
    type Scratch: Default + Send + 'static;

    /// What the plugin is, and what it wants. Always the same; called once, at load.
    fn descriptor() -> Descriptor;

    /// All the work that does not depend on the handles' transforms, nor on parameters that do not invalidate
    /// the preparation.
    ///
    /// Called on a worker thread, possibly several at once. There is at least one sample; all input is finite
    /// and as the descriptor asks. May take long: tell the host's `progress`, and return its error.
    fn prepare(input: &PrepareInput<'_>, host: &Host<'_>) -> PluginResult<Self::State>;

    /// Writes the deformed position of sample `i` into `out[i]`, local coordinates, all of them, finite.
    ///
    /// `out` is as long as the samples, its content is meaningless before, and the host drops it on an error.
    /// A state is used by several threads, a scratch by one at a time. Handles that do not move must
    /// leave the samples exactly where they are.
    fn deform(
        state: &Self::State,
        input: &DeformInput<'_>,
        scratch: &mut Self::Scratch,
        out: &mut [[f32; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()>;
}

/// A deformation that is a map of space, known anywhere.
pub trait Evaluate: Deformer {
    /// Replaces each point by its image, local coordinates, in double precision.
    ///
    /// The same map as `deform`, up to its rounding. Called by several threads at once, on blocks of any length;
    /// points may lie anywhere, and are finite.
    fn evaluate(
        state: &Self::State,
        input: &DeformInput<'_>,
        points: &mut [[f64; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()>;
}

/// Runs the plugin's code; a panic becomes an error, since it must not unwind across the boundary.
fn guarded<T>(call: impl FnOnce() -> PluginResult<T>) -> RResult<T, PluginError> {
    match catch_unwind(AssertUnwindSafe(call)) {
        Ok(result) => result.into(),
        Err(payload) => {
            let text = payload
                .downcast_ref::<&str>()
                .copied()
                .or_else(|| payload.downcast_ref::<String>().map(String::as_str));
            let message = format!("panicked: {}", text.unwrap_or("without a message"));
            // A payload's destructor may panic again.
            std::mem::forget(payload);
            RResult::RErr(
                PluginError::new(crate::ErrorCode::PANICKED, message)
                    .hint("this is a bug of the plugin; tell its author"),
            )
        }
    }
}

/// Keeps panics from writing to standard error, since the host reports them as errors; with `RUST_BACKTRACE` set,
/// the plugin's author sees them all the same.
///
/// Called when the library is loaded. The hook is its own: a cdylib has a standard library to itself.
pub fn quiet_panics() {
    if std::env::var_os("RUST_BACKTRACE").is_none_or(|value| value == "0") {
        std::panic::set_hook(Box::new(|_| {}));
    }
}

fn content<D: Deformer>(state: &State) -> PluginResult<&D::State> {
    state.get().ok_or_else(|| PluginError::internal("the host passed the state of another plugin"))
}

extern "C" fn descriptor<D: Deformer>() -> RResult<Descriptor, PluginError> {
    guarded(|| Ok(D::descriptor()))
}

extern "C" fn prepare<D: Deformer>(input: &PrepareInput<'_>, host: &Host<'_>) -> RResult<State, PluginError> {
    guarded(|| D::prepare(input, host).map(State::new))
}

extern "C" fn new_scratch<D: Deformer>() -> RResult<Scratch, PluginError> {
    guarded(|| Ok(Scratch::new(D::Scratch::default())))
}

extern "C" fn deform<D: Deformer>(
    state: &State,
    input: &DeformInput<'_>,
    scratch: &mut Scratch,
    mut out: RSliceMut<'_, [f32; 3]>,
    host: &Host<'_>,
) -> RResult<(), PluginError> {
    guarded(|| {
        let scratch = scratch
            .get_mut()
            .ok_or_else(|| PluginError::internal("the host passed the scratch of another plugin"))?;
        D::deform(content::<D>(state)?, input, scratch, out.as_mut_slice(), host)
    })
}

extern "C" fn evaluate<D: Evaluate>(
    state: &State,
    input: &DeformInput<'_>,
    mut points: RSliceMut<'_, [f64; 3]>,
    host: &Host<'_>,
) -> RResult<(), PluginError> {
    guarded(|| D::evaluate(content::<D>(state)?, input, points.as_mut_slice(), host))
}

/// The extension function of a plugin without extensions.
#[doc(hidden)]
pub extern "C" fn no_extension(_id: RStr<'_>) -> ROption<Extension> {
    ROption::RNone
}

/// The extension function of a plugin that evaluates.
#[doc(hidden)]
pub extern "C" fn evaluate_extension<D: Evaluate>(id: RStr<'_>) -> ROption<Extension> {
    let table: &'static EvaluateExtension = const { &EvaluateExtension { evaluate: evaluate::<D> } };
    if id.as_str() == EvaluateExtension::ID { ROption::RSome(Extension::new(table)) } else { ROption::RNone }
}

/// The root module of a plugin.
#[doc(hidden)]
pub fn root_module<D: Deformer>(extension: extern "C" fn(RStr<'_>) -> ROption<Extension>) -> PluginModRef {
    PluginMod {
        descriptor: descriptor::<D>,
        prepare: prepare::<D>,
        new_scratch: new_scratch::<D>,
        deform: deform::<D>,
        extension,
    }
    .leak_into_prefix()
}

/// Exports a [`Deformer`] as this library's plugin: `export_plugin!(Shift)`, or `export_plugin!(Shift,
/// evaluate)` where it also is [`Evaluate`]. Once per library.
#[macro_export]
macro_rules! export_plugin {
    ($deformer:ty) => {
        $crate::__export_plugin!($deformer, $crate::__private::no_extension);
    };
    ($deformer:ty, evaluate) => {
        $crate::__export_plugin!($deformer, $crate::__private::evaluate_extension::<$deformer>);
    };
}

/// What `abi_stable::export_root_module` writes, without asking for `abi_stable` among the plugin's own
/// dependencies.
#[doc(hidden)]
#[macro_export]
macro_rules! __export_plugin {
    ($deformer:ty, $extension:expr) => {
        const _: () = {
            use $crate::__private::abi_stable::library as __library;

            fn root_module() -> $crate::PluginModRef {
                $crate::__private::quiet_panics();
                $crate::__private::root_module::<$deformer>($extension)
            }

            extern "C" fn constructor() -> __library::RootModuleResult {
                __library::__call_root_module_loader(root_module)
            }

            // SAFETY: the name is abi_stable's own for this static, and nothing else uses it; the constructor
            // gives a `PluginModRef`, the type that is named.
            #[allow(unsafe_code)]
            #[unsafe(export_name = "_1as_0lib_1header_0root_bmodule_bloader")]
            pub static LIB_HEADER: __library::LibHeader = unsafe {
                __library::LibHeader::from_constructor::<$crate::PluginModRef>(
                    constructor,
                    __library::CheckTypeLayout::Yes,
                )
            };
        };
    };
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Bounds, ErrorCode, Samples};

    struct Panics;
    impl Deformer for Panics {
        type State = ();
        type Scratch = ();
        fn descriptor() -> Descriptor {
            Descriptor::new("panics", "Panics", "1.0.0")
        }
        fn prepare(_: &PrepareInput<'_>, _: &Host<'_>) -> PluginResult<()> {
            panic!("no {}", "way")
        }
        fn deform(
            _: &(),
            _: &DeformInput<'_>,
            _: &mut (),
            out: &mut [[f32; 3]],
            _: &Host<'_>,
        ) -> PluginResult<()> {
            out[1000] = [0.0; 3];
            Ok(())
        }
    }

    fn samples() -> Samples<'static> {
        Samples::new(&[[0.0; 3]], &[], &[])
    }
    const BOUNDS: Bounds = Bounds { min: [0.0; 3], max: [0.0; 3] };

    #[test]
    fn panics_become_errors() {
        let module = root_module::<Panics>(no_extension);
        let input = PrepareInput::new(samples(), BOUNDS, &[], &[]);
        let error = module.prepare()(&input, &Host::new(&())).into_result().unwrap_err();
        assert_eq!((error.code, error.message.as_str()), (ErrorCode::PANICKED, "panicked: no way"));

        let mut scratch = module.new_scratch()().into_result().unwrap();
        let input = DeformInput::new(samples(), BOUNDS, &[], &[]);
        let mut out = [[0.0; 3]];
        let mut deform = |state: &State| {
            module.deform()(state, &input, &mut scratch, out.as_mut_slice().into(), &Host::new(&()))
        };
        let error = deform(&State::new(())).into_result().unwrap_err();
        assert_eq!(error.code, ErrorCode::PANICKED);
        let error = deform(&State::new(7u8)).into_result().unwrap_err();
        assert_eq!(error.code, ErrorCode::INTERNAL);
    }

    #[test]
    fn the_exported_name_is_what_abi_stable_looks_for() {
        assert_eq!(abi_stable::library::ROOT_MODULE_LOADER_NAME, "_1as_0lib_1header_0root_bmodule_bloader");
    }
}
