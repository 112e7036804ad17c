//! Elementary functions in single precision, computed only with correctly rounded operations.

use crate::simd::{Operation, Simd};
use crate::width;

/// Inputs are clamped to this magnitude; the approximation gives 1 from here on.
const TANH_LIMIT: f32 = 7.905_311;

/// Coefficients of the numerator of `tanh(x) / x` in powers of `x^2`, the highest first.
const NUMERATOR: [f32; 7] = [
    -2.760_768_5e-16,
    2.000_188e-13,
    -8.604_672e-11,
    5.122_297_3e-8,
    1.485_722_4e-5,
    6.372_619_4e-4,
    4.893_524_6e-3,
];

/// Coefficients of the denominator.
const DENOMINATOR: [f32; 4] = [1.198_258_4e-6, 1.185_347e-4, 2.268_434_6e-3, 4.893_525e-3];

/// Hyperbolic tangent: the ratio of an odd polynomial of degree 13 and an even one of degree 6 (the usual minimax
/// coefficients). Its relative error is below 5e-7.
#[inline(always)]
pub(crate) fn tanh_of<S: Simd>(simd: S, x: S::Vector) -> S::Vector {
    let x = simd.at_least(simd.splat(-TANH_LIMIT), x);
    let x = simd.at_most(simd.splat(TANH_LIMIT), x);
    let square = simd.mul(x, x);
    let numerator = polynomial(simd, square, &NUMERATOR);
    let denominator = polynomial(simd, square, &DENOMINATOR);
    simd.div(simd.mul(x, numerator), denominator)
}

/// Horner's method; `coefficients` start with the highest power.
#[inline(always)]
fn polynomial<S: Simd>(simd: S, x: S::Vector, coefficients: &[f32]) -> S::Vector {
    let mut sum = simd.splat(coefficients[0]);
    for &coefficient in &coefficients[1..] {
        sum = simd.fma(sum, x, simd.splat(coefficient));
    }
    sum
}

/// `1 / (1 + exp(-x)) = (1 + tanh(x / 2)) / 2`.
#[inline(always)]
pub(crate) fn sigmoid_of<S: Simd>(simd: S, x: S::Vector) -> S::Vector {
    let half = simd.splat(0.5);
    simd.fma(half, tanh_of(simd, simd.mul(half, x)), half)
}

struct ScalarCall {
    x: f32,
    sigmoid: bool,
}

impl Operation for ScalarCall {
    type Output = f32;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> f32 {
        let x = simd.splat(self.x);
        let y = if self.sigmoid { sigmoid_of(simd, x) } else { tanh_of(simd, x) };
        let mut line = crate::simd::Line::default();
        simd.store(y, &mut line);
        line.0[0]
    }
}

/// Hyperbolic tangent of one number; relative error below 5e-7.
#[must_use]
pub fn tanh(x: f32) -> f32 {
    width().run(ScalarCall { x, sigmoid: false })
}

/// `1 / (1 + exp(-x))` of one number.
#[must_use]
pub fn sigmoid(x: f32) -> f32 {
    width().run(ScalarCall { x, sigmoid: true })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tangent_is_within_five_ten_millionths_of_the_exact_one() {
        let step = if cfg!(miri) { 5000 } else { 1 };
        for i in (-200_000..=200_000_i32).step_by(step) {
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
            let most = if x.abs() > 15.0 { 3e-4 } else { 5e-7 };
            assert!((f64::from(sigmoid(x)) - exact).abs() < most, "sigmoid({x})");
            assert!((0.0..=1.0).contains(&sigmoid(x)));
        }
    }

    #[test]
    fn nan_stays_nan() {
        assert!(tanh(f32::NAN).is_nan() && sigmoid(f32::NAN).is_nan());
    }
}
