//! Two registers of 256 bits (AVX2) or one of 512 bits (AVX-512).

use core::arch::x86_64::*;

use super::{LANES, Line, Operation, Simd};

/// Exists only if [`has_avx2`] is true.
#[derive(Clone, Copy)]
pub(crate) struct Avx2(());

/// Exists only if [`has_avx512`] is true.
#[derive(Clone, Copy)]
pub(crate) struct Avx512(());

pub(crate) fn has_avx2() -> bool {
    std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma")
}

pub(crate) fn has_avx512() -> bool {
    has_avx2() && std::arch::is_x86_feature_detected!("avx512f")
}

/// Runs `operation` with AVX2. Panics unless [`has_avx2`] is true.
pub(crate) fn run_avx2<O: Operation>(operation: O) -> O::Output {
    assert!(has_avx2(), "AVX2 and FMA are missing");
    // SAFETY: just checked.
    unsafe { with_avx2(operation) }
}

/// Runs `operation` with AVX-512. Panics unless [`has_avx512`] is true.
pub(crate) fn run_avx512<O: Operation>(operation: O) -> O::Output {
    assert!(has_avx512(), "AVX-512F is missing");
    // SAFETY: just checked.
    unsafe { with_avx512(operation) }
}

#[target_feature(enable = "avx2,fma")]
#[inline(never)]
fn with_avx2<O: Operation>(operation: O) -> O::Output {
    operation.run(Avx2(()))
}

#[target_feature(enable = "avx2,fma,avx512f")]
#[inline(never)]
fn with_avx512<O: Operation>(operation: O) -> O::Output {
    operation.run(Avx512(()))
}

/// Sum of eight lanes: `i + 4`, `+ 2`, `+ 1`.
#[target_feature(enable = "avx2,fma")]
#[inline]
fn sum_of_eight(x: __m256) -> f32 {
    let x = _mm_add_ps(_mm256_castps256_ps128(x), _mm256_extractf128_ps::<1>(x));
    let x = _mm_add_ps(x, _mm_movehl_ps(x, x));
    _mm_cvtss_f32(_mm_add_ss(x, _mm_shuffle_ps::<1>(x, x)))
}

impl Simd for Avx2 {
    type Vector = [__m256; 2];

    const TILE_SUMS: usize = 6;

    #[inline(always)]
    fn splat(self, x: f32) -> Self::Vector {
        // SAFETY: `self` proves AVX2, here and below.
        unsafe { [_mm256_set1_ps(x); 2] }
    }

    #[inline(always)]
    fn load(self, from: &Line) -> Self::Vector {
        // SAFETY: a line has sixteen values.
        unsafe { self.load_pointer(from.0.as_ptr()) }
    }

    #[inline(always)]
    fn store(self, x: Self::Vector, to: &mut Line) {
        // SAFETY: a line has sixteen values.
        unsafe { self.store_pointer(x, to.0.as_mut_ptr()) }
    }

    #[inline(always)]
    unsafe fn load_pointer(self, from: *const f32) -> Self::Vector {
        // SAFETY: guaranteed by the caller.
        unsafe { [_mm256_loadu_ps(from), _mm256_loadu_ps(from.add(LANES / 2))] }
    }

    #[inline(always)]
    unsafe fn store_pointer(self, x: Self::Vector, to: *mut f32) {
        // SAFETY: guaranteed by the caller.
        unsafe {
            _mm256_storeu_ps(to, x[0]);
            _mm256_storeu_ps(to.add(LANES / 2), x[1]);
        }
    }

    #[inline(always)]
    fn add(self, x: Self::Vector, y: Self::Vector) -> Self::Vector {
        // SAFETY: as in `splat`.
        unsafe { [_mm256_add_ps(x[0], y[0]), _mm256_add_ps(x[1], y[1])] }
    }

    #[inline(always)]
    fn sub(self, x: Self::Vector, y: Self::Vector) -> Self::Vector {
        // SAFETY: as in `splat`.
        unsafe { [_mm256_sub_ps(x[0], y[0]), _mm256_sub_ps(x[1], y[1])] }
    }

    #[inline(always)]
    fn mul(self, x: Self::Vector, y: Self::Vector) -> Self::Vector {
        // SAFETY: as in `splat`.
        unsafe { [_mm256_mul_ps(x[0], y[0]), _mm256_mul_ps(x[1], y[1])] }
    }

    #[inline(always)]
    fn div(self, x: Self::Vector, y: Self::Vector) -> Self::Vector {
        // SAFETY: as in `splat`.
        unsafe { [_mm256_div_ps(x[0], y[0]), _mm256_div_ps(x[1], y[1])] }
    }

    #[inline(always)]
    fn fma(self, x: Self::Vector, y: Self::Vector, z: Self::Vector) -> Self::Vector {
        // SAFETY: as in `splat`.
        unsafe { [_mm256_fmadd_ps(x[0], y[0], z[0]), _mm256_fmadd_ps(x[1], y[1], z[1])] }
    }

    #[inline(always)]
    fn at_most(self, limit: Self::Vector, x: Self::Vector) -> Self::Vector {
        // SAFETY: as in `splat`. The instruction returns its second operand if either is NaN.
        unsafe { [_mm256_min_ps(limit[0], x[0]), _mm256_min_ps(limit[1], x[1])] }
    }

