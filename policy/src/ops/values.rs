//! Tensors as slices, without a copy.

use std::marker::PhantomData;
use std::ops::{Deref, Range};

use candle_core::{CpuStorage, Layout, Result, Storage, Tensor};

use crate::math::Real;

/// The borrowed elements of a contiguous CPU tensor.
pub(super) struct Values<T, G> {
    storage: G,
    range: Range<usize>,
    element: PhantomData<T>,
}

/// Borrows the elements of `tensor`.
pub(super) fn values<T: Real>(
    tensor: &Tensor,
) -> Result<Values<T, impl Deref<Target = Storage> + '_>> {
    let (storage, layout) = tensor.storage_and_layout();
    let Some((start, end)) = layout.contiguous_offsets() else {
        candle_core::bail!("a fused operation needs contiguous tensors, got {layout:?}")
    };
    match &*storage {
        Storage::Cpu(cpu) => T::cpu_storage_as_slice(cpu)?,
        _ => candle_core::bail!("a fused operation runs on the CPU only"),
    };
    Ok(Values { storage, range: start..end, element: PhantomData })
}

impl<T: Real, G: Deref<Target = Storage>> Deref for Values<T, G> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        match &*self.storage {
            Storage::Cpu(cpu) => T::cpu_storage_as_slice(cpu)
                .map(|slice| &slice[self.range.clone()])
                .unwrap_or_default(),
            _ => &[],
        }
    }
}

/// The elements of a contiguous operand of a custom operation.
pub(super) fn operand<'a, T: Real>(storage: &'a CpuStorage, layout: &Layout) -> Result<&'a [T]> {
    let Some((start, end)) = layout.contiguous_offsets() else {
        candle_core::bail!("a fused operation needs contiguous tensors, got {layout:?}")
    };
    Ok(&T::cpu_storage_as_slice(storage)?[start..end])
}
