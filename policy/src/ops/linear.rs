//! A linear map with its activation.

use candle_core::backend::BackendStorage as _;
use candle_core::{CpuStorage, CustomOp3, DType, Layout, Result, Shape, Tensor};

use super::Activation;
use super::product::{Matrix, add_product, add_rows, repeated};
use super::values::{operand, values};
use crate::math::Real;

/// `activation(x W^T + b)`: `x` is `[R, in]`, `w` `[out, in]`, `b` `[out]`, the result `[R, out]`.
/// A constant `x` costs no gradient, nor do a constant `w` and `b`.
///
/// # Errors
/// If shapes or element types do not fit.
pub fn linear(x: &Tensor, w: &Tensor, b: &Tensor, activation: Activation) -> Result<Tensor> {
    let (x, w, b) = (x.contiguous()?, w.contiguous()?, b.contiguous()?);
    x.apply_op3(&w, &b, Linear { activation })
}

struct Linear {
    activation: Activation,
}

impl Linear {
    fn forward<T: Real>(&self, x: &[T], w: &[T], b: &[T], (rows, inner): (usize, usize)) -> Vec<T> {
        let mut y = repeated(b, rows);
        add_product(&mut y, Matrix::new(x, rows, inner), Matrix::new(w, b.len(), inner).t());
        match self.activation {
            Activation::Identity => {}
            Activation::Tanh => y.iter_mut().for_each(|y| *y = Real::tanh(*y)),
            // A choice for every number, not a jump over the positive ones, which nobody can predict.
            Activation::Relu => {
                y.iter_mut().for_each(|y| *y = if *y < T::zero() { T::zero() } else { *y })
            }
        }
        y
    }

    /// Gradient by the linear map's result, from the gradient `g` by the activation's.
    fn before_activation<T: Real>(&self, y: &[T], g: &[T]) -> Vec<T> {
        let pairs = y.iter().zip(g);
        match self.activation {
            Activation::Identity => g.to_vec(),
            Activation::Tanh => pairs.map(|(&y, &g)| g * (T::one() - y * y)).collect(),
            Activation::Relu => {
                pairs.map(|(&y, &g)| if y > T::zero() { g } else { T::zero() }).collect()
            }
        }
    }

    fn backward<T: Real>(
        &self,
        (x, w, b, y, g): (&Tensor, &Tensor, &Tensor, &Tensor, &Tensor),
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let (rows, inner) = x.dims2()?;
        let out = w.dim(0)?;
        let dz = self.before_activation::<T>(&values(y)?, &values(g)?);
        let dz_matrix = Matrix::new(&dz, rows, out);
        let by_x = || {
            let mut dx = vec![T::zero(); rows * inner];
            add_product(&mut dx, dz_matrix, Matrix::new(&values::<T>(w)?, out, inner));
            Tensor::from_vec(dx, (rows, inner), x.device())
        };
        let by_w = || {
            let mut dw = vec![T::zero(); out * inner];
            add_product(&mut dw, dz_matrix.t(), Matrix::new(&values::<T>(x)?, rows, inner));
            Tensor::from_vec(dw, (out, inner), x.device())
        };
        let by_b = || {
            let mut db = vec![T::zero(); out];
            add_rows(&mut db, &dz);
            Tensor::from_vec(db, out, x.device())
        };
        let dx = x.track_op().then(by_x).transpose()?;
        Ok((dx, w.track_op().then(by_w).transpose()?, b.track_op().then(by_b).transpose()?))
    }
}

impl CustomOp3 for Linear {
    fn name(&self) -> &'static str {
        "linear"
    }

    fn cpu_fwd(
        &self,
        x: &CpuStorage,
        x_layout: &Layout,
        w: &CpuStorage,
        w_layout: &Layout,
        b: &CpuStorage,
        b_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let (rows, inner) = x_layout.shape().dims2()?;
        let (out, w_inner) = w_layout.shape().dims2()?;
        if w_inner != inner || b_layout.shape().dims1()? != out {
            candle_core::bail!("linear: x [{rows}, {inner}], W [{out}, {w_inner}], b {b_layout:?}")
        }
        let shape = Shape::from((rows, out));
        macro_rules! run {
            ($float:ty) => {{
                let (x, w) = (operand::<$float>(x, x_layout)?, operand(w, w_layout)?);
                let y = self.forward(x, w, operand(b, b_layout)?, (rows, inner));
                Ok((candle_core::WithDType::to_cpu_storage_owned(y), shape))
            }};
        }
        match x.dtype() {
            DType::F32 => run!(f32),
            DType::F64 => run!(f64),
            other => candle_core::bail!("linear: element type {other:?}"),
        }
    }

    fn bwd(
        &self,
        x: &Tensor,
        w: &Tensor,
        b: &Tensor,
        y: &Tensor,
        g: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let g = &g.contiguous()?;
        match x.dtype() {
            DType::F32 => self.backward::<f32>((x, w, b, y, g)),
            _ => self.backward::<f64>((x, w, b, y, g)),
        }
    }
}
