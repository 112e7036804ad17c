//! Sixteen lanes of single precision, whatever the registers' width.
//!
//! Every operation is correctly rounded (IEEE 754), lane by lane, so all implementations give the same bits. Sums
//! across lanes are folded in one fixed order: lanes `i + 8`, `+ 4`, `+ 2`, `+ 1`.

#[cfg(target_arch = "aarch64")]
mod neon;
mod scalar;
#[cfg(target_arch = "x86_64")]
mod x86;

use crate::product::Product;

/// Lanes of a vector.
pub(crate) const LANES: usize = 16;

/// Sixteen numbers in memory, one cache line.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C, align(64))]
pub(crate) struct Line(pub(crate) [f32; LANES]);

/// A proof that the processor has the instructions, with the operations on sixteen lanes.
pub(crate) trait Simd: Copy {
    /// Sixteen lanes.
    type Vector: Copy;

    /// Most rows of a tile, so that its sums stay in registers.
    const TILE_ROWS: usize;

    fn splat(self, x: f32) -> Self::Vector;
    fn load(self, from: &Line) -> Self::Vector;
    fn store(self, x: Self::Vector, to: &mut Line);
    /// Sixteen numbers at `from`.
    ///
    /// # Safety
    /// They can be read.
    unsafe fn load_pointer(self, from: *const f32) -> Self::Vector;
    /// Sixteen numbers to `to`.
    ///
    /// # Safety
    /// They can be written.
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
    /// [`crate::product::run`], compiled for these registers.
    fn product(self, product: &Product<'_>);
}

/// A computation that is compiled for each kind of registers.
pub(crate) trait Operation {
    type Output;

    /// Everything that it calls is inlined, but for [`Simd::product`].
    fn run<S: Simd>(self, simd: S) -> Self::Output;
}

/// The registers that kernels compute with. All widths give the same bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Width {
    /// One number at a time.
    Scalar = 1,
    /// 256 bits, x86-64 with AVX2 and FMA.
    Avx2,
    /// 512 bits, x86-64 with AVX-512F.
    Avx512,
    /// 128 bits, aarch64.
    Neon,
}

impl Width {
    /// All widths, the widest last.
    pub const ALL: [Self; 4] = [Self::Scalar, Self::Neon, Self::Avx2, Self::Avx512];

    /// Its name in `S2MIA_SIMD`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Scalar => "scalar",
            Self::Avx2 => "avx2",
            Self::Avx512 => "avx512",
            Self::Neon => "neon",
        }
    }

    /// The width of this name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|width| width.name() == name)
    }

    /// Whether this processor has it.
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

    /// The widest that this processor has.
    #[must_use]
    pub fn widest() -> Self {
        let available = Self::ALL.into_iter().rev().find(|width| width.is_available());
        available.unwrap_or(Self::Scalar)
    }

    /// Runs `operation`.
    ///
    /// # Panics
    /// If the processor lacks this width.
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
