//! Ground labels and local planes.
