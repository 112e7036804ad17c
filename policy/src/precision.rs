//! Precision of an update: single for training, double for checking it.

use candle_core::DType;

/// Float type of networks, optimisers and the values computed from them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Precision {
    /// 32-bit floats and the fast tanh. All runs use it.
    Single,
    /// 64-bit floats and exact elementary functions, for comparison with reference values.
    Double,
}

impl Precision {
    /// Element type of tensors.
    #[must_use]
    pub fn dtype(self) -> DType {
        match self {
            Self::Single => DType::F32,
            Self::Double => DType::F64,
        }
    }

    /// `x` rounded to this precision.
    #[must_use]
    pub fn round(self, x: f64) -> f64 {
        match self {
            Self::Single => f64::from(x as f32),
            Self::Double => x,
        }
    }

    /// [`Precision::round`] of every value.
    #[must_use]
    pub fn rounded(self, numbers: Vec<f64>) -> Vec<f64> {
        numbers.into_iter().map(|x| self.round(x)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn single_precision_drops_the_thirtieth_bit_and_double_keeps_it() {
        let x = 1.0 + 1.0 / f64::from(1_u32 << 30);
        assert_eq!((Precision::Single.round(x), Precision::Double.round(x)), (1.0, x));
    }
}
