//! Cost of the stages of a run.

use minijinja::{Value, context};

use crate::report::chart::significant;
use crate::report::data::{Data, Stage};

/// Rows and sums of the table.
pub(super) fn stages(data: &Data) -> Value {
    let longest = data.stages.iter().map(|s| s.cpu_s).fold(0.0, f64::max).max(1e-9);
    let seconds = |s: f64| if s < 100.0 { format!("{s:.1}") } else { format!("{s:.0}") };
    let row = |s: &Stage| {
        context! {
            name => s.name,
            wall => seconds(s.wall_s),
            cpu => seconds(s.cpu_s),
            memory => format!("{:.0}", s.peak_rss_mib),
            share => significant(s.cpu_s / longest * 100.0, 3),
            reused => s.reused,
        }
    };
    let sum = |of: fn(&Stage) -> f64| seconds(data.stages.iter().map(of).sum());
    let peak = data.stages.iter().map(|s| s.peak_rss_mib).fold(0.0, f64::max);
    context! {
        rows => data.stages.iter().map(row).collect::<Vec<_>>(),
        wall => sum(|s| s.wall_s),
        cpu => sum(|s| s.cpu_s),
        memory => format!("{peak:.0}"),
    }
}
