//! The networks that rolled out what is learnt from: today's before they move, or with a policy lag of 1 copies of
//! those before the last update.

use std::sync::Arc;

use policy::{ActorNetwork, NamedArrays};

use super::agent::{Agent, Experience};
use super::ascent::moved;
use crate::error::MarlError;

impl Agent {
    /// Whether today's network is the one that acts.
    fn acts_today(&self) -> bool {
        Arc::ptr_eq(&self.behaviour, &self.network)
    }

    /// To be called in every update before a policy moves: what today's weights roll out is learnt from next.
    pub(super) fn remember_today(&self) -> Result<(), MarlError> {
        match self.acts_today() {
            true => Ok(()),
            false => Ok(copy(&self.network, &self.behaviour)?),
        }
    }

    /// Log-densities of all actions under today's weights `[L, C]`, nats; nothing where these are the weights that
    /// acted.
    pub(crate) fn log_prob_since(
        &self,
        experience: &Experience,
    ) -> Result<Option<Vec<f64>>, MarlError> {
        match self.acts_today() {
            true => Ok(None),
            false => Ok(Some(moved(self, experience)?.log_prob)),
        }
    }

    /// The network that acted, under the name of whom it belongs to; nothing where it is today's.
    pub(super) fn behaviour_arrays(&self, owner: &str) -> Result<NamedArrays, MarlError> {
        match self.acts_today() {
            true => Ok(NamedArrays::new()),
            false => Ok(self.behaviour.parameters().to_arrays(&prefix(owner))?),
        }
    }

    pub(super) fn restore_behaviour(
        &self,
        owner: &str,
        arrays: &NamedArrays,
    ) -> Result<(), MarlError> {
        match self.acts_today() {
            true => Ok(()),
            false => Ok(self.behaviour.parameters().load(&prefix(owner), arrays)?),
        }
    }
}

/// Sets the second network's parameters to the first one's.
fn copy(from: &ActorNetwork, to: &ActorNetwork) -> Result<(), policy::PolicyError> {
    to.parameters().load("", &from.parameters().to_arrays("")?)
}

fn prefix(owner: &str) -> String {
    format!("behaviour/{owner}.")
}
