//! Terms of a prior in the normal equations.

/// H and g of a prior on at most six degrees of freedom of a block.
pub(super) struct PriorTerms {
    /// View block, or shared camera.
    pub target: PriorTarget,
    /// First degree of freedom within the block.
    pub offset: usize,
    /// JᵀJ, 6 × 6; unused rows are zero.
    pub hessian: [[f64; 6]; 6],
    /// Jᵀr.
    pub gradient: [f64; 6],
}

/// Block to which a prior's terms are added.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PriorTarget {
    Block(usize),
    Shared(usize),
}

pub(super) fn empty() -> PriorTerms {
    PriorTerms { target: PriorTarget::Block(0), offset: 0, hessian: [[0.0; 6]; 6], gradient: [0.0; 6] }
}
