//! A whole run of a session as units of work, for more machines than one: see `docs/scale.md`.
//!
//! A plan is a folder that all machines see. `plan.toml` lists the units, each with its work, its part and
//! the units that it comes after; each unit reads files and writes files there, and the last one the
//! session's output. Units may be done in any order that their dependencies allow, at the same time, and more
//! than once: work that is done already is not done again, and the bytes are those of one machine.

mod emit;
mod folder;
mod graph;
mod make;
mod unit;
mod units;

pub use emit::{Emit, emit};
pub use folder::{absolute, check_target, put, text};
pub use graph::{Exchange, Plan};
pub use make::{PlanOptions, make};
pub use unit::{UnitDone, do_unit};
pub use units::{FINISHED, PLAN, Planned, check_before, check_units, hash_of, read, unit_of};
pub use units::{Stage, Unit};
