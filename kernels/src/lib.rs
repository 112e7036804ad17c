//! Forward and backward passes of networks in vector registers, bit-identical on every processor.
//!
//! A [`Network`] is a list of layers: layer norm, linear map with activation, GRU. [`Packed`] contains its weights in the
//! order in which the kernel reads them; it is built once per optimiser step. [`Packed::forward`] and
//! [`Packed::backward`] take blocks of rows through all layers while they are in cache.
//!
//! **Fixed arithmetic.** Every sum has one order: a product is a chain of fused multiply-adds over `k`, a gradient of
//! weights one chain over rows, and a sum across a row adds sixteen lanes by halves. The crate implements its own
//! elementary functions. The result is therefore the same at every [`Width`], and a row's result does not depend on the
//! other rows.
//!
//! This is the only shipped crate with `unsafe` code: vector instructions, and the pointers of the innermost loop.

#![expect(unsafe_code, reason = "vector instructions, and the pointers of the innermost loop")]
#![deny(unsafe_op_in_unsafe_fn)]

mod buffer;
mod gru;
mod linear;
mod math;
mod network;
mod norm;
mod packed;
mod product;
mod simd;
mod width;
mod workspace;

use core::sync::atomic::{AtomicU8, Ordering};

pub use gru::SequenceLayout;
pub use math::{sigmoid, tanh};
pub use network::{Activation, Layer, Network};
pub use packed::{Input, Packed};
pub use width::Width;
pub use workspace::Workspace;

/// Added to the variance in a layer norm, before the square root.
pub const LAYER_NORM_EPSILON: f32 = 1e-5;

/// The selected width as a number; 0 before the first use.
static SELECTED: AtomicU8 = AtomicU8::new(0);

/// The register width in use: the widest of this processor, unless [`select`] has set another.
#[must_use]
pub fn width() -> Width {
    let selected = SELECTED.load(Ordering::Relaxed);
    let known = Width::ALL.into_iter().find(|&width| width as u8 == selected);
    known.unwrap_or_else(|| {
        let widest = Width::widest();
        SELECTED.store(widest as u8, Ordering::Relaxed);
        widest
    })
}

/// Sets the register width of all later computations. Returns false, without effect, if the processor does not support it.
pub fn select(width: Width) -> bool {
    let available = width.is_available();
    if available {
        SELECTED.store(width as u8, Ordering::Relaxed);
    }
    available
}
