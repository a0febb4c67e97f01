//! Structure from motion.

pub mod bundle;
pub mod features;
pub mod matching;
pub mod resection;
pub mod solvers;
pub mod tracks;
pub mod triangulation;
pub mod two_view;

mod error;

pub use error::SfmError;
