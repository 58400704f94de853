//! A plugin that does wrong what the environment variable `SIMOD_MISBEHAVE` says, or else its parameter
//! `how`, and shifts by 1 along x where it does nothing wrong.
#![allow(unsafe_code, reason = "to write where nobody may is one of the things to do wrong")]

use simod_plugin_api::{
    Consumes, DeformInput, Deformer, Descriptor, Evaluate, Host, LogLevel, ParamDesc, Params, PluginError,
    PluginResult, PrepareInput,
};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

struct Misbehaving;

const HOW: [(&str, &str); 24] = [
    ("well", "Does what it should"),
    ("panic-in-prepare", "Panics while it prepares"),
    ("panic-in-deform", "Panics half-way through the samples"),
    ("panic-in-evaluate", "Panics at a point of space"),
    ("panic-in-drop", "Panics when its state is freed"),
    ("panic-payload", "Panics with a payload that panics when freed"),
    ("error-in-prepare", "Refuses the input, over several lines"),
    ("error-in-deform", "Refuses to deform, without a hint"),
    ("cancel-unasked", "Says that it was cancelled"),
    ("nan", "Writes what is no number"),
    ("unwritten", "Leaves the last sample unwritten"),
    ("ignore-cancel", "Goes on when asked to stop"),
    ("abort", "Aborts the process while it prepares"),
    ("segfault", "Writes through a bad pointer"),
    ("endless-loop", "Never comes back from a deformation"),
    ("endless-allocation", "Takes all memory while it prepares"),
    ("writes-to-input", "Moves a sample at rest"),
    ("blocked-cancel", "Takes its time when asked to stop"),
    ("log-spam", "Never stops talking"),
    ("lying-invalidation", "Prepares with a parameter that is said not to matter to that"),
    ("not-identity", "Moves samples though its handle does not move"),
    ("not-repeatable", "Moves a little farther each time"),
    ("evaluate-disagrees", "Moves points elsewhere than samples"),
    ("nan-at-bounds", "Writes what is no number when it shall shift by 2"),
];

/// Kind of misbehaviour that the environment asks for, which the descriptor knows as well.
fn from_environment() -> Option<String> {
    std::env::var("SIMOD_MISBEHAVE").ok()
}

fn how(params: Params<'_>) -> PluginResult<String> {
    from_environment().map_or_else(|| params.choice("how").map(str::to_owned), Ok)
}

/// Prepared state: the kind of misbehaviour, and the length of the shift.
struct Prepared {
    how: String,
    by: f64,
}

impl Prepared {
    fn by(&self, params: Params<'_>) -> PluginResult<f64> {
        if self.how == "lying-invalidation" { Ok(self.by) } else { params.float("by") }
    }
}

impl Drop for Prepared {
    fn drop(&mut self) {
        if self.how == "panic-in-drop" {
            panic!("cannot let go");
        }
    }
}

struct Bomb;

impl Drop for Bomb {
    fn drop(&mut self) {
        panic!("the payload goes off");
    }
}

impl Deformer for Misbehaving {
    type State = Prepared;
    type Scratch = Vec<u8>;

    fn descriptor() -> Descriptor {
        let how = from_environment().unwrap_or_default();
        let most = if how == "bad-descriptor" { 0.5 } else { 2.0 };
        let handles = how == "not-identity";
        match how.as_str() {
            "segfault-at-load" => write_nowhere(),
            "panic-at-load" => panic!("who am I"),
            "slow-at-load" => std::thread::sleep(Duration::from_millis(800)),
            _ => {}
        }
        let descriptor = Descriptor::new("misbehaving", "Misbehaving", env!("CARGO_PKG_VERSION"));
        too_much(descriptor, &how)
            .summary(if how == "raw-texts" {
                "Does one \x1b[31mthing\nwrong"
            } else {
                "Does one thing wrong"
            })
            .param(
                ParamDesc::choice("how", "How", "well", &HOW)
                    .hint("What goes wrong")
                    .invalidates_preparation(),
            )
            .param(ParamDesc::float("by", "By", 1.0).hard(-2.0, most).hint("How far it shifts"))
            .consumes(Consumes {
                handle_regions: handles,
                min_handles: u32::from(handles),
                ..Consumes::default()
            })
    }

