//! The threads that talk to stores, while those of the program compute or wait.

use std::future::Future;
use std::sync::OnceLock;

use simod_model::{Error, Result};
use tokio::runtime::{Builder, Runtime};

/// Threads, which wait most of the time.
const THREADS: usize = 2;

/// The one runtime of the process.
pub(crate) fn runtime() -> Result<&'static Runtime> {
    static RUNTIME: OnceLock<Runtime> = OnceLock::new();
    if let Some(runtime) = RUNTIME.get() {
        return Ok(runtime);
    }
    let built = Builder::new_multi_thread().worker_threads(THREADS).thread_name("store").enable_all().build();
    let built = built.map_err(|e| {
        let what = format!("the threads that talk to stores cannot be started: {e}");
        Error::system(what, "end other programs, then try again").because(e)
    })?;
    // Another thread may have been first: its runtime is as good, and this one ends.
    Ok(RUNTIME.get_or_init(|| built))
}

/// Waits for an answer, on a thread that is none of the runtime's.
pub(crate) fn wait<T>(answer: impl Future<Output = T>) -> Result<T> {
    Ok(runtime()?.block_on(answer))
}
