//! What a head says of every row, as numbers in f64: the one place that tells kinds of action distribution apart
//! between the networks' tensors and the formulas.

use std::ops::Range;

use candle_core::Tensor;
use policy::Distribution;

use crate::actor_loss::categorical::categorical_loss;
use crate::actor_loss::{Coefficients, Figures, Rows, actor_loss};
use crate::error::MarlError;
use crate::gradient::{self, OutputGradient, numbers};
use crate::influence::Term;
use crate::influence::divergence::add_gradient_by_posterior;
use crate::sequence::Layout;
use crate::{categorical, gaussian};

/// A distribution for each of `R` rows, or a gradient by its numbers.
#[derive(Clone, Debug, PartialEq)]
pub enum HeadRows {
    /// Diagonal Gaussians with common deviations.
    Gaussian {
        /// Means, `[R, act]`.
        mean: Vec<f64>,
        /// Deviations, `[act]`.
        sigma: Vec<f64>,
    },
    /// Choices among `K`.
    Categorical {
        /// Logits, `[R, K]`.
        logits: Vec<f64>,
        /// `K`.
        choices: usize,
    },
}

impl HeadRows {
    /// The numbers of a head's tensors.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn of(distribution: &Distribution) -> Result<Self, MarlError> {
        Ok(match distribution {
            Distribution::Gaussian(gaussian) => {
                Self::Gaussian { mean: numbers(&gaussian.mean)?, sigma: numbers(&gaussian.sigma)? }
            }
            Distribution::Categorical(categorical) => Self::Categorical {
                logits: numbers(&categorical.logits)?,
                choices: categorical.logits.dim(1)?,
            },
        })
    }

    /// Numbers in an action, `act`.
    #[must_use]
    pub fn action_size(&self) -> usize {
        match self {
            Self::Gaussian { sigma, .. } => sigma.len(),
            Self::Categorical { .. } => 1,
        }
    }

    /// A gradient of zeros by these numbers.
    #[must_use]
    pub fn zeros(&self) -> Self {
        match self {
            Self::Gaussian { mean, sigma } => {
                Self::Gaussian { mean: vec![0.0; mean.len()], sigma: vec![0.0; sigma.len()] }
            }
            Self::Categorical { logits, choices } => {
                Self::Categorical { logits: vec![0.0; logits.len()], choices: *choices }
            }
        }
    }

    /// `log p(a)` of the given rows' actions; `action` is `[R, act]`; nats.
    #[must_use]
    pub fn log_prob(&self, action: &[f64], of: &[usize]) -> Vec<f64> {
        let width = self.action_size();
        let row = |&row: &usize| self.log_prob_of(row, &action[row * width..(row + 1) * width]);
        of.iter().map(row).collect()
    }

    /// `log p(a)` of an action `[act]` in row `row`, nats.
    #[must_use]
    pub fn log_prob_of(&self, row: usize, action: &[f64]) -> f64 {
        match self {
            Self::Gaussian { mean, sigma } => {
                let width = sigma.len();
                gaussian::log_prob(action, &mean[row * width..(row + 1) * width], sigma)
            }
            Self::Categorical { logits, choices } => {
                categorical::log_prob(action[0] as usize, &logits[row * choices..][..*choices])
            }
        }
    }

    /// Adds `weight` times the gradient of [`HeadRows::log_prob_of`] by the numbers of `p` to this one, which is
    /// of the same kind.
    ///
    /// # Panics
    /// If the kinds differ.
    pub fn add_log_prob_gradient(&mut self, weight: f64, row: usize, action: &[f64], p: &Self) {
        match (self, p) {
            (Self::Gaussian { mean: d_mean, sigma: d_sigma }, Self::Gaussian { mean, sigma }) => {
                let here = row * sigma.len()..(row + 1) * sigma.len();
                let gradient = (&mut d_mean[here.clone()], d_sigma.as_mut_slice());
                gaussian::add_log_prob_gradient(weight, action, (&mean[here], sigma), gradient);
            }
            (Self::Categorical { logits: d, .. }, Self::Categorical { logits, choices }) => {
                let here = row * choices..(row + 1) * choices;
                let (choice, logits) = (action[0] as usize, &logits[here.clone()]);
                categorical::add_log_prob_gradient(weight, choice, logits, &mut d[here]);
            }
            (own, p) => panic!("a gradient {own:?} by {p:?}"),
        }
    }

    /// `weight` times the gradient of the influence term of all rows by these numbers, a posterior's; the policy `p`
    /// is a constant.
    ///
    /// # Panics
    /// For choices: the configuration refuses to train their posteriors so.
    #[must_use]
    pub fn influence_gradient(&self, weight: f64, p: &Self, term: Term) -> Self {
        let (Self::Gaussian { mean, sigma }, Self::Gaussian { mean: p_mean, sigma: p_sigma }) =
            (self, p)
        else {
            panic!("posteriors of choices are trained by likelihood alone")
        };
        let (mut d_mean, mut d_sigma) = (vec![0.0; mean.len()], vec![0.0; sigma.len()]);
        for row in 0..mean.len() / sigma.len() {
            let here = row * sigma.len()..(row + 1) * sigma.len();
            let q = (&mean[here.clone()], sigma.as_slice());
            let p = (&p_mean[here.clone()], p_sigma.as_slice());
            let (_, slope) = term.row(q, p);
            let gradient = (&mut d_mean[here], d_sigma.as_mut_slice());
            add_gradient_by_posterior(term.divergence, weight * slope, q, p, gradient);
        }
        Self::Gaussian { mean: d_mean, sigma: d_sigma }
    }

    /// `KL[self || p]` of every row, `[R]`, nats.
    ///
    /// # Panics
    /// If the kinds differ.
    #[must_use]
    pub fn kl_divergences(&self, p: &Self) -> Vec<f64> {
        match (self, p) {
            (Self::Gaussian { mean, sigma }, Self::Gaussian { mean: p_mean, sigma: p_sigma }) => {
                let width = sigma.len();
                let rows = mean.chunks_exact(width).zip(p_mean.chunks_exact(width));
                rows.map(|(q, p)| gaussian::kl_divergence((q, sigma), (p, p_sigma))).collect()
            }
            (Self::Categorical { logits, choices }, Self::Categorical { logits: p, .. }) => {
                let rows = logits.chunks_exact(*choices).zip(p.chunks_exact(*choices));
                rows.map(|(q, p)| categorical::kl_divergence(q, p)).collect()
            }
            (own, p) => panic!("a divergence of {own:?} from {p:?}"),
        }
    }

    /// The given rows.
    #[must_use]
    pub fn of_rows(&self, rows: &[usize]) -> Self {
        let pick = |numbers: &[f64], width: usize| {
            rows.iter().flat_map(|row| &numbers[row * width..][..width]).copied().collect()
        };
        match self {
            Self::Gaussian { mean, sigma } => {
                Self::Gaussian { mean: pick(mean, sigma.len()), sigma: sigma.clone() }
            }
            Self::Categorical { logits, choices } => {
                Self::Categorical { logits: pick(logits, *choices), choices: *choices }
            }
        }
    }

    /// This policy with `shift` `[R, out]` added to its means or logits and its sigma times `factor`, `[act]`.
    #[must_use]
    pub fn corrected(&self, shift: &[f64], factor: &[f64]) -> Self {
        let add = |numbers: &[f64]| numbers.iter().zip(shift).map(|(x, by)| x + by).collect();
        match self {
            Self::Gaussian { mean, sigma } => Self::Gaussian {
                mean: add(mean),
                sigma: sigma.iter().zip(factor).map(|(x, by)| x * by).collect(),
            },
            Self::Categorical { logits, choices } => {
                Self::Categorical { logits: add(logits), choices: *choices }
            }
        }
    }

    /// From a gradient by the numbers that [`HeadRows::corrected`] gives: that by its `shift` and by its `factor`.
    #[must_use]
    pub fn correction_gradient(&self, gradient: &Self) -> (Vec<f64>, Vec<f64>) {
        let sigma = match self {
            Self::Gaussian { sigma, .. } => sigma.as_slice(),
            Self::Categorical { .. } => &[],
        };
        match gradient {
            Self::Gaussian { mean, sigma: by_sigma } => {
                let by_factor = by_sigma.iter().zip(sigma).map(|(slope, sigma)| slope * sigma);
                (mean.clone(), by_factor.collect())
            }
            Self::Categorical { logits, .. } => (logits.clone(), Vec::new()),
        }
    }

    /// The rows of `parts`, of this kind each, one after another; no rows without parts.
    #[must_use]
    pub fn joined(&self, parts: &[Self]) -> Self {
        let numbers = |part: &Self| part.clone().into_numbers().0;
        let all: Vec<f64> = parts.iter().flat_map(numbers).collect();
        match (parts.first().unwrap_or(self), all) {
            (Self::Gaussian { sigma, .. }, mean) => Self::Gaussian { mean, sigma: sigma.clone() },
            (Self::Categorical { choices, .. }, logits) => {
                Self::Categorical { logits, choices: *choices }
            }
        }
    }

    /// Chunked rows `[L, C]` of some chunks, `[L, columns]`.
    #[must_use]
    pub fn columns(&self, layout: Layout, columns: &[usize]) -> Self {
        match self {
            Self::Gaussian { mean, sigma } => {
                let mean = layout.columns(mean, sigma.len(), columns);
                Self::Gaussian { mean, sigma: sigma.clone() }
            }
            Self::Categorical { logits, choices } => {
                let logits = layout.columns(logits, *choices, columns);
                Self::Categorical { logits, choices: *choices }
            }
        }
    }

    /// Of parts that hold some chunks `[L, chunks]` each, all rows `[L, C]`.
    ///
    /// # Panics
    /// If the kinds differ, or without a part.
    #[must_use]
    pub fn gathered(parts: &[Self], layout: Layout, chunks: &[Range<usize>]) -> Self {
        let together = |width: usize, numbers: &dyn Fn(&Self) -> Vec<f64>| {
            let mut all = vec![0.0; layout.rows() * width];
            for (part, chunks) in parts.iter().zip(chunks) {
                let columns: Vec<usize> = chunks.clone().collect();
                layout.scatter(&numbers(part), &mut all, width, &columns);
            }
            all
        };
        let numbers = |part: &Self| part.clone().into_numbers().0;
        match &parts[0] {
            Self::Gaussian { sigma, .. } => {
                Self::Gaussian { mean: together(sigma.len(), &numbers), sigma: sigma.clone() }
            }
            Self::Categorical { choices, .. } => {
                Self::Categorical { logits: together(*choices, &numbers), choices: *choices }
            }
        }
    }

    /// The form in which [`Rows`] hold a posterior: means and sigma, or logits and nothing.
    #[must_use]
    pub fn into_numbers(self) -> (Vec<f64>, Vec<f64>) {
        match self {
            Self::Gaussian { mean, sigma } => (mean, sigma),
            Self::Categorical { logits, .. } => (logits, Vec::new()),
        }
    }

    /// The actor's loss over these rows, as a share of `total`, and its gradient by their numbers.
    #[must_use]
    pub fn loss(&self, rows: &Rows, total: usize, coefficients: &Coefficients) -> (Figures, Self) {
        match self {
            Self::Gaussian { mean, sigma } => {
                let loss = actor_loss(mean, sigma, rows, total, coefficients);
                (loss.figures, Self::Gaussian { mean: loss.d_mean, sigma: loss.d_sigma })
            }
            Self::Categorical { logits, choices } => {
                let loss = categorical_loss(logits, *choices, rows, total, coefficients);
                (loss.figures, Self::Categorical { logits: loss.d_logits, choices: *choices })
            }
        }
    }

    /// A scalar whose gradient by the tensors of `distribution` is this one; see [`gradient::root`].
    ///
    /// # Errors
    /// Passes on a tensor error.
    ///
    /// # Panics
    /// If the kinds differ.
    pub fn root(&self, distribution: &Distribution) -> Result<Tensor, MarlError> {
        match (self, distribution) {
            (Self::Gaussian { mean, sigma }, Distribution::Gaussian(head)) => gradient::root(&[
                OutputGradient { output: &head.mean, gradient: mean },
                OutputGradient { output: &head.sigma, gradient: sigma },
            ]),
            (Self::Categorical { logits, .. }, Distribution::Categorical(head)) => {
                gradient::root(&[OutputGradient { output: &head.logits, gradient: logits }])
            }
            (own, head) => panic!("a gradient {own:?} of {head:?}"),
        }
    }
}
