//! Parameters of the action distributions of many rows in f64, converted from a head's tensors.

use std::ops::Range;

use candle_core::Tensor;
use policy::Distribution;

use super::{CategoricalRow, GaussianRow, Row, RowDistribution, RowGradient};
use crate::data::batch::ActionKind;
use crate::data::sequence::ChunkLayout;
use crate::error::MarlError;
use crate::optimisation::gradient::{self, OutputGradient, numbers};
use crate::shape::assert_shape;

/// Distributions of `R` rows, or a gradient with respect to their parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct HeadRows {
    /// Kind of action.
    pub kind: ActionKind,
    /// Means, `[R, act]`, or logits, `[R, K]`.
    pub outputs: Vec<f64>,
    /// Standard deviations, equal in all rows, `[act]`; empty for a discrete action.
    pub sigma: Vec<f64>,
    /// Loadings of the noise that all agents share, `[act, K]`; empty if the noise is independent.
    pub loading: Vec<f64>,
}

impl HeadRows {
    /// Gaussians with means `[R, act]` and standard deviations `[act]`.
    #[must_use]
    pub fn gaussian(mean: Vec<f64>, sigma: Vec<f64>) -> Self {
        Self { kind: ActionKind::Continuous, outputs: mean, sigma, loading: Vec::new() }
    }

    /// Categorical distributions with logits `[R, choices]`.
    #[must_use]
    pub fn categorical(logits: Vec<f64>, choices: usize) -> Self {
        let kind = ActionKind::Discrete { choices };
        Self { kind, outputs: logits, sigma: Vec::new(), loading: Vec::new() }
    }

    /// Values of a head's tensors.
    ///
    /// # Errors
    /// If a tensor operation fails.
    pub fn of(distribution: &Distribution) -> Result<Self, MarlError> {
        Ok(match distribution {
            Distribution::Gaussian(own) => {
                let loading = own.loading.as_ref().map(numbers).transpose()?.unwrap_or_default();
                Self { loading, ..Self::gaussian(numbers(&own.mean)?, numbers(&own.sigma)?) }
            }
            Distribution::Categorical(own) => {
                Self::categorical(numbers(&own.logits)?, own.logits.dim(1)?)
            }
        })
    }

    /// A copy with other outputs.
    fn with_outputs(&self, outputs: Vec<f64>) -> Self {
        let (sigma, loading) = (self.sigma.clone(), self.loading.clone());
        Self { kind: self.kind, outputs, sigma, loading }
    }

