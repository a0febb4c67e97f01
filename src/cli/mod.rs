//! The command line.

pub mod bal;
