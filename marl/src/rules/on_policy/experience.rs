//! What one agent learns from in an iteration: its rollout data, and its posterior's outputs on them.

use candle_core::Tensor;

use crate::data::sequence::Sequences;
use crate::distribution::HeadRows;
use crate::influence::count::JointSample;
use crate::influence::exact::{exact_information, others_precision};
use crate::influence::posterior::Conditions;
use crate::rules::algorithm::Report;

/// Rollout data of one agent in chunked order, with the behaviour weights' outputs.
pub(crate) struct Experience {
    pub(crate) sequences: Sequences,
    /// Normalised advantages, `[L, C]`.
    pub(crate) advantage: Vec<f64>,
    /// Log-probabilities of the actions under the behaviour weights, given the signal, `[L, C]`, nats.
    pub(crate) log_prob: Vec<f64>,
    /// The behaviour policy of every row, without the signal that agents share.
    pub(crate) behaviour: HeadRows,
    /// The trunk's features under the behaviour weights, `[L * C, F]`; constant.
    pub(super) features: Tensor,
    /// Every other agent's action, in agent order, `[L, C, others]`.
    pub(super) others: Vec<f32>,
    /// Ids of state and actions for counting, `[L, C]`; `None` unless they are counted.
    pub(super) samples: Option<Vec<JointSample>>,
}

impl Experience {
    /// `K`, 0 with independent noise.
    fn signal_size(&self) -> usize {
        self.behaviour.loading.len() / self.behaviour.action_size()
    }

    /// Inputs of a posterior for every row.
    pub(super) fn conditions(&self) -> Conditions<'_> {
        let features = &self.features;
        let others = self.others.as_slice();
        Conditions { features, others, action: &self.sequences.action, policy: &self.behaviour }
    }
}

/// The posterior of an agent's rollout data and its metrics; empty without a posterior.
#[derive(Clone, Default)]
pub(crate) struct Influence {
    pub(crate) conditional: Option<HeadRows>,
    /// Precision that the other agents' actions add to the signal's, `[K, K]`; only if influence is exact.
    pub(crate) others_precision: Option<Vec<f64>>,
    /// Mean log-likelihood on the training rows, nats.
    pub(super) log_likelihood: f64,
    /// Mean of `log q - log p` on held-out rows, Eq. (7) by counting over all rows, or the exact information, nats.
    pub(super) mi_estimate: Option<f64>,
    /// Mean negative log-likelihoods of the posterior and of the policy on held-out rows, nats.
    pub(super) held_out: Option<(f64, f64)>,
    /// Mean uncapped `KL[q || p]` of all rows under the behaviour policy, nats.
    pub(super) divergence: f64,
    /// Number of skipped optimiser steps of the posterior.
    pub(super) skipped: i64,
}

impl Influence {
    /// Exact information between an agent's actions and the others', by all agents' behaviour policies.
    pub(super) fn exact(agent: usize, experience: &[Experience]) -> Self {
        let size = experience[agent].signal_size();
        let loadings = experience.iter().map(|own| own.behaviour.loading.as_slice());
        let others = others_precision(agent, &loadings.collect::<Vec<_>>(), size);
        let (information, _) =
            exact_information(&experience[agent].behaviour.loading, &others, size);
        Self { others_precision: Some(others), mi_estimate: Some(information), ..Self::default() }
    }

    pub(crate) fn report(&self, agent: usize) -> Report {
        let mut named = Vec::new();
        if self.conditional.is_some() {
            named.push(("posterior_log_likelihood", self.log_likelihood));
            named.push(("posterior_kl", self.divergence));
            named.push(("posterior_skipped_steps", self.skipped as f64));
        }
        named.extend(self.mi_estimate.map(|found| ("mi_estimate", found)));
        if let Some((posterior, policy)) = self.held_out {
            named.extend([("posterior_nll", posterior), ("policy_nll", policy)]);
        }
        named.into_iter().map(|(name, value)| (format!("agent{agent}/{name}"), value)).collect()
    }
}

/// Mean of `[R]` numbers, `R >= 1`, summed in order.
pub(super) fn mean(numbers: &[f64]) -> f64 {
    numbers.iter().sum::<f64>() / numbers.len() as f64
}
