//! Structure from motion.

pub mod bundle;
