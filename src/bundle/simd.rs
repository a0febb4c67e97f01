//! Runtime dispatch of a task to the widest vector instructions of the processor.
//!
//! The compiler targets the oldest processor of its architecture; [`wide`] compiles its task a second time for AVX2
//! with fused multiply-add and chooses at run time. All called functions must be inlined into the task. In a closure
//! that is not inlined, as may happen for `map` and `from_fn` of arrays, a fused multiply-add is a function call.

use pulp::{Arch, Simd, WithSimd};

/// A task that can run with any instruction set.
pub(super) trait Task {
    /// Return type.
    type Output;
    /// Runs the task; `F` selects fused or separate multiplication and addition.
    fn run<F: Fused>(self) -> Self::Output;
}

/// a b + c in one or two instructions.
pub(super) trait Fused {
    fn mul_add(a: f64, b: f64, c: f64) -> f64;
}

/// One instruction.
pub(super) struct One;
/// Two instructions: without hardware support, a fused multiplication would be a slow function call.
pub(super) struct Two;

impl Fused for One {
    #[inline(always)]
    fn mul_add(a: f64, b: f64, c: f64) -> f64 {
        a.mul_add(b, c)
    }
}

impl Fused for Two {
    #[inline(always)]
    fn mul_add(a: f64, b: f64, c: f64) -> f64 {
        a * b + c
    }
}

struct Wide<T>(T);

impl<T: Task> WithSimd for Wide<T> {
    type Output = T::Output;
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> T::Output {
        if S::IS_SCALAR { self.0.run::<Two>() } else { self.0.run::<One>() }
    }
}

/// Runs a task with the widest supported instruction set.
#[inline]
pub(super) fn wide<T: Task>(task: T) -> T::Output {
    Arch::new().dispatch(Wide(task))
}
