//! What a policy's head gives: the kind of distribution that actions are drawn from, in training and in acting.

use rand::RngCore;
use serde::{Deserialize, Serialize};

use crate::categorical::{self, Categorical};
use crate::gaussian::{self, Gaussian};
use crate::randomness::standard_normal;

/// The kind of an agent's action distribution.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Head {
    /// Real numbers around a mean, with a deviation per dimension that no observation changes.
    Gaussian,
    /// One number, the index of a choice.
    Categorical {
        /// `K`, number of choices.
        choices: usize,
    },
}

impl Head {
    /// Numbers that the network gives for an action of `action` numbers: means or logits.
    #[must_use]
    pub fn outputs(self, action: usize) -> usize {
        match self {
            Self::Gaussian => action,
            Self::Categorical { choices } => choices,
        }
    }

    /// Whether an action of `action` numbers can come from this head.
    #[must_use]
    pub fn fits(self, action: usize) -> bool {
        match self {
            Self::Gaussian => true,
            Self::Categorical { choices } => action == 1 && choices > 0,
        }
    }

    /// An action `[act]` drawn from the head's output `[out]`: normal noise of deviation `sigma` around the
    /// mean, or a choice.
    pub(crate) fn draw(
        self,
        output: &[f32],
        sigma: &[f32],
        rng: &mut impl RngCore,
        action: &mut [f32],
    ) {
        match self {
            Self::Gaussian => {
                for ((action, mean), sigma) in action.iter_mut().zip(output).zip(sigma) {
                    *action = mean + sigma * standard_normal(rng);
                }
            }
            Self::Categorical { .. } => action[0] = categorical::draw(output, rng) as f32,
        }
    }

    /// The action that evaluation takes: the mean, or the likeliest choice.
    pub(crate) fn settle(self, output: &[f32], action: &mut [f32]) {
        match self {
            Self::Gaussian => action.copy_from_slice(output),
            Self::Categorical { .. } => action[0] = categorical::mode(output) as f32,
        }
    }

    /// Log-density or log-probability of an action, nats. A choice's index has been validated.
    pub(crate) fn log_prob(self, output: &[f32], sigma: &[f32], action: &[f32]) -> f32 {
        match self {
            Self::Gaussian => gaussian::log_prob(output, sigma, action),
            Self::Categorical { .. } => categorical::log_prob(output, action[0] as usize),
        }
    }
}

/// A trainable distribution over `R` rows of actions.
#[derive(Clone, Debug)]
pub enum Distribution {
    /// Real numbers.
    Gaussian(Gaussian),
    /// Choices.
    Categorical(Categorical),
}