    fn prepare(input: &PrepareInput<'_>, host: &Host<'_>) -> PluginResult<Prepared> {
        let how = how(input.params())?;
        match how.as_str() {
            "panic-in-prepare" => panic!("no state for {} samples", input.samples.positions().len()),
            "panic-payload" => std::panic::panic_any(Bomb),
            "error-in-prepare" => {
                return Err(PluginError::input("this\ndoes not\n  please me").hint("please\nme"));
            }
            "cancel-unasked" => return Err(PluginError::cancelled()),
            "ignore-cancel" => drop(host.progress(0.5)),
            "abort" => std::process::abort(),
            "endless-allocation" => take_all_memory(),
            "log-spam" => {
                (0..1000).for_each(|i| host.log(LogLevel::INFO, &format!("and another thing, {i}")))
            }
            _ => host.log(LogLevel::INFO, "all is well"),
        }
        Ok(Prepared { how, by: input.params().float("by")? })
    }

    fn deform(
        state: &Prepared,
        input: &DeformInput<'_>,
        _: &mut Vec<u8>,
        out: &mut [[f32; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        static CALLS: AtomicU32 = AtomicU32::new(0);
        let mut by = state.by(input.params())? as f32;
        match state.how.as_str() {
            "segfault" => write_nowhere(),
            "endless-loop" => loop {
                std::thread::sleep(Duration::from_millis(10));
            },
            "writes-to-input" => move_first_sample(input),
            "blocked-cancel" if host.progress(0.0).is_err() => {
                let since = Instant::now();
                while since.elapsed() < Duration::from_millis(2500) {
                    std::thread::sleep(Duration::from_millis(10));
                }
            }
            "nan-at-bounds" if by == 2.0 => by = f32::NAN,
            "not-repeatable" => by += CALLS.fetch_add(1, Ordering::Relaxed) as f32 * 1e-3,
            _ => {}
        }
        let count = out.len();
        for (i, (o, p)) in out.iter_mut().zip(input.samples.positions()).enumerate() {
            match state.how.as_str() {
                "panic-in-deform" if i == count / 2 => panic!("half-way"),
                "error-in-deform" => return Err(PluginError::internal("not today")),
                "nan" if i == count / 3 => *o = [f32::NAN, 0.0, 0.0],
                "unwritten" if i + 1 == count => {}
                "ignore-cancel" => drop(host.progress(0.5)),
                _ => *o = [p[0] + by, p[1], p[2]],
            }
        }
        Ok(())
    }
}

impl Evaluate for Misbehaving {
    fn evaluate(
        state: &Prepared,
        input: &DeformInput<'_>,
        points: &mut [[f64; 3]],
        _: &Host<'_>,
    ) -> PluginResult<()> {
        assert!(state.how != "panic-in-evaluate", "nowhere");
        let aside = if state.how == "evaluate-disagrees" { 1e-3 } else { 0.0 };
        let by = state.by(input.params())?;
        points.iter_mut().for_each(|p| *p = [p[0] + by, p[1] + aside, p[2]]);
        Ok(())
    }
}

/// More than anybody reads, in one way or another.
fn too_much(descriptor: Descriptor, how: &str) -> Descriptor {
    let number = |id: &str| ParamDesc::float(id, "A number", 0.0).hint("One of them");
    match how {
        "many-params" => (0..10_001).map(|i| number(&format!("p{i}"))).fold(descriptor, Descriptor::param),
        "long-hint" => descriptor.param(number("long").hint(&"very ".repeat(20_000)[..1 << 16])),
        "many-choices" => {
            let ids: Vec<String> = (0..10_001).map(|i| format!("c{i}")).collect();
            let choices: Vec<_> = ids.iter().map(|id| (id.as_str(), "One of them")).collect();
            descriptor.param(ParamDesc::choice("many", "Many", "c0", &choices))
        }
        _ => descriptor,
    }
}

/// Ends the process.
fn write_nowhere() {
    // SAFETY: none. Nothing is mapped there, so that the system ends the process, as the tests want it.
    unsafe { std::ptr::without_provenance_mut::<u64>(64).write_volatile(1) }
}

fn move_first_sample(input: &DeformInput<'_>) {
    if let Some(p) = input.samples.positions().first() {
        // SAFETY: none. The memory is there and writable, and nobody may write to it, as the tests want it.
        unsafe { std::ptr::from_ref(p).cast_mut().cast::<f32>().write_volatile(p[0] + 1.0) }
    }
}

fn take_all_memory() {
    let mut hoard: Vec<Vec<u8>> = Vec::new();
    loop {
        hoard.push(std::hint::black_box(vec![1; 16 << 20]));
    }
}

simod_plugin_api::export_plugin!(Misbehaving, evaluate);