    /// Formulas of this kind of distribution.
    #[must_use]
    pub fn distribution(&self) -> &'static dyn RowDistribution {
        match self.kind {
            ActionKind::Continuous => &GaussianRow,
            ActionKind::Discrete { .. } => &CategoricalRow,
        }
    }

    /// Size of an action, `act`.
    #[must_use]
    pub fn action_size(&self) -> usize {
        match self.kind {
            ActionKind::Continuous => self.sigma.len(),
            ActionKind::Discrete { .. } => 1,
        }
    }

    /// Outputs per row, `act` or `K`.
    fn width(&self) -> usize {
        match self.kind {
            ActionKind::Continuous => self.sigma.len(),
            ActionKind::Discrete { choices } => choices,
        }
    }

    /// Number of rows, `R`.
    #[must_use]
    pub fn count(&self) -> usize {
        self.outputs.len() / self.width()
    }

    /// Parameters of row `row`.
    #[must_use]
    pub fn row(&self, row: usize) -> Row<'_> {
        Row { outputs: &self.outputs[row * self.width()..][..self.width()], sigma: &self.sigma }
    }

    /// Gradient with respect to the parameters of row `row`.
    pub(crate) fn row_gradient(&mut self, row: usize) -> RowGradient<'_> {
        let width = self.width();
        RowGradient { outputs: &mut self.outputs[row * width..][..width], sigma: &mut self.sigma }
    }

    /// A zero gradient in the shapes of these parameters.
    #[must_use]
    pub fn zeros(&self) -> Self {
        let zeros = |of: &[f64]| vec![0.0; of.len()];
        let (outputs, sigma) = (zeros(&self.outputs), zeros(&self.sigma));
        Self { kind: self.kind, outputs, sigma, loading: zeros(&self.loading) }
    }

    /// `log p(a)` of the rows `of`, nats; `action` is `[R, act]`.
    #[must_use]
    pub fn log_prob(&self, action: &[f64], of: &[usize]) -> Vec<f64> {
        let width = self.action_size();
        let row = |&row: &usize| self.log_prob_of(row, &action[row * width..(row + 1) * width]);
        of.iter().map(row).collect()
    }

    /// `log p(a)` of an action `[act]` in row `row`, nats.
    #[must_use]
    pub fn log_prob_of(&self, row: usize, action: &[f64]) -> f64 {
        self.distribution().log_prob(action, self.row(row))
    }

    /// Adds `weight` times the gradient of [`HeadRows::log_prob_of`] with respect to the parameters of `p`.
    pub fn add_log_prob_gradient(&mut self, weight: f64, row: usize, action: &[f64], p: &Self) {
        let gradient = self.row_gradient(row);
        p.distribution().add_log_prob_gradient(weight, action, p.row(row), gradient);
    }

    /// `KL[self || p]` of every row, `[R]`, nats.
    ///
    /// # Panics
    /// If the shapes differ.
    pub(crate) fn kl_divergences(&self, p: &Self) -> Vec<f64> {
        self.assert_same_shape(p);
        let distribution = self.distribution();
        (0..self.count()).map(|row| distribution.kl_divergence(self.row(row), p.row(row))).collect()
    }

    /// Panics if the kinds of action or the numbers of rows differ.
    pub(crate) fn assert_same_shape(&self, other: &Self) {
        let shape = |rows: &Self| (rows.kind, rows.outputs.len(), rows.sigma.len());
        assert_shape("distributions (kind, outputs, sigma)", shape(other), shape(self));
    }

    /// A copy of the given rows.
    pub(crate) fn of_rows(&self, rows: &[usize]) -> Self {
        self.with_outputs(rows.iter().flat_map(|&row| self.row(row).outputs).copied().collect())
    }

    /// A copy with `shift` `[R, out]` added to the outputs, sigma multiplied by `factor`, `[act]`, and independent noise.
    ///
    /// # Panics
    /// If the shapes differ.
    pub(crate) fn corrected(&self, shift: &[f64], factor: &[f64]) -> Self {
        assert_shape("shift", shift.len(), self.outputs.len());
        assert_shape("factor", factor.len(), self.sigma.len());
        Self {
            kind: self.kind,
            outputs: self.outputs.iter().zip(shift).map(|(x, by)| x + by).collect(),
            sigma: self.sigma.iter().zip(factor).map(|(x, by)| x * by).collect(),
            loading: Vec::new(),
        }
    }

    /// Gradients with respect to the `shift` and the `factor` of [`HeadRows::corrected`], from that with respect to its
    /// result.
    pub(crate) fn correction_gradient(&self, gradient: Self) -> (Vec<f64>, Vec<f64>) {
        let by_factor = gradient.sigma.iter().zip(&self.sigma).map(|(slope, sigma)| slope * sigma);
        (gradient.outputs, by_factor.collect())
    }

    /// Concatenates the rows of `parts`, all of this kind.
    #[must_use]
    pub fn joined(&self, parts: &[Self]) -> Self {
        let all = parts.iter().flat_map(|part| &part.outputs).copied().collect();
        parts.first().unwrap_or(self).with_outputs(all)
    }

    /// Rows of the chunks `columns`, from chunked rows `[L, C]`.
    #[must_use]
    pub fn columns(&self, layout: ChunkLayout, columns: &[usize]) -> Self {
        self.with_outputs(layout.columns(&self.outputs, self.width(), columns))
    }

    /// Combines `parts`, each with the chunks `[L, chunks]`, to all rows `[L, C]`.
    ///
    /// # Panics
    /// If `parts` is empty.
    pub(crate) fn gathered(parts: &[Self], layout: ChunkLayout, chunks: &[Range<usize>]) -> Self {
        let width = parts[0].width();
        let mut all = vec![0.0; layout.rows() * width];
        for (part, chunks) in parts.iter().zip(chunks) {
            let columns: Vec<usize> = chunks.clone().collect();
            layout.scatter(&part.outputs, &mut all, width, &columns);
        }
        parts[0].with_outputs(all)
    }

    /// A scalar whose gradient with respect to the tensors of `head` is this one; see `gradient::root`.
    ///
    /// # Errors
    /// If a tensor operation fails.
    pub fn root(&self, head: &Distribution) -> Result<Tensor, MarlError> {
        let outputs = match head {
            Distribution::Gaussian(own) => {
                [&own.mean, &own.sigma].into_iter().chain(&own.loading).collect()
            }
            Distribution::Categorical(own) => vec![&own.logits],
        };
        let outputs = outputs.into_iter().zip([&self.outputs, &self.sigma, &self.loading]);
        let outputs: Vec<OutputGradient<'_>> =
            outputs.map(|(output, gradient)| OutputGradient { output, gradient }).collect();
        gradient::root(&outputs)
    }
}
