//! Resources of the machine for a job, as the scheduler states them.

use std::env;
use std::num::NonZeroUsize;
use std::thread;

/// Memory that a job may need, bytes: see docs/fleet.md.
pub(super) const MEMORY_OF_A_JOB: u64 = 1536 << 20;

/// Number of threads for all work: the requested one; otherwise Slurm's for the task; otherwise the kernel's for this
/// process, which is the least of its cores, its affinity, and the quotas of its control groups (either version).
pub(super) fn threads(asked: Option<usize>) -> usize {
    let of_slurm = || env::var("SLURM_CPUS_PER_TASK").ok().and_then(|text| text.trim().parse().ok());
    let of_kernel = || thread::available_parallelism().map_or(1, NonZeroUsize::get);
    asked.or_else(of_slurm).filter(|&number| number > 0).unwrap_or_else(of_kernel)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_asked_for_goes_before_what_the_machine_has() {
        assert_eq!(threads(Some(3)), 3);
        assert!(threads(None) >= 1);
    }
}
