//! Terms of a prior in the normal equations.

/// H and g of the priors on a block of at most 12 freedoms.
pub(super) struct PriorTerms {
    /// View block, or shared camera.
    pub target: PriorTarget,
    /// First freedom within it.
    pub offset: usize,
    /// JᵀJ, 6 × 6; unused rows are zero.
    pub hessian: [[f64; 6]; 6],
    /// Jᵀr.
    pub gradient: [f64; 6],
}

/// Where a prior's terms go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PriorTarget {
    Block(usize),
    Shared(usize),
}

pub(super) fn empty() -> PriorTerms {
    PriorTerms { target: PriorTarget::Block(0), offset: 0, hessian: [[0.0; 6]; 6], gradient: [0.0; 6] }
}
