//! How far behind the weights are that roll out what is learnt from.

use serde::{Deserialize, Serialize};

use super::{refuse, within};
use crate::error::MarlError;

/// Which weights roll out `D_k`, and what is made of their age.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BehaviourConfig {
    /// Updates by which they are behind those that the update begins with: 0 or 1. The first iteration is
    /// rolled out with the first weights either way.
    pub policy_lag: u64,
    /// Highest factor `M` with a lag of 1.
    pub factor_max: f64,
}

impl BehaviourConfig {
    pub(super) fn validate(&self) -> Result<(), MarlError> {
        if self.policy_lag > 1 {
            return Err(refuse("policy_lag", self.policy_lag, "0 or 1"));
        }
        let range = "a finite number of at least 1";
        within("overlap.factor_max", self.factor_max, 1.0..f64::INFINITY, range)
    }

    /// Highest factor `M`; there is none without a lag.
    #[must_use]
    pub fn factor_limit(&self) -> f64 {
        match self.policy_lag {
            0 => f64::INFINITY,
            _ => self.factor_max,
        }
    }
}
