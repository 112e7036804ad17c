//! Scaling of observations in the learner, which has the statistics of a run.

use std::borrow::Cow;

use policy::{ActorPolicy, PolicySnapshot};
use rayon::prelude::*;

use crate::data::batch::{Batch, Problem};
use crate::data::running::RunningMoments;
use crate::error::MarlError;
use crate::state::{StoredState, Visitor};

/// How the learner scales observations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ObservationScale {
    /// No scaling.
    AsShown,
    /// By running mean and standard deviation, per feature and agent.
    Running,
}

/// Statistics that scale observations. They cover all previous iterations. Policies of version `k` use the same
/// statistics for the rollout and the update of iteration `k`.
#[derive(Clone, Debug)]
pub struct ObservationMoments {
    /// `[N]`; empty without scaling.
    agents: Vec<RunningMoments>,
}

impl ObservationMoments {
    /// Statistics of no rows.
    #[must_use]
    pub fn new(scale: ObservationScale, problem: &Problem) -> Self {
        let moments = || problem.agents.iter().map(|agent| RunningMoments::new(agent.observation));
        let agents = match scale {
            ObservationScale::AsShown => Vec::new(),
            ObservationScale::Running => moments().collect(),
        };
        Self { agents }
    }

    /// Takes the statistics with which `start`, whose agents have these sizes, scales observations, before the first rows.
    ///
    /// # Errors
    /// If only one side scales observations.
    pub fn start_from(&mut self, start: &PolicySnapshot) -> Result<(), MarlError> {
        let is_running = !self.agents.is_empty();
        let scaled = |policy: &ActorPolicy| policy.standardisation().is_some();
        if start.agents.iter().any(|policy| scaled(policy) != is_running) {
            let [theirs, own] = if is_running {
                ["no running statistics", "them"]
            } else {
                ["running statistics", "none"]
            };
            return Err(MarlError::Start(format!(
                "the policies have {theirs} of observations, the run needs {own} (observation.norm)"
            )));
        }
        let standardisations = start.agents.iter().filter_map(ActorPolicy::standardisation);
        for (moments, standardisation) in self.agents.iter_mut().zip(standardisations) {
            *moments = RunningMoments::of(standardisation);
        }
        Ok(())
    }

    /// `D_k` with scaled observations.
    #[must_use]
    pub fn seen<'a>(&self, batch: &'a Batch) -> Cow<'a, Batch> {
        let mut seen = Cow::Borrowed(batch);
        for (index, moments) in self.agents.iter().enumerate() {
            let (standardisation, seen) = (moments.standardisation(), seen.to_mut());
            standardisation.apply(&mut seen.agents[index].observation);
            seen.finals
                .iter_mut()
                .for_each(|last| standardisation.apply(&mut last.observation[index]));
        }
        seen
    }

    /// Adds the unscaled observations of `D_k`, for later iterations.
    pub fn take_in(&mut self, batch: &Batch) {
        let agents = self.agents.par_iter_mut().zip(&batch.agents);
        agents.for_each(|(moments, agent)| moments.take_in(&agent.observation));
    }

    /// Adds the scaling by the current statistics to `policies`.
    #[must_use]
    pub fn snapshot(&self, mut policies: PolicySnapshot) -> PolicySnapshot {
        if !self.agents.is_empty() {
            let agents = policies.agents.into_iter().zip(&self.agents);
            let scaled = agents.map(|(policy, own)| policy.standardised(own.standardisation()));
            policies.agents = scaled.collect();
        }
        policies
    }
}

impl StoredState for ObservationMoments {
    fn prefixes(&self) -> &'static [&'static str] {
        &["observation/"]
    }

    /// Visits `observation/agent_I.NAME`.
    fn visit(&mut self, visitor: &mut dyn Visitor) -> Result<(), MarlError> {
        let mut agents = self.agents.iter_mut().enumerate();
        agents.try_for_each(|(index, moments)| {
            moments.visit(&format!("observation/agent_{index}."), visitor)
        })
    }
}

