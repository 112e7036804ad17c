//! Elementary functions that give the same bits on every machine: `libm` in double precision, a
//! rational approximation in single precision that loops of it vectorise.

use candle_core::WithDType;
use pulp::{Scalar, Simd};

/// A float that the fused operations compute with.
pub trait Real: WithDType + core::ops::Neg<Output = Self> {
    /// Hyperbolic tangent.
    fn tanh(self) -> Self;
    /// `1 / (1 + exp(-x))`.
    fn sigmoid(self) -> Self;
    /// Square root.
    fn root(self) -> Self;
}

impl Real for f32 {
    fn tanh(self) -> Self {
        tanh(self)
    }
    fn sigmoid(self) -> Self {
        sigmoid(self)
    }
    fn root(self) -> Self {
        self.sqrt()
    }
}

impl Real for f64 {
    fn tanh(self) -> Self {
        libm::tanh(self)
    }
    fn sigmoid(self) -> Self {
        1.0 / (1.0 + libm::exp(-self))
    }
    fn root(self) -> Self {
        self.sqrt()
    }
}

/// Beyond this the single-precision tangent is 1 to the last bit that the approximation gives.
const TANH_LIMIT: f32 = 7.905_311;

/// Coefficients of `tanh(x) / x`'s numerator in powers of `x^2`, the highest first.
const NUMERATOR: [f32; 7] = [
    -2.760_768_5e-16,
    2.000_188e-13,
    -8.604_672e-11,
    5.122_297_3e-8,
    1.485_722_4e-5,
    6.372_619_4e-4,
    4.893_524_6e-3,
];

/// Its denominator's.
const DENOMINATOR: [f32; 4] = [1.198_258_4e-6, 1.185_347e-4, 2.268_434_6e-3, 4.893_525e-3];

/// Hyperbolic tangent as a ratio of an odd polynomial of degree 13 and an even one of degree 6
/// (the minimax coefficients in common use), relative error below 5e-7. Only multiplications,
/// additions and one division: no fused operation, so AVX2 and AVX-512 agree.
#[must_use]
#[inline(always)]
pub fn tanh(x: f32) -> f32 {
    tanhs(Scalar::new(), x)
}

/// `1 / (1 + exp(-x)) = (1 + tanh(x / 2)) / 2`.
#[must_use]
#[inline(always)]
pub fn sigmoid(x: f32) -> f32 {
    sigmoids(Scalar::new(), x)
}

/// [`tanh`] of a register's numbers.
#[inline(always)]
pub(crate) fn tanhs<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    let (low, high) = (simd.splat_f32s(-TANH_LIMIT), simd.splat_f32s(TANH_LIMIT));
    // Compared instead of min and max, which would turn what is no number into one.
    let x = simd.select_f32s(simd.less_than_f32s(x, low), low, x);
    let x = simd.select_f32s(simd.greater_than_f32s(x, high), high, x);
    let x2 = simd.mul_f32s(x, x);
    let p = polynomial(simd, x2, &NUMERATOR);
    let q = polynomial(simd, x2, &DENOMINATOR);
    simd.div_f32s(simd.mul_f32s(x, p), q)
}

/// Horner's scheme; the highest power's coefficient comes first.
#[inline(always)]
fn polynomial<S: Simd>(simd: S, x: S::f32s, coefficients: &[f32]) -> S::f32s {
    let mut sum = simd.splat_f32s(coefficients[0]);
    for &coefficient in &coefficients[1..] {
        sum = simd.add_f32s(simd.mul_f32s(sum, x), simd.splat_f32s(coefficient));
    }
    sum
}

/// [`sigmoid`] of a register's numbers.
#[inline(always)]
pub(crate) fn sigmoids<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    let half = simd.splat_f32s(0.5);
    let tangent = tanhs(simd, simd.mul_f32s(half, x));
    simd.add_f32s(simd.mul_f32s(half, tangent), half)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fast_tangent_is_within_five_ten_millionths_of_the_exact_one() {
        for i in -200_000..=200_000_i32 {
            let x = i as f32 * 1e-4;
            let exact = libm::tanh(f64::from(x));
            let error = (f64::from(tanh(x)) - exact).abs();
            assert!(error <= 5e-7 * exact.abs().max(1e-3), "tanh({x}) is off by {error}");
        }
    }

    #[test]
    fn the_sigmoid_stays_between_zero_and_one() {
        for x in [-1e30_f32, -20.0, -1.0, 0.0, 1.0, 20.0, 1e30] {
            let exact = 1.0 / (1.0 + libm::exp(-f64::from(x)));
            assert!(
                (f64::from(sigmoid(x)) - exact).abs()
                    < 3e-4 * f64::from(u8::from(x.abs() > 15.0)) + 5e-7
            );
            assert!((0.0..=1.0).contains(&sigmoid(x)));
        }
    }

    #[test]
    fn what_is_no_number_stays_none() {
        assert!(tanh(f32::NAN).is_nan() && sigmoid(f32::NAN).is_nan());
    }
}
