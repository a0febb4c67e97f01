//! What a piece of work costs: elapsed time, processor time, memory.

use std::fs;
use std::time::Instant;

use rustix::time::{ClockId, clock_gettime};
use serde::{Deserialize, Serialize};

/// The cost of a stage.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Cost {
    /// Elapsed time, seconds.
    pub wall_s: f64,
    /// User and system time of all threads, seconds.
    pub cpu_s: f64,
    /// Largest resident memory of the process during the stage, MiB.
    pub peak_rss_mib: f64,
}

/// Runs from its making to [`Meter::read`].
pub(super) struct Meter {
    started: Instant,
    cpu_s: f64,
}

impl Meter {
    pub(super) fn start() -> Self {
        // Sets the high-water mark back to what is in use now. Where the kernel does not let us, the figure is the peak
        // since the process began, which is an upper bound.
        let _ = fs::write("/proc/self/clear_refs", "5");
        Self { started: Instant::now(), cpu_s: process_cpu_s() }
    }

    pub(super) fn read(&self) -> Cost {
        Cost {
            wall_s: self.started.elapsed().as_secs_f64(),
            cpu_s: process_cpu_s() - self.cpu_s,
            peak_rss_mib: status_mib("VmHWM:").unwrap_or(0.0),
        }
    }
}

/// Processor time of the process so far, all threads, seconds.
pub fn process_cpu_s() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// A line of `/proc/self/status` that is given in kB.
fn status_mib(key: &str) -> Option<f64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix(key))?;
    let kib: f64 = line.split_whitespace().next()?.parse().ok()?;
    Some(kib / 1024.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_and_memory_are_seen() {
        let meter = Meter::start();
        let block = vec![1u8; 64 << 20];
        let sum: u64 = block.iter().map(|&b| u64::from(b)).sum();
        let cost = meter.read();
        assert_eq!(sum, 64 << 20);
        assert!(cost.peak_rss_mib > 64.0, "{cost:?}");
        assert!(cost.wall_s > 0.0 && cost.cpu_s > 0.0, "{cost:?}");
    }
}