#[cfg(test)]
mod tests {
    use policy::{RunSeed, Scratch};

    use super::*;
    use crate::sample;

    fn known() -> ObservationMoments {
        let mut known = ObservationMoments::new(ObservationScale::Running, &sample::problem());
        known.take_in(&sample::batch());
        known
    }

    #[test]
    fn actors_and_learner_scale_observations_equally() {
        let (config, policy, batch) = (sample::config(), sample::policy(), sample::batch());
        let algorithm =
            crate::build(&config, &policy, &sample::problem(), RunSeed(0)).unwrap().snapshot();
        let (plain, known) = (algorithm.unwrap(), known());
        let (scaled, seen) = (known.snapshot(plain.clone()), known.seen(&batch));
        let scaled = PolicySnapshot::from_bytes(&scaled.to_bytes().unwrap()).unwrap();
        let output = |policies: &PolicySnapshot, batch: &Batch, index: usize| {
            let policy = &policies.agents[index];
            let mut hidden = vec![0.0; policy.hidden_size() * batch.rows()];
            let mut output = vec![0.0; policy.output_size() * batch.rows()];
            let seen = &batch.agents[index].observation;
            policy.forward(batch.rows(), seen, &mut hidden, &mut output, &mut Scratch::default());
            output
        };
        for index in 0..plain.agents.len() {
            let acted = output(&scaled, &batch, index);
            assert_eq!(acted, output(&plain, &seen, index));
            assert_ne!(acted, output(&plain, &batch, index));
        }
    }

    #[test]
    fn a_run_that_starts_from_policies_scales_as_they_do_and_refuses_those_that_scale_otherwise() {
        let (config, policy, problem) = (sample::config(), sample::policy(), sample::problem());
        let plain = crate::build(&config, &policy, &problem, RunSeed(0)).unwrap().snapshot();
        let (plain, known) = (plain.unwrap(), known());
        let trained = known.snapshot(plain.clone());
        let of = |scale| ObservationMoments::new(scale, &problem);
        let mut started = of(ObservationScale::Running);
        started.start_from(&trained).unwrap();
        let bytes = |policies: PolicySnapshot| policies.to_bytes().unwrap();
        assert_eq!(bytes(started.snapshot(plain.clone())), bytes(trained.clone()));
        let running = of(ObservationScale::Running).start_from(&plain).unwrap_err().to_string();
        assert!(running.contains("have no running statistics"), "{running}");
        let other = of(ObservationScale::AsShown).start_from(&trained).unwrap_err().to_string();
        assert!(other.contains("the run needs none (observation.norm)"), "{other}");
        of(ObservationScale::AsShown).start_from(&plain).unwrap();
    }

    #[test]
    fn unscaled_observations_are_not_copied() {
        let (batch, problem) = (sample::batch(), sample::problem());
        let mut plain = ObservationMoments::new(ObservationScale::AsShown, &problem);
        plain.take_in(&batch);
        assert!(matches!(plain.seen(&batch), Cow::Borrowed(_)));
        assert!(plain.arrays().unwrap().is_empty());
    }

    #[test]
    fn final_observations_are_scaled_like_others() {
        let (mut batch, known) = (sample::batch(), known());
        let first = batch.agents[1].observation[..batch.finals[0].observation[1].len()].to_vec();
        batch.finals[0].observation[1].clone_from(&first);
        let seen = known.seen(&batch);
        let last = &seen.finals[0].observation[1];
        assert_eq!(last, &seen.agents[1].observation[..first.len()]);
        assert_ne!(last, &first);
    }

    #[test]
    fn stored_statistics_are_rejected_without_scaling() {
        let mut plain = ObservationMoments::new(ObservationScale::AsShown, &sample::problem());
        let error = plain.restore(&known().arrays().unwrap()).unwrap_err().to_string();
        assert!(error.contains("observation/agent_0"), "{error}");
    }
}
