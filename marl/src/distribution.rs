//! Action distributions in f64. [`RowDistribution`] has the formulas of one row, with one implementation per kind of
//! action. [`HeadRows`] has the parameters of all rows.

pub mod categorical;
pub mod gaussian;
pub mod head_rows;
mod shared_noise;

pub use categorical::CategoricalRow;
pub use gaussian::GaussianRow;
pub use head_rows::HeadRows;

/// Parameters of the distribution of one row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row<'a> {
    /// Outputs of the head: means of a Gaussian, `[act]`, or logits, `[K]`.
    pub outputs: &'a [f64],
    /// Standard deviations of a Gaussian, `[act]`, equal in all rows; empty for a categorical distribution.
    pub sigma: &'a [f64],
}

/// Gradient with respect to the parameters of one row, in the shapes of [`Row`].
#[derive(Debug)]
pub struct RowGradient<'a> {
    /// With respect to the outputs.
    pub outputs: &'a mut [f64],
    /// With respect to the standard deviations, summed over rows.
    pub sigma: &'a mut [f64],
}

/// Formulas of one kind of distribution for one row. `p` and `q` have equal shapes. Methods named `add_*` add `weight`
/// times a gradient to `gradient`.
pub trait RowDistribution: Sync {
    /// `log p(a)` of an action `[act]`, nats.
    fn log_prob(&self, action: &[f64], p: Row<'_>) -> f64;

    /// Gradient of [`RowDistribution::log_prob`] with respect to `p`.
    fn add_log_prob_gradient(
        &self,
        weight: f64,
        action: &[f64],
        p: Row<'_>,
        gradient: RowGradient<'_>,
    );

    /// The part of the entropy that depends on the row's outputs, nats. It is 0 for a Gaussian, whose entropy depends
    /// only on sigma ([`gaussian::entropy`]).
    fn row_entropy(&self, _outputs: &[f64]) -> f64 {
        0.0
    }

    /// Gradient of [`RowDistribution::row_entropy`] with respect to the outputs.
    fn add_row_entropy_gradient(&self, _weight: f64, _outputs: &[f64], _gradient: &mut [f64]) {}

    /// Eq. (6): `KL[q || p]`, the divergence inside the mutual information, in closed form; nats.
    fn kl_divergence(&self, q: Row<'_>, p: Row<'_>) -> f64;

    /// Gradient of [`RowDistribution::kl_divergence`] with respect to `q`; `p` is constant.
    fn add_kl_gradient_by_q(&self, weight: f64, q: Row<'_>, p: Row<'_>, gradient: RowGradient<'_>);

    /// Gradient of [`RowDistribution::kl_divergence`] with respect to `p`; `q` is constant.
    fn add_kl_gradient_by_p(&self, weight: f64, q: Row<'_>, p: Row<'_>, gradient: RowGradient<'_>);
}

#[cfg(test)]
mod tests;
