//! Layer normalisation.

use candle_core::backend::BackendStorage as _;
use candle_core::{CpuStorage, CustomOp3, DType, Layout, Result, Shape, Tensor};

use super::LAYER_NORM_EPSILON;
use super::values::{operand, values};
use crate::math::Real;

/// `(x - mean) / sqrt(var + 1e-5) * weight + bias` over the last axis, with the biased variance: `x`
/// is `[R, F]`, `weight` and `bias` are `[F]`. A constant `x` costs no gradient.
///
/// # Errors
/// If shapes or element types do not fit.
pub fn layer_norm(x: &Tensor, weight: &Tensor, bias: &Tensor) -> Result<Tensor> {
    let (x, weight, bias) = (x.contiguous()?, weight.contiguous()?, bias.contiguous()?);
    x.apply_op3(&weight, &bias, LayerNorm)
}

struct LayerNorm;

/// Rows whose sums grow side by side. A sum goes on only when its last addition is done, so one row
/// alone leaves the processor waiting; each row's own order, and so its bits, are the same.
const SIDE_BY_SIDE: usize = 8;

/// Mean of each row and the inverse of its deviation.
fn moments<T: Real>(x: &[T], width: usize) -> Vec<(T, T)> {
    let mut all = Vec::with_capacity(x.len() / width);
    let blocks = x.chunks_exact(SIDE_BY_SIDE * width);
    let rest = blocks.remainder();
    blocks.for_each(|block| all.extend(moments_of::<T, SIDE_BY_SIDE>(block, width)));
    rest.chunks_exact(width).for_each(|row| all.extend(moments_of::<T, 1>(row, width)));
    all
}

/// [`moments`] of `ROWS` rows.
fn moments_of<T: Real, const ROWS: usize>(block: &[T], width: usize) -> [(T, T); ROWS] {
    let rows: [&[T]; ROWS] = std::array::from_fn(|row| &block[row * width..][..width]);
    let mean = means(rows, [T::zero(); ROWS], |x, _| x);
    let variance = means(rows, mean, |x, mean| (x - mean) * (x - mean));
    let epsilon = T::from_f64(LAYER_NORM_EPSILON);
    std::array::from_fn(|row| (mean[row], T::one() / Real::root(variance[row] + epsilon)))
}

/// Mean of `term(x, about)` over each row.
fn means<T: Real, const ROWS: usize>(
    rows: [&[T]; ROWS],
    about: [T; ROWS],
    term: impl Fn(T, T) -> T,
) -> [T; ROWS] {
    let width = rows[0].len();
    let mut sums = [T::zero(); ROWS];
    for i in 0..width {
        for ((sum, row), &about) in sums.iter_mut().zip(rows).zip(&about) {
            *sum += term(row[i], about);
        }
    }
    sums.map(|sum| sum / T::from_f64(width as f64))
}

fn forward<T: Real>(x: &[T], weight: &[T], bias: &[T]) -> Vec<T> {
    let mut y = Vec::with_capacity(x.len());
    let moments = moments(x, weight.len());
    for (row, (mean, inverse)) in x.chunks_exact(weight.len()).zip(moments) {
        let affine = weight.iter().zip(bias);
        y.extend(row.iter().zip(affine).map(|(&x, (&w, &b))| (x - mean) * inverse * w + b));
    }
    y
}

/// Adds to the gradients by weight and bias, and writes the one by `x` if it is asked for.
fn backward_row<T: Real>(
    (row, weight, g): (&[T], &[T], &[T]),
    (mean, inverse): (T, T),
    (d_weight, d_bias): (&mut [T], &mut [T]),
    d_row: Option<&mut [T]>,
) {
    let count = T::from_f64(row.len() as f64);
    let (mut sum, mut sum_normal) = (T::zero(), T::zero());
    for i in 0..row.len() {
        let normal = (row[i] - mean) * inverse;
        d_weight[i] += g[i] * normal;
        d_bias[i] += g[i];
        sum += g[i] * weight[i];
        sum_normal += g[i] * weight[i] * normal;
    }
    let Some(d_row) = d_row else { return };
    for i in 0..row.len() {
        let normal = (row[i] - mean) * inverse;
        d_row[i] = (g[i] * weight[i] - (sum + normal * sum_normal) / count) * inverse;
    }
}

fn backward<T: Real>(
    x: &Tensor,
    weight: &Tensor,
    g: &Tensor,
) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
    let width = weight.dim(0)?;
    let (xs, weights, gs) = (values::<T>(x)?, values::<T>(weight)?, values::<T>(g)?);
    let (mut d_weight, mut d_bias) = (vec![T::zero(); width], vec![T::zero(); width]);
    let mut dx = vec![T::zero(); if x.track_op() { xs.len() } else { 0 }];
    let mut d_rows = dx.chunks_exact_mut(width);
    let rows = xs.chunks_exact(width).zip(gs.chunks_exact(width));
    for ((row, g), moments) in rows.zip(moments(&xs, width)) {
        backward_row((row, &weights, g), moments, (&mut d_weight, &mut d_bias), d_rows.next());
    }
    let device = x.device();
    let dx = x.track_op().then(|| Tensor::from_vec(dx, x.shape(), device)).transpose()?;
    let d_weight = Tensor::from_vec(d_weight, width, device)?;
    Ok((dx, Some(d_weight), Some(Tensor::from_vec(d_bias, width, device)?)))
}

impl CustomOp3 for LayerNorm {
    fn name(&self) -> &'static str {
        "layer-norm"
    }

    fn cpu_fwd(
        &self,
        x: &CpuStorage,
        x_layout: &Layout,
        weight: &CpuStorage,
        weight_layout: &Layout,
        bias: &CpuStorage,
        bias_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let (rows, width) = x_layout.shape().dims2()?;
        let affine = (weight_layout.shape().dims1()?, bias_layout.shape().dims1()?);
        if affine != (width, width) {
            candle_core::bail!("layer_norm: x [{rows}, {width}], weight and bias {affine:?}")
        }
        macro_rules! run {
            ($float:ty) => {{
                let weight = operand::<$float>(weight, weight_layout)?;
                let y = forward(operand(x, x_layout)?, weight, operand(bias, bias_layout)?);
                Ok((candle_core::WithDType::to_cpu_storage_owned(y), Shape::from((rows, width))))
            }};
        }
        match x.dtype() {
            DType::F32 => run!(f32),
            DType::F64 => run!(f64),
            other => candle_core::bail!("layer_norm: element type {other:?}"),
        }
    }

    fn bwd(
        &self,
        x: &Tensor,
        weight: &Tensor,
        _bias: &Tensor,
        _y: &Tensor,
        g: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let g = &g.contiguous()?;
        match x.dtype() {
            DType::F32 => backward::<f32>(x, weight, g),
            _ => backward::<f64>(x, weight, g),
        }
    }
}
