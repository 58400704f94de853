//! A plugin that does wrong what its parameter `how` says, and shifts by 1 along x else.

use simod_plugin_api::{
    DeformInput, Deformer, Descriptor, Evaluate, Host, LogLevel, ParamDesc, PluginError, PluginResult,
    PrepareInput,
};

struct Misbehaving;

const HOW: [(&str, &str); 12] = [
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
];

/// What it prepared: how to misbehave.
struct Prepared(String);

impl Drop for Prepared {
    fn drop(&mut self) {
        if self.0 == "panic-in-drop" {
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
        Descriptor::new("misbehaving", "Misbehaving", env!("CARGO_PKG_VERSION"))
            .param(ParamDesc::choice("how", "How", "well", &HOW).invalidates_preparation())
    }

    fn prepare(input: &PrepareInput<'_>, host: &Host<'_>) -> PluginResult<Prepared> {
        let how = input.params().choice("how")?;
        match how {
            "panic-in-prepare" => panic!("no state for {} samples", input.samples.positions().len()),
            "panic-payload" => std::panic::panic_any(Bomb),
            "error-in-prepare" => {
                return Err(PluginError::input("this\ndoes not\n  please me").hint("please\nme"));
            }
            "cancel-unasked" => return Err(PluginError::cancelled()),
            "ignore-cancel" => drop(host.progress(0.5)),
            _ => host.log(LogLevel::INFO, "all is well"),
        }
        Ok(Prepared(how.to_owned()))
    }

    fn deform(
        state: &Prepared,
        input: &DeformInput<'_>,
        _: &mut Vec<u8>,
        out: &mut [[f32; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let count = out.len();
        for (i, (o, p)) in out.iter_mut().zip(input.samples.positions()).enumerate() {
            match state.0.as_str() {
                "panic-in-deform" if i == count / 2 => panic!("half-way"),
                "error-in-deform" => return Err(PluginError::internal("not today")),
                "nan" if i == count / 3 => *o = [f32::NAN, 0.0, 0.0],
                "unwritten" if i + 1 == count => {}
                "ignore-cancel" => drop(host.progress(0.5)),
                _ => *o = [p[0] + 1.0, p[1], p[2]],
            }
        }
        Ok(())
    }
}

impl Evaluate for Misbehaving {
    fn evaluate(
        state: &Prepared,
        _: &DeformInput<'_>,
        points: &mut [[f64; 3]],
        _: &Host<'_>,
    ) -> PluginResult<()> {
        assert!(state.0 != "panic-in-evaluate", "nowhere");
        points.iter_mut().for_each(|p| p[0] += 1.0);
        Ok(())
    }
}

simod_plugin_api::export_plugin!(Misbehaving, evaluate);