    #[inline(always)]
    fn at_least(self, limit: Self::Vector, x: Self::Vector) -> Self::Vector {
        // SAFETY: as in `splat`. The instruction returns its second operand if either is NaN.
        unsafe { [_mm256_max_ps(limit[0], x[0]), _mm256_max_ps(limit[1], x[1])] }
    }

    #[inline(always)]
    fn where_positive(self, x: Self::Vector, y: Self::Vector) -> Self::Vector {
        // SAFETY: as in `splat`.
        unsafe {
            let zero = _mm256_setzero_ps();
            [
                _mm256_and_ps(_mm256_cmp_ps::<_CMP_GT_OQ>(x[0], zero), y[0]),
                _mm256_and_ps(_mm256_cmp_ps::<_CMP_GT_OQ>(x[1], zero), y[1]),
            ]
        }
    }

    #[inline(always)]
    fn sum(self, x: Self::Vector) -> f32 {
        // SAFETY: as in `splat`.
        unsafe { sum_of_eight(_mm256_add_ps(x[0], x[1])) }
    }

    #[inline(always)]
    fn outlined<O: Operation>(self, operation: O) -> O::Output {
        // SAFETY: as in `splat`.
        unsafe { with_avx2(operation) }
    }
}

impl Simd for Avx512 {
    type Vector = __m512;

    const TILE_SUMS: usize = 24;

    #[inline(always)]
    fn splat(self, x: f32) -> Self::Vector {
        // SAFETY: `self` proves AVX-512F, here and below.
        unsafe { _mm512_set1_ps(x) }
    }

    #[inline(always)]
    fn load(self, from: &Line) -> Self::Vector {
        // SAFETY: a line has sixteen values.
        unsafe { self.load_pointer(from.0.as_ptr()) }
    }

    #[inline(always)]
    fn store(self, x: Self::Vector, to: &mut Line) {
        // SAFETY: a line has sixteen values.
        unsafe { self.store_pointer(x, to.0.as_mut_ptr()) }
    }

    #[inline(always)]
    unsafe fn load_pointer(self, from: *const f32) -> Self::Vector {
        // SAFETY: guaranteed by the caller.
        unsafe { _mm512_loadu_ps(from) }
    }

    #[inline(always)]
    unsafe fn store_pointer(self, x: Self::Vector, to: *mut f32) {
        // SAFETY: guaranteed by the caller.
        unsafe { _mm512_storeu_ps(to, x) }
    }

    #[inline(always)]
    fn add(self, x: Self::Vector, y: Self::Vector) -> Self::Vector {
        // SAFETY: as in `splat`.
        unsafe { _mm512_add_ps(x, y) }
    }

    #[inline(always)]
    fn sub(self, x: Self::Vector, y: Self::Vector) -> Self::Vector {
        // SAFETY: as in `splat`.
        unsafe { _mm512_sub_ps(x, y) }
    }

    #[inline(always)]
    fn mul(self, x: Self::Vector, y: Self::Vector) -> Self::Vector {
        // SAFETY: as in `splat`.
        unsafe { _mm512_mul_ps(x, y) }
    }

    #[inline(always)]
    fn div(self, x: Self::Vector, y: Self::Vector) -> Self::Vector {
        // SAFETY: as in `splat`.
        unsafe { _mm512_div_ps(x, y) }
    }

    #[inline(always)]
    fn fma(self, x: Self::Vector, y: Self::Vector, z: Self::Vector) -> Self::Vector {
        // SAFETY: as in `splat`.
        unsafe { _mm512_fmadd_ps(x, y, z) }
    }

    #[inline(always)]
    fn at_most(self, limit: Self::Vector, x: Self::Vector) -> Self::Vector {
        // SAFETY: as in `splat`. The instruction returns its second operand if either is NaN.
        unsafe { _mm512_min_ps(limit, x) }
    }

    #[inline(always)]
    fn at_least(self, limit: Self::Vector, x: Self::Vector) -> Self::Vector {
        // SAFETY: as in `splat`. The instruction returns its second operand if either is NaN.
        unsafe { _mm512_max_ps(limit, x) }
    }

    #[inline(always)]
    fn where_positive(self, x: Self::Vector, y: Self::Vector) -> Self::Vector {
        // SAFETY: as in `splat`.
        unsafe { _mm512_maskz_mov_ps(_mm512_cmp_ps_mask::<_CMP_GT_OQ>(x, _mm512_setzero_ps()), y) }
    }

    #[inline(always)]
    fn sum(self, x: Self::Vector) -> f32 {
        // SAFETY: as in `splat`.
        unsafe {
            let upper = _mm256_castpd_ps(_mm512_extractf64x4_pd::<1>(_mm512_castps_pd(x)));
            sum_of_eight(_mm256_add_ps(_mm512_castps512_ps256(x), upper))
        }
    }

    #[inline(always)]
    fn outlined<O: Operation>(self, operation: O) -> O::Output {
        // SAFETY: as in `splat`.
        unsafe { with_avx512(operation) }
    }
}
