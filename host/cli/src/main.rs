//! `simod`: freeform deformation that does not care about size. One file per subcommand under `commands/`.

mod commands;
mod console;
mod report;
mod versions;

use std::ffi::{OsStr, OsString};
use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};
use simod_model::{ErrorKind, memory, object};

use commands::{
    bind, compare, convert, deform, demo, generate, info, plan, plugin, reconstruct, refine, render, run,
    sample, shell, view,
};
use console::{CANCELLED, Console, Show};
use report::Report;

/// Deform models of any size by a small set of samples
///
/// `simod sample` streams a model to a small set of samples, `simod deform` moves these with any mix of
/// plugins, and `simod reconstruct` streams the deformation back onto every vertex. `simod run` does all
/// three as a session says.
#[derive(Parser)]
#[command(version, propagate_version = true, max_term_width = 100)]
struct Arguments {
    /// Print one JSON object on standard output instead of text
    #[arg(long, global = true)]
    json: bool,
    /// Number of threads, from 1 to 1024 [default: one for each core]
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Form of the progress on standard error
    #[arg(long, global = true, value_name = "HOW", default_value = "auto")]
    progress: Show,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Sample(sample::Sample),
    Deform(deform::Deform),
    Refine(refine::Refine),
    Bind(bind::Bind),
    Reconstruct(reconstruct::Reconstruct),
    Run(run::Run),
    Plan(plan::Plan),
    Unit(plan::Unit),
    Compare(compare::Compare),
    Convert(convert::Convert),
    Info(info::Info),
    #[command(subcommand)]
    Plugin(plugin::Plugin),
    Demo(demo::Demo),
    Generate(generate::Generate),
    Render(render::Render),
    View(view::View),
    Completions(shell::Completions),
    Manual(shell::Manual),
}

fn main() -> ExitCode {
    memory::return_large_blocks();
    #[cfg(feature = "object-storage")]
    simod_storage::install();
    let arguments = Arguments::parse_from(std::env::args_os().map(without_secrets));
    // A process that answers another one is stopped by that one.
    let is_worker = matches!(&arguments.command, Command::Plugin(plugin) if plugin.is_worker());
    let console = if is_worker { Console::of_worker() } else { Console::new() };
    match execute(arguments, &console) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            console.error(&error);
            if error.kind() == ErrorKind::Cancelled {
                ExitCode::from(CANCELLED as u8)
            } else {
                ExitCode::FAILURE
            }
        }
    }
}

/// An argument without parts that may be secret in the URL of an object, so that no message can tell these.
fn without_secrets(argument: OsString) -> OsString {
    let option =
        argument.to_str().filter(|text| text.starts_with("--")).and_then(|text| text.split_once('='));
    match option {
        Some((name, value)) => {
            [OsStr::new(name), OsStr::new("="), &object::admit(value)].into_iter().collect()
        }
        None => object::admit(argument),
    }
}

fn execute(arguments: Arguments, console: &Console) -> simod_model::Result<()> {
    if let Some(n) = arguments.threads {
        commands::set_threads(usize::from(n))?;
    }
    console.show(arguments.progress);
    let mut report = Report::new(console);
    match arguments.command {
        Command::Sample(c) => c.execute(&mut report),
        Command::Deform(c) => c.execute(&mut report),
        Command::Refine(c) => c.execute(&mut report),
        Command::Bind(c) => c.execute(&mut report),
        Command::Reconstruct(c) => c.execute(&mut report),
        Command::Run(c) => c.execute(&mut report),
        Command::Plan(c) => c.execute(&mut report),
        Command::Unit(c) => c.execute(&mut report),
        Command::Compare(c) => c.execute(&mut report),
        Command::Convert(c) => c.execute(&mut report),
        Command::Info(c) => c.execute(&mut report),
        Command::Plugin(c) => c.execute(&mut report),
        Command::Demo(c) => c.execute(&mut report),
        Command::Generate(c) => c.execute(&mut report),
        Command::Render(c) => c.execute(&mut report),
        Command::View(c) => return c.execute(),
        Command::Completions(c) => return c.execute(Arguments::command()),
        Command::Manual(c) => return c.execute(Arguments::command()),
    }?;
    report.finish(arguments.json)
}
