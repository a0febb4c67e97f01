//! Structure from motion.
