//! The learning rules, and the function that builds the configured one.

pub(crate) mod algorithm;
mod happo;
mod hasac;
mod maddpg;
mod mappo;
mod off_policy;
mod on_policy;
pub(crate) mod start;

use policy::{PolicyConfig, RunSeed};

use crate::config::{Rule, TrainingConfig};
use crate::data::batch::Problem;
use crate::error::MarlError;
use algorithm::Algorithm;
use happo::Happo;
use hasac::Hasac;
use maddpg::Maddpg;
use mappo::Mappo;
use on_policy::OnPolicy;

/// The configured learning rule, with weights initialised by `seed`. The caller has checked that agents with shared
/// parameters have equal shapes, that with MADDPG and HASAC no action is a choice, that with the estimator `count` all
/// are, that with the estimator `exact` agents share noise, that the replay holds at least one step of all environments,
/// and that with HASAC the policies are not recurrent and loadings of shared noise are constant.
///
/// # Errors
/// If a tensor operation fails.
pub fn build(
    config: &TrainingConfig,
    policy: &PolicyConfig,
    problem: &Problem,
    seed: RunSeed,
) -> Result<Box<dyn Algorithm>, MarlError> {
    match config.update.rule {
        Rule::Happo => Ok(Box::new(OnPolicy::new(Happo, config, policy, problem, seed)?)),
        Rule::Mappo => Ok(Box::new(OnPolicy::new(Mappo, config, policy, problem, seed)?)),
        Rule::Maddpg => Ok(Box::new(Maddpg::new(config, policy, problem, seed)?)),
        Rule::Hasac => Ok(Box::new(Hasac::new(config, policy, problem, seed)?)),
    }
}

#[cfg(test)]
mod tests;
