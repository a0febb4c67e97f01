//! The results on a data set as Markdown tables and as bar charts; calibration and breakdown likewise.

mod ablation;
mod breakdown;
mod calibration;
mod charts;
mod estimators;
mod pages;
mod table;

pub use ablation::ablation_table;
pub use breakdown::breakdown_charts;
pub use calibration::{calibration, calibration_summary};
pub use charts::{estimators_chart, scale_deviation_chart, trajectory_error_chart};
pub use pages::{ATTENTION_ERROR_M, ATTENTION_FRACTION, markdown, summary};
