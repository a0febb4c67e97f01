//! Cost of a stage: elapsed time, processor time, memory.
//!
//! The kernel records the peak memory of a process since its start (VmHWM). Resetting it would hide the peak from
//! outside observers, so it is left alone. If it rose during a stage, it is the peak of that stage; otherwise the
//! largest sample is.

use std::fs;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use rustix::time::{ClockId, clock_gettime};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The cost of a stage.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Cost {
    /// Elapsed time, seconds.
    pub wall_s: f64,
    /// User and system time of all threads, seconds.
    pub cpu_s: f64,
    /// Largest resident memory of the process during the stage, MiB.
    pub peak_rss_mib: f64,
}

/// Measures from its creation to [`Meter::read`].
pub(in crate::pipeline) struct Meter {
    started: Instant,
    cpu_s: f64,
    /// Peak memory of the process before the start, MiB.
    peak_before_mib: f64,
    samples: Arc<Samples>,
}

/// State shared by the sampling thread and its meter.
#[derive(Default)]
struct Samples {
    /// Largest sample, bytes.
    largest: AtomicU64,
    is_over: AtomicBool,
}

impl Meter {
    pub(in crate::pipeline) fn start() -> Self {
        let samples = Arc::new(Samples::default());
        samples.take();
        let shared = Arc::clone(&samples);
        // If no thread can be started, the first and the last sample have to suffice.
        let _ = thread::Builder::new().name("memory".into()).spawn(move || {
            while !shared.is_over.load(Ordering::Relaxed) {
                thread::sleep(Duration::from_millis(20));
                shared.take();
            }
        });
        let peak_before_mib = status_mib("VmHWM:").unwrap_or(0.0);
        Self { started: Instant::now(), cpu_s: process_cpu_s(), peak_before_mib, samples }
    }

    pub(in crate::pipeline) fn read(&self) -> Cost {
        self.samples.take();
        let peak_mib = status_mib("VmHWM:").unwrap_or(0.0);
        let sampled_mib = self.samples.largest.load(Ordering::Relaxed) as f64 / f64::from(1 << 20);
        Cost {
            wall_s: self.started.elapsed().as_secs_f64(),
            cpu_s: process_cpu_s() - self.cpu_s,
            peak_rss_mib: if peak_mib > self.peak_before_mib { peak_mib } else { sampled_mib },
        }
    }
}

impl Drop for Meter {
    fn drop(&mut self) {
        self.samples.is_over.store(true, Ordering::Relaxed);
    }
}

impl Samples {
    fn take(&self) {
        let bytes = status_mib("VmRSS:").unwrap_or(0.0) * f64::from(1 << 20);
        self.largest.fetch_max(bytes as u64, Ordering::Relaxed);
    }
}

/// Processor time of the process so far, all threads, seconds.
pub fn process_cpu_s() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// Value in MiB of a line of `/proc/self/status` that is given in kB.
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
    fn time_and_memory_are_measured() {
        let meter = Meter::start();
        let block = vec![1u8; 64 << 20];
        let sum: u64 = block.iter().map(|&b| u64::from(b)).sum();
        let cost = meter.read();
        assert_eq!(sum, 64 << 20);
        assert!(cost.peak_rss_mib > 64.0, "{cost:?}");
        assert!(cost.wall_s > 0.0 && cost.cpu_s > 0.0, "{cost:?}");
    }

    #[test]
    fn the_peak_of_the_process_is_not_reset() {
        let first = {
            let meter = Meter::start();
            let block = vec![1u8; 256 << 20];
            assert_eq!(block.iter().map(|&b| usize::from(b)).sum::<usize>(), 256 << 20);
            meter.read().peak_rss_mib
        };
        let second = Meter::start().read().peak_rss_mib;
        let of_process = status_mib("VmHWM:").unwrap();
        assert!(first > 256.0 && second > 0.0);
        // The kernel counts per thread and updates the sum only occasionally.
        assert!(of_process > first - 8.0, "{of_process} {first} {second}");
    }
}
