//! Vectors of sixteen single-precision lanes, for any register width.
//!
//! Every operation is correctly rounded (IEEE 754) in each lane, so all implementations give the same bits. Sums
//! across lanes add in one fixed order: lanes `i + 8`, `+ 4`, `+ 2`, `+ 1`.

#[cfg(target_arch = "aarch64")]
pub(crate) mod neon;
pub(crate) mod scalar;
#[cfg(target_arch = "x86_64")]
pub(crate) mod x86;

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

    /// Maximum number of vectors of sums of a tile, which all fit in registers.
    const TILE_SUMS: usize;

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
    /// Runs `operation` as a function of its own, compiled for this register width.
    fn outlined<O: Operation>(self, operation: O) -> O::Output;
}

/// A computation that is compiled for each register width.
pub(crate) trait Operation {
    type Output;

    /// Everything it calls is inlined, except what it gives to [`Simd::outlined`].
    fn run<S: Simd>(self, simd: S) -> Self::Output;
}
