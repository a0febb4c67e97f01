//! Number of threads by the options.

use crate::checks::OptionError;
use crate::pipeline::Result;

/// Runs `task` on the requested number of threads, by default on those of the caller's pool.
pub(in crate::pipeline) fn on_threads<T: Send>(threads: Option<usize>, task: impl FnOnce() -> T + Send) -> Result<T> {
    let Some(threads) = threads.filter(|&threads| threads != rayon::current_num_threads()) else {
        return Ok(task());
    };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let pool = pool.map_err(|error| OptionError::new("threads", format!("cannot be started: {error}")))?;
    Ok(pool.install(task))
}
