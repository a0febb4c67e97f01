//! The command line.

pub mod bal;
pub mod evaluate;
