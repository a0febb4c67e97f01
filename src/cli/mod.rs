//! The command line.

pub mod bal;
pub mod compare;
pub mod convert;
pub mod evaluate;
