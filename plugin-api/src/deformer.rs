//! The traits that a plugin's author implements, and the shims between them and the boundary.

use crate::{
    DeformInput, Descriptor, Extension, HandleDesc, Host, Migrate, MigrationDesc, PluginError, PluginMod,
    PluginModRef, PluginResult, PrepareInput, Scratch, Setting, Settings, State,
};
use abi_stable::{
    prefix_type::PrefixTypeTrait,
    std_types::{ROption, RResult, RSliceMut, RStr, RVec},
};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// A deformation method: prepared once, then deforming interactively.
pub trait Deformer: Sized + 'static {
    /// Result of the preparation: factorisations, weights. Immutable, shared by threads.
    type State: Send + Sync + 'static;
    /// Working memory that `deform` keeps from one call to the next. Never a place for results.
    type Scratch: Default + Send + 'static;

    /// The plugin's description of itself. Always the same; called once, at load.
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
    /// The map is that of `deform`, up to its rounding. Called by several threads at once, on blocks of any
    /// length; points may lie anywhere, and are finite.
    fn evaluate(
        state: &Self::State,
        input: &DeformInput<'_>,
        points: &mut [[f64; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()>;
}

/// A deformation with handles of its own, which users move one by one.
pub trait Handles: Deformer {
    /// The handles for these samples, this box, these parameters and joints; the input has no regions.
    ///
    /// Called before `prepare`, on any thread, and whenever the user looks at the handles: takes milliseconds
    /// at most. Ids should stay the same for as long as they mean the same. How the handles were moved comes
    /// with [`DeformInput::handle_motions`].
    fn handles(input: &PrepareInput<'_>, host: &Host<'_>) -> PluginResult<Vec<HandleDesc>>;
}

/// A deformation whose handles are the corners of a surface, as those of a cage.
pub trait HandleFaces: Handles {
    /// The faces between the handles that [`Handles::handles`] gives for the same input: for each its
    /// corners, three at least, as indices of handles, around it. Hosts draw them with their edges; where a
    /// plugin has none, handles are dots, and bones to their parents.
    ///
    /// Called as `handles` is, after it.
    fn handle_faces(input: &PrepareInput<'_>, host: &Host<'_>) -> PluginResult<Vec<Vec<u32>>>;
}

/// A deformation that knows when it does nothing.
pub trait IsIdentity: Deformer {
    /// Whether `deform` would leave all samples where they are, whatever they are: the host then calls
    /// neither `prepare` nor `deform`. The input has no samples; takes microseconds. `false` is always right.
    fn is_identity(input: &DeformInput<'_>) -> PluginResult<bool>;
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

/// Keeps panics from writing to standard error, since the host reports them as errors; with `RUST_BACKTRACE`
/// set, the plugin's author sees them all the same.
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

extern "C" fn handles<D: Handles>(
    input: &PrepareInput<'_>,
    host: &Host<'_>,
) -> RResult<RVec<HandleDesc>, PluginError> {
    guarded(|| D::handles(input, host).map(RVec::from))
}

extern "C" fn handle_faces<D: HandleFaces>(
    input: &PrepareInput<'_>,
    host: &Host<'_>,
) -> RResult<RVec<RVec<u32>>, PluginError> {
    guarded(|| D::handle_faces(input, host).map(|faces| faces.into_iter().map(RVec::from).collect()))
}

extern "C" fn is_identity<D: IsIdentity>(input: &DeformInput<'_>) -> RResult<bool, PluginError> {
    guarded(|| D::is_identity(input))
}

extern "C" fn migration<D: Migrate>() -> RResult<MigrationDesc, PluginError> {
    guarded(|| Ok(D::migration()))
}

extern "C" fn migrate<D: Migrate>(from: u32, settings: RVec<Setting>) -> RResult<RVec<Setting>, PluginError> {
    guarded(|| {
        let mut settings = Settings::new(settings.into());
        D::migrate(from, &mut settings)?;
        Ok(settings.into_inner().into())
    })
}

/// The capabilities that `export_plugin!` knows, by the words that it takes for them.
#[doc(hidden)]
pub mod capability {
    use super::{Evaluate, HandleFaces, Handles, IsIdentity};
    use crate::{
        EvaluateExtension, Extension, HandleFacesExtension, HandlesExtension, IsIdentityExtension, Migrate,
        MigrationExtension,
    };

    pub fn evaluate<D: Evaluate>() -> Extension {
        const { Extension::new(&EvaluateExtension { evaluate: super::evaluate::<D> }) }
    }

    pub fn handles<D: Handles>() -> Extension {
        const { Extension::new(&HandlesExtension { handles: super::handles::<D> }) }
    }

    pub fn handle_faces<D: HandleFaces>() -> Extension {
        const { Extension::new(&HandleFacesExtension { handle_faces: super::handle_faces::<D> }) }
    }

    pub fn is_identity<D: IsIdentity>() -> Extension {
        const { Extension::new(&IsIdentityExtension { is_identity: super::is_identity::<D> }) }
    }

    pub fn migrate<D: Migrate>() -> Extension {
        const {
            Extension::new(&MigrationExtension {
                migration: super::migration::<D>,
                migrate: super::migrate::<D>,
            })
        }
    }
}

/// The extension of an id among those that a plugin has.
#[doc(hidden)]
pub fn find_extension(id: &str, extensions: &[fn() -> Extension]) -> ROption<Extension> {
    extensions.iter().map(|extension| extension()).find(|e| e.id() == id).into()
}

/// The extension function of a plugin without extensions.
#[doc(hidden)]
pub extern "C" fn no_extension(_id: RStr<'_>) -> ROption<Extension> {
    ROption::RNone
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

/// Exports a [`Deformer`] as this library's plugin: `export_plugin!(Shift)`, or with what else it implements,
/// `export_plugin!(Shift, evaluate, handles, handle_faces, is_identity, migrate)`: [`Evaluate`], [`Handles`],
/// [`HandleFaces`], [`IsIdentity`], [`Migrate`]. Once per library.
#[macro_export]
macro_rules! export_plugin {
    ($deformer:ty $(, $capability:ident)* $(,)?) => {
        const _: () = {
            use $crate::__private::abi_stable::{library as __library, std_types as __std_types};

            extern "C" fn extension(id: __std_types::RStr<'_>) -> __std_types::ROption<$crate::Extension> {
                let known: &[fn() -> $crate::Extension] =
                    &[$($crate::__private::capability::$capability::<$deformer>),*];
                $crate::__private::find_extension(id.as_str(), known)
            }

            fn root_module() -> $crate::PluginModRef {
                $crate::__private::quiet_panics();
                $crate::__private::root_module::<$deformer>(extension)
            }

            extern "C" fn constructor() -> __library::RootModuleResult {
                __library::__call_root_module_loader(root_module)
            }

            // The name and the content are those of `abi_stable::export_root_module`, which would ask for
            // `abi_stable` among the plugin's own dependencies.
            //
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
