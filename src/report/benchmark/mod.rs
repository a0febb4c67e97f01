//! The results on a data set as Markdown tables and as the paper's two bar charts.

mod charts;
mod pages;
mod table;

pub use charts::{scale_deviation_chart, trajectory_error_chart};
pub use pages::{ATTENTION_ERROR_M, ATTENTION_FRACTION, markdown, summary};
