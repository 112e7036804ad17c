//! Sixteen lanes as an array: the reference for the other widths.

use super::{LANES, Line, Operation, Simd};

/// A fused multiply-add is one instruction if the processor has it, otherwise a slow call with the same result.
#[derive(Clone, Copy)]
pub(crate) struct Scalar {
    #[cfg(target_arch = "x86_64")]
    fma: bool,
}

/// Runs `operation` without vector instructions.
pub(crate) fn run<O: Operation>(operation: O) -> O::Output {
    #[cfg(target_arch = "x86_64")]
    {
        let fma = std::arch::is_x86_feature_detected!("fma");
        if fma {
            // SAFETY: the processor has FMA.
            unsafe { with_fma(operation) }
        } else {
            operation.run(Scalar { fma })
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    operation.run(Scalar {})
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "fma")]
#[inline(never)]
fn with_fma<O: Operation>(operation: O) -> O::Output {
    operation.run(Scalar { fma: true })
}

#[inline(always)]
fn each(one: impl Fn(usize) -> f32) -> [f32; LANES] {
    let mut all = [0.0; LANES];
    for (lane, x) in all.iter_mut().enumerate() {
        *x = one(lane);
    }
    all
}

impl Simd for Scalar {
    type Vector = [f32; LANES];

    const TILE_SUMS: usize = 2;

    #[inline(always)]
    fn splat(self, x: f32) -> Self::Vector {
        [x; LANES]
    }

    #[inline(always)]
    fn load(self, from: &Line) -> Self::Vector {
        from.0
    }

    #[inline(always)]
    fn store(self, x: Self::Vector, to: &mut Line) {
        to.0 = x;
    }

    #[inline(always)]
    unsafe fn load_pointer(self, from: *const f32) -> Self::Vector {
        // SAFETY: guaranteed by the caller; an array of floats has the alignment of a float.
        unsafe { from.cast::<Self::Vector>().read() }
    }

    #[inline(always)]
    unsafe fn store_pointer(self, x: Self::Vector, to: *mut f32) {
        // SAFETY: guaranteed by the caller.
        unsafe { to.cast::<Self::Vector>().write(x) }
    }

    #[inline(always)]
    fn add(self, x: Self::Vector, y: Self::Vector) -> Self::Vector {
        each(|i| x[i] + y[i])
    }

    #[inline(always)]
    fn sub(self, x: Self::Vector, y: Self::Vector) -> Self::Vector {
        each(|i| x[i] - y[i])
    }

    #[inline(always)]
    fn mul(self, x: Self::Vector, y: Self::Vector) -> Self::Vector {
        each(|i| x[i] * y[i])
    }

    #[inline(always)]
    fn div(self, x: Self::Vector, y: Self::Vector) -> Self::Vector {
        each(|i| x[i] / y[i])
    }

    #[inline(always)]
    fn fma(self, x: Self::Vector, y: Self::Vector, z: Self::Vector) -> Self::Vector {
        each(|i| x[i].mul_add(y[i], z[i]))
    }

    #[inline(always)]
    fn at_most(self, limit: Self::Vector, x: Self::Vector) -> Self::Vector {
        each(|i| if limit[i] < x[i] { limit[i] } else { x[i] })
    }

    #[inline(always)]
    fn at_least(self, limit: Self::Vector, x: Self::Vector) -> Self::Vector {
        each(|i| if limit[i] > x[i] { limit[i] } else { x[i] })
    }

    #[inline(always)]
    fn where_positive(self, x: Self::Vector, y: Self::Vector) -> Self::Vector {
        each(|i| if x[i] > 0.0 { y[i] } else { 0.0 })
    }

    #[inline(always)]
    fn sum(self, mut x: Self::Vector) -> f32 {
        for half in [8, 4, 2, 1] {
            for i in 0..half {
                x[i] += x[i + half];
            }
        }
        x[0]
    }

    #[inline(always)]
    fn outlined<O: Operation>(self, operation: O) -> O::Output {
        #[cfg(target_arch = "x86_64")]
        if self.fma {
            // SAFETY: the processor has FMA.
            return unsafe { with_fma(operation) };
        }
        operation.run(self)
    }
}
