//! Running a task with the widest vector instructions that the processor has.
//!
//! The compiler targets the oldest processor of its architecture; [`wide`] compiles its task a second time for AVX2
//! with fused multiply-add and chooses at run time. Everything below must be inlined into the task to profit: where a
//! closure is not, as those that `map` and `from_fn` of arrays take are not always, a multiplication with an addition
//! is a function call.

use pulp::{Arch, Simd, WithSimd};

/// A task that can run with any instruction set.
pub(super) trait Task {
    /// Return type.
    type Output;
    /// Does it; `F` tells whether multiplication and addition are one instruction.
    fn run<F: Fused>(self) -> Self::Output;
}

/// a b + c in one or two instructions.
pub(super) trait Fused {
    fn mul_add(a: f64, b: f64, c: f64) -> f64;
}

/// One instruction.
pub(super) struct One;
/// Two: without hardware for it, a fused multiplication would be a slow function call.
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

/// Runs a task with what the processor has.
#[inline]
pub(super) fn wide<T: Task>(task: T) -> T::Output {
    Arch::new().dispatch(Wide(task))
}
