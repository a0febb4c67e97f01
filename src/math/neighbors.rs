//! Nearest neighbors by index.

use std::num::NonZero;

use kiddo::{ImmutableKdTree, SquaredEuclidean};

/// A kd-tree over positions, which must be finite: the tree accepts NaN silently and then returns wrong results.
pub(crate) struct Neighbors<const K: usize> {
    tree: ImmutableKdTree<f64, K>,
}

impl<const K: usize> Neighbors<K> {
    /// `None` if the tree cannot be built (more positions than 32 bits count).
    pub(crate) fn new(positions: &[[f64; K]]) -> Option<Self> {
        ImmutableKdTree::new_from_slice(positions).ok().map(|tree| Self { tree })
    }

    /// Indices of the `count` positions nearest to a query point, nearest first; all of them if there are fewer.
    pub(crate) fn nearest(&self, place: &[f64; K], count: usize) -> Vec<usize> {
        let Some(count) = NonZero::new(count) else { return Vec::new() };
        let found = self.tree.query(place).nearest_n::<SquaredEuclidean<f64>>(count).execute();
        found.into_iter().map(|neighbor| neighbor.item as usize).collect()
    }
}
