//! Elementary functions with the same bits on every machine: `libm` in double precision, `kernels` in single
//! precision.

use candle_core::WithDType;

/// Float type of networks and optimisers.
pub trait Real: WithDType + core::ops::Neg<Output = Self> {
    /// `1 / (1 + exp(-x))`.
    fn sigmoid(self) -> Self;
    /// Square root.
    fn root(self) -> Self;
}

impl Real for f32 {
    fn sigmoid(self) -> Self {
        kernels::sigmoid(self)
    }
    fn root(self) -> Self {
        self.sqrt()
    }
}

impl Real for f64 {
    fn sigmoid(self) -> Self {
        1.0 / (1.0 + libm::exp(-self))
    }
    fn root(self) -> Self {
        self.sqrt()
    }
}
