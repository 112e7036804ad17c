//! A gated recurrent unit over a whole sequence, as one node of the graph.

use std::sync::{Mutex, PoisonError};

use candle_core::backend::BackendStorage as _;
use candle_core::{CpuStorage, CustomOp3, DType, Layout, Result, Shape, Tensor};

use super::product::{Matrix, add_product, add_rows, repeated};
use super::values::{operand, values};
use crate::math::Real;

/// A GRU over `T` steps of `B` sequences, rows `t * B + b`:
/// `h_t = (1 - z) n + z h'`, `h' = mask_t h_(t-1)`, `r, z = sigmoid(x + W h' + b)`,
/// `n = tanh(x_n + r (W_n h' + b_n))`, gates in PyTorch's order r, z, n.
///
/// `projected` is `x W_ih^T + b_ih`, `[T*B, 3H]`; `w_hh` `[3H, H]`; `b_hh` `[3H]`; `h0` `[B, H]` and
/// `mask` `[T, B]` are constants (a mask of 0 resets the state before its step). The result is every
/// `h_t`, `[T*B, H]`.
///
/// # Errors
/// If shapes or element types do not fit.
pub fn gru_sequence(
    projected: &Tensor,
    w_hh: &Tensor,
    b_hh: &Tensor,
    h0: &Tensor,
    mask: &Tensor,
) -> Result<Tensor> {
    let (projected, w_hh, b_hh) = (projected.contiguous()?, w_hh.contiguous()?, b_hh.contiguous()?);
    match projected.dtype() {
        DType::F32 => projected.apply_op3(&w_hh, &b_hh, GruSequence::<f32>::new(h0, mask)?),
        DType::F64 => projected.apply_op3(&w_hh, &b_hh, GruSequence::<f64>::new(h0, mask)?),
        other => candle_core::bail!("gru_sequence: element type {other:?}"),
    }
}

struct GruSequence<T> {
    steps: usize,
    sequences: usize,
    hidden: usize,
    h0: Vec<T>,
    mask: Vec<T>,
    /// `r, z, n, W_n h' + b_n` of every row, `[T*B, 4H]`, from forward to backward.
    gates: Mutex<Vec<T>>,
}

/// What backpropagation leaves behind: gradients by the two pre-activations, `[T*B, 3H]` each.
struct PreActivations<T> {
    input: Vec<T>,
    hidden: Vec<T>,
}

impl<T: Real> GruSequence<T> {
    fn new(h0: &Tensor, mask: &Tensor) -> Result<Self> {
        let ((steps, sequences), (rows, hidden)) = (mask.dims2()?, h0.dims2()?);
        if rows != sequences {
            candle_core::bail!("gru_sequence: h0 [{rows}, {hidden}], mask [{steps}, {sequences}]")
        }
        let flat = |tensor: &Tensor| tensor.flatten_all()?.to_vec1::<T>();
        let (h0, mask) = (flat(h0)?, flat(mask)?);
        Ok(Self { steps, sequences, hidden, h0, mask, gates: Mutex::default() })
    }

    /// The state before every step with its resets, `[T*B, H]`.
    fn masked_states(&self, y: &[T]) -> Vec<T> {
        let width = self.hidden;
        let before = self.h0.chunks_exact(width).chain(y.chunks_exact(width));
        let rows = before.zip(&self.mask);
        rows.flat_map(|(row, &mask)| row.iter().map(move |&h| h * mask)).collect()
    }

    fn forward(&self, projected: &[T], w: &[T], b: &[T]) -> Vec<T> {
        let (width, block) = (self.hidden, self.sequences * self.hidden);
        let mut gates = vec![T::zero(); 4 * self.steps * block];
        let mut y = vec![T::zero(); self.steps * block];
        let mut state = self.h0.clone();
        for step in 0..self.steps {
            let masks = &self.mask[step * self.sequences..(step + 1) * self.sequences];
            for (row, &mask) in state.chunks_exact_mut(width).zip(masks) {
                row.iter_mut().for_each(|h| *h *= mask);
            }
            let mut recurrent = repeated(b, self.sequences);
            let left = Matrix::new(&state, self.sequences, width);
            add_product(&mut recurrent, left, Matrix::new(w, 3 * width, width).t());
            let input = &projected[3 * step * block..3 * (step + 1) * block];
            let kept = &mut gates[4 * step * block..4 * (step + 1) * block];
            for row in 0..self.sequences {
                let of = |parts: usize| parts * row * width..parts * (row + 1) * width;
                cell(&input[of(3)], &recurrent[of(3)], &mut kept[of(4)], &mut state[of(1)]);
            }
            y[step * block..(step + 1) * block].copy_from_slice(&state);
        }
        *self.gates.lock().unwrap_or_else(PoisonError::into_inner) = gates;
        y
    }

