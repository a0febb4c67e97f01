//! Stage order, resumption, progress.
