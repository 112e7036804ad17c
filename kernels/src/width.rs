//! The register width at which the kernels run on this processor.

#[cfg(target_arch = "aarch64")]
use crate::simd::neon;
#[cfg(target_arch = "x86_64")]
use crate::simd::x86;
use crate::simd::{Operation, scalar};

/// Register width of the kernels. All widths give the same bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Width {
    /// No vector instructions.
    Scalar = 1,
    /// 256 bits, x86-64 with AVX2 and FMA.
    Avx2,
    /// 512 bits, x86-64 with AVX-512F.
    Avx512,
    /// 128 bits, aarch64.
    Neon,
}

impl Width {
    /// All widths in ascending order.
    pub const ALL: [Self; 4] = [Self::Scalar, Self::Neon, Self::Avx2, Self::Avx512];

    /// The name in `S2MIA_SIMD`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Scalar => "scalar",
            Self::Avx2 => "avx2",
            Self::Avx512 => "avx512",
            Self::Neon => "neon",
        }
    }

    /// The width with this name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|width| width.name() == name)
    }

    /// Whether this processor supports the width.
    #[must_use]
    pub fn is_available(self) -> bool {
        match self {
            Self::Scalar => true,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => x86::has_avx2(),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => x86::has_avx512(),
            #[cfg(target_arch = "aarch64")]
            Self::Neon => true,
            _ => false,
        }
    }

    /// The widest that this processor supports.
    #[must_use]
    pub fn widest() -> Self {
        let available = Self::ALL.into_iter().rev().find(|width| width.is_available());
        available.unwrap_or(Self::Scalar)
    }

    /// Runs `operation` at this width.
    ///
    /// # Panics
    /// If the processor does not support this width.
    pub(crate) fn run<O: Operation>(self, operation: O) -> O::Output {
        assert!(self.is_available(), "{} is not available on this processor", self.name());
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => x86::run_avx2(operation),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => x86::run_avx512(operation),
            #[cfg(target_arch = "aarch64")]
            Self::Neon => neon::run(operation),
            _ => scalar::run(operation),
        }
    }
}
