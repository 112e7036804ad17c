//! Networks forwards and backwards in vector registers, with the same bits on every processor.
//!
//! A [`Network`] is a list of layers: layer norm, linear map with activation, GRU. [`Packed`] holds its weights in the
//! order in which the registers read them and is made once per optimiser step; [`Packed::forward`] takes blocks of rows
//! through all layers while they are in cache, [`Packed::backward`] the same blocks back.
//!
//! **Fixed arithmetic.** Every sum has one order: products are chains of fused multiply-adds over `k`, gradients of
//! weights one chain over rows, sums across a row sixteen lanes that are folded by halves. The elementary
//! functions are ours. So the result is the same at every [`Width`], and a row's result does not depend on the rows
//! around it.
//!
//! This is the one shipped crate with `unsafe` code of ours: vector instructions, and the pointers of the innermost loop.

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
mod workspace;

use core::sync::atomic::{AtomicU8, Ordering};

pub use math::{sigmoid, tanh};
pub use network::{Activation, Layer, Network};
pub use packed::{Input, Memory, Packed};
pub use simd::Width;
pub use workspace::Workspace;

/// Added to a variance before its root, in a layer norm.
pub const LAYER_NORM_EPSILON: f32 = 1e-5;

/// The selected width as a number; 0 before the first use.
static SELECTED: AtomicU8 = AtomicU8::new(0);

/// The registers that kernels compute with: the widest of this processor, unless [`select`] has chosen others.
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

/// Computes with `width` from now on; false if the processor lacks it.
pub fn select(width: Width) -> bool {
    let available = width.is_available();
    if available {
        SELECTED.store(width as u8, Ordering::Relaxed);
    }
    available
}