    /// Backpropagation through time, last step first.
    fn through_time(&self, w: &[T], before: &[T], gates: &[T], g: &[T]) -> PreActivations<T> {
        let (width, block) = (self.hidden, self.sequences * self.hidden);
        let mut input = vec![T::zero(); 3 * self.steps * block];
        let mut hidden = input.clone();
        let mut later = vec![T::zero(); block];
        for step in (0..self.steps).rev() {
            let here = step * block..(step + 1) * block;
            let (g, before) = (&g[here.clone()], &before[here]);
            let gates = &gates[4 * step * block..4 * (step + 1) * block];
            let wide = 3 * step * block..3 * (step + 1) * block;
            let (d_input, d_hidden) = (&mut input[wide.clone()], &mut hidden[wide]);
            for row in 0..self.sequences {
                let of = |parts: usize| parts * row * width..parts * (row + 1) * width;
                let known = (&g[of(1)], &before[of(1)], &gates[of(4)]);
                cell_backward(known, &mut later[of(1)], &mut d_input[of(3)], &mut d_hidden[of(3)]);
            }
            let left = Matrix::new(d_hidden, self.sequences, 3 * width);
            add_product(&mut later, left, Matrix::new(w, 3 * width, width));
            let masks = &self.mask[step * self.sequences..(step + 1) * self.sequences];
            for (row, &mask) in later.chunks_exact_mut(width).zip(masks) {
                row.iter_mut().for_each(|d| *d *= mask);
            }
        }
        PreActivations { input, hidden }
    }
}

/// One step of one sequence: writes the gates and turns `h'` into `h_t`.
fn cell<T: Real>(input: &[T], recurrent: &[T], gates: &mut [T], state: &mut [T]) {
    let width = state.len();
    for i in 0..width {
        let r = Real::sigmoid(input[i] + recurrent[i]);
        let z = Real::sigmoid(input[width + i] + recurrent[width + i]);
        let candidate = recurrent[2 * width + i];
        let n = Real::tanh(input[2 * width + i] + r * candidate);
        (gates[i], gates[width + i], gates[2 * width + i]) = (r, z, n);
        gates[3 * width + i] = candidate;
        state[i] = (T::one() - z) * n + z * state[i];
    }
}

/// The backward pass of [`cell`]. `known` is the gradient by `h_t` from above, `h'`, and the gates;
/// `later` comes in as the gradient by `h_t` from the next step and leaves as the direct part of the
/// gradient by `h'`.
fn cell_backward<T: Real>(
    known: (&[T], &[T], &[T]),
    later: &mut [T],
    d_input: &mut [T],
    d_hidden: &mut [T],
) {
    let (g, before, gates) = known;
    let width = g.len();
    for i in 0..width {
        let (r, z, n) = (gates[i], gates[width + i], gates[2 * width + i]);
        let candidate = gates[3 * width + i];
        let d = g[i] + later[i];
        let dz = d * (before[i] - n) * z * (T::one() - z);
        let dn = d * (T::one() - z) * (T::one() - n * n);
        let dr = dn * candidate * r * (T::one() - r);
        (d_input[i], d_input[width + i], d_input[2 * width + i]) = (dr, dz, dn);
        (d_hidden[i], d_hidden[width + i], d_hidden[2 * width + i]) = (dr, dz, dn * r);
        later[i] = d * z;
    }
}

impl<T: Real> CustomOp3 for GruSequence<T> {
    fn name(&self) -> &'static str {
        "gru-sequence"
    }

    fn cpu_fwd(
        &self,
        projected: &CpuStorage,
        projected_layout: &Layout,
        w: &CpuStorage,
        w_layout: &Layout,
        b: &CpuStorage,
        b_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let (rows, width) = (self.steps * self.sequences, self.hidden);
        let found = (projected_layout.shape().dims2()?, w_layout.shape().dims2()?);
        let expected = ((rows, 3 * width), (3 * width, width));
        if found != expected || b_layout.shape().dims1()? != 3 * width {
            candle_core::bail!("gru_sequence: input and weights {found:?}, expected {expected:?}")
        }
        if w.dtype() != projected.dtype() || b.dtype() != projected.dtype() {
            candle_core::bail!("gru_sequence: element types differ")
        }
        let projected = operand::<T>(projected, projected_layout)?;
        let y = self.forward(projected, operand(w, w_layout)?, operand(b, b_layout)?);
        Ok((T::to_cpu_storage_owned(y), Shape::from((rows, width))))
    }

    fn bwd(
        &self,
        projected: &Tensor,
        w: &Tensor,
        _b: &Tensor,
        y: &Tensor,
        g: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let (rows, width) = (self.steps * self.sequences, self.hidden);
        let gates = std::mem::take(&mut *self.gates.lock().unwrap_or_else(PoisonError::into_inner));
        if gates.len() != 4 * rows * width {
            candle_core::bail!("gru_sequence: a second backward pass over one forward pass")
        }
        let before = self.masked_states(&values(y)?);
        let g = g.contiguous()?;
        let d = self.through_time(&values(w)?, &before, &gates, &values(&g)?);
        let (mut dw, mut db) = (vec![T::zero(); 3 * width * width], vec![T::zero(); 3 * width]);
        let left = Matrix::new(&d.hidden, rows, 3 * width).t();
        add_product(&mut dw, left, Matrix::new(&before, rows, width));
        add_rows(&mut db, &d.hidden);
        let device = projected.device();
        Ok((
            Some(Tensor::from_vec(d.input, (rows, 3 * width), device)?),
            Some(Tensor::from_vec(dw, (3 * width, width), device)?),
            Some(Tensor::from_vec(db, 3 * width, device)?),
        ))
    }
}
