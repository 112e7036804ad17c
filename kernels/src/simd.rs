//! Vectors of sixteen single-precision lanes, for any register width.
//!
//! Every operation is correctly rounded (IEEE 754) in each lane, so all implementations give the same bits. Sums
//! across lanes add in one fixed order: lanes `i + 8`, `+ 4`, `+ 2`, `+ 1`.

#[cfg(target_arch = "aarch64")]
mod neon;
mod scalar;
#[cfg(target_arch = "x86_64")]
mod x86;

use crate::product::Product;

/// Lanes of a vector.
pub(crate) const LANES: usize = 16;

/// Sixteen values in memory: one cache line.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C, align(64))]
pub(crate) struct Line(pub(crate) [f32; LANES]);

/// Operations on sixteen lanes. A value of the type proves that the processor has the instructions.
pub(crate) trait Simd: Copy {
    /// Sixteen lanes.
    type Vector: Copy;

    /// Maximum rows of a tile whose sums fit in registers.
    const TILE_ROWS: usize;

    fn splat(self, x: f32) -> Self::Vector;
    fn load(self, from: &Line) -> Self::Vector;
    fn store(self, x: Self::Vector, to: &mut Line);
    /// Loads sixteen values from `from`.
    ///
    /// # Safety
    /// `from` is valid for reading sixteen values.
    unsafe fn load_pointer(self, from: *const f32) -> Self::Vector;
    /// Stores sixteen values to `to`.
    ///
    /// # Safety
    /// `to` is valid for writing sixteen values.
    unsafe fn store_pointer(self, x: Self::Vector, to: *mut f32);
    fn add(self, x: Self::Vector, y: Self::Vector) -> Self::Vector;
    fn sub(self, x: Self::Vector, y: Self::Vector) -> Self::Vector;
    fn mul(self, x: Self::Vector, y: Self::Vector) -> Self::Vector;
    fn div(self, x: Self::Vector, y: Self::Vector) -> Self::Vector;
    /// `x y + z`, rounded once.
    fn fma(self, x: Self::Vector, y: Self::Vector, z: Self::Vector) -> Self::Vector;
    /// `limit < x ? limit : x`; NaN stays NaN.
    fn at_most(self, limit: Self::Vector, x: Self::Vector) -> Self::Vector;
    /// `limit > x ? limit : x`; NaN stays NaN.
    fn at_least(self, limit: Self::Vector, x: Self::Vector) -> Self::Vector;
    /// `x > 0 ? y : 0`.
    fn where_positive(self, x: Self::Vector, y: Self::Vector) -> Self::Vector;
    /// Sum of the lanes in the fixed order.
    fn sum(self, x: Self::Vector) -> f32;
    /// [`crate::product::run`], compiled for this register width.
    fn product(self, product: &Product<'_>);
}

/// A computation that is compiled for each register width.
pub(crate) trait Operation {
    type Output;

    /// Everything it calls is inlined, except [`Simd::product`].
    fn run<S: Simd>(self, simd: S) -> Self::Output;
}

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
