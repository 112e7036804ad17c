//! Elementary functions that give the same bits on every machine: `libm` in double precision, a
//! rational approximation in single precision that loops of it vectorise.

use candle_core::WithDType;

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

/// Hyperbolic tangent as a ratio of an odd polynomial of degree 13 and an even one of degree 6
/// (the minimax coefficients in common use), relative error below 5e-7. Only multiplications,
/// additions and one division: no fused operation, so AVX2 and AVX-512 agree.
#[must_use]
#[inline]
pub fn tanh(x: f32) -> f32 {
    let x = x.clamp(-TANH_LIMIT, TANH_LIMIT);
    let x2 = x * x;
    let mut p = -2.760_768_5e-16_f32;
    for coefficient in [
        2.000_188e-13,
        -8.604_672e-11,
        5.122_297_3e-8,
        1.485_722_4e-5,
        6.372_619_4e-4,
        4.893_524_6e-3,
    ] {
        p = p * x2 + coefficient;
    }
    let mut q = 1.198_258_4e-6_f32;
    for coefficient in [1.185_347e-4, 2.268_434_6e-3, 4.893_525e-3] {
        q = q * x2 + coefficient;
    }
    x * p / q
}

/// `1 / (1 + exp(-x)) = (1 + tanh(x / 2)) / 2`.
#[must_use]
#[inline]
pub fn sigmoid(x: f32) -> f32 {
    0.5 * tanh(0.5 * x) + 0.5
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
