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

/// A row's part of the backward pass.
#[derive(Clone, Copy)]
struct Row<'a, T> {
    x: &'a [T],
    g: &'a [T],
    /// Mean and inverse deviation.
    moments: (T, T),
}

impl<T: Real> Row<'_, T> {
    fn normal(&self, i: usize) -> T {
        (self.x[i] - self.moments.0) * self.moments.1
    }

    /// Adds to the gradients by weight and bias.
    fn add_affine(&self, d_weight: &mut [T], d_bias: &mut [T]) {
        let (mean, inverse) = self.moments;
        let known = self.x.iter().zip(self.g);
        for ((d_weight, d_bias), (&x, &g)) in d_weight.iter_mut().zip(d_bias).zip(known) {
            *d_weight += g * ((x - mean) * inverse);
            *d_bias += g;
        }
    }

    /// Writes the gradient by `x`, given what [`sums`] says.
    fn write(&self, weight: &[T], (sum, sum_normal): (T, T), d_row: &mut [T]) {
        let (count, (mean, inverse)) = (T::from_f64(weight.len() as f64), self.moments);
        let known = self.x.iter().zip(self.g).zip(weight);
        for (d, ((&x, &g), &weight)) in d_row.iter_mut().zip(known) {
            let normal = (x - mean) * inverse;
            *d = (g * weight - (sum + normal * sum_normal) / count) * inverse;
        }
    }
}

/// Of each row, the sums of `g weight` and of `g weight normal`, grown side by side.
fn sums<T: Real, const ROWS: usize>(rows: &[Row<'_, T>; ROWS], weight: &[T]) -> [(T, T); ROWS] {
    let (mut plain, mut normal) = ([T::zero(); ROWS], [T::zero(); ROWS]);
    for (i, &weight) in weight.iter().enumerate() {
        for (row, sums) in rows.iter().zip(plain.iter_mut().zip(&mut normal)) {
            *sums.0 += row.g[i] * weight;
            *sums.1 += row.g[i] * weight * row.normal(i);
        }
    }
    std::array::from_fn(|row| (plain[row], normal[row]))
}

/// Writes the gradients by the rows of `x`, `[R, F]`.
fn backward_rows<T: Real>(rows: &[Row<'_, T>], weight: &[T], dx: &mut [T]) {
    let (blocks, rest) = rows.as_chunks::<SIDE_BY_SIDE>();
    let all = blocks.iter().flat_map(|block| sums(block, weight));
    let all = all.chain(rest.iter().flat_map(|row| sums(&[*row], weight)));
    for ((row, sums), d_row) in rows.iter().zip(all).zip(dx.chunks_exact_mut(weight.len())) {
        row.write(weight, sums, d_row);
    }
}

fn backward<T: Real>(
    x: &Tensor,
    weight: &Tensor,
    g: &Tensor,
) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
    let width = weight.dim(0)?;
    let (xs, weights, gs) = (values::<T>(x)?, values::<T>(weight)?, values::<T>(g)?);
    let given = xs.chunks_exact(width).zip(gs.chunks_exact(width)).zip(moments(&xs, width));
    let rows: Vec<_> = given.map(|((x, g), moments)| Row { x, g, moments }).collect();
    let (mut d_weight, mut d_bias) = (vec![T::zero(); width], vec![T::zero(); width]);
    rows.iter().for_each(|row| row.add_affine(&mut d_weight, &mut d_bias));
    let mut dx = vec![T::zero(); if x.track_op() { xs.len() } else { 0 }];
    if x.track_op() {
        backward_rows(&rows, &weights, &mut dx);
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
