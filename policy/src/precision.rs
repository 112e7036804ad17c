//! How exactly an update computes: single precision trains, double precision checks it.

use candle_core::DType;

/// The floats of networks, of their optimisers and of what they say about a batch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Precision {
    /// 32-bit floats and the fast hyperbolic tangent; every run trains so.
    Single,
    /// 64-bit floats and exact elementary functions, to be compared with reference values.
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

    /// The nearest number that this precision can hold.
    #[must_use]
    pub fn round(self, x: f64) -> f64 {
        match self {
            Self::Single => f64::from(x as f32),
            Self::Double => x,
        }
    }

    /// Every number rounded as [`Precision::round`] does.
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
