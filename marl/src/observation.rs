//! How agents' observations are scaled on the learner's side, where statistics of a run are known.

use std::borrow::Cow;

use policy::{NamedArrays, PolicySnapshot};
use rayon::prelude::*;

use crate::batch::{Batch, Problem};
use crate::error::MarlError;
use crate::running::RunningMoments;

/// How the learner scales observations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ObservationScale {
    /// Not at all: they stay as the environment shows them.
    AsShown,
    /// By their running mean and deviation, feature by feature and agent by agent.
    Running,
}

/// What observations are scaled by. Policies of version `k` carry the statistics of all iterations before `k`, and what
/// they roll out is learnt with the same ones.
#[derive(Clone, Debug)]
pub struct ObservationMoments {
    /// `[N]`, or none where observations stay as they are.
    agents: Vec<RunningMoments>,
    /// `[N]`, those of the policies that act, where these are not the newest.
    behaviour: Option<Vec<RunningMoments>>,
}

impl ObservationMoments {
    /// Of nothing yet, for policies that act `policy_lag` (0 or 1) updates late.
    #[must_use]
    pub fn new(scale: ObservationScale, problem: &Problem, policy_lag: u64) -> Self {
        let moments = || problem.agents.iter().map(|agent| RunningMoments::new(agent.observation));
        let agents: Vec<RunningMoments> = match scale {
            ObservationScale::AsShown => Vec::new(),
            ObservationScale::Running => moments().collect(),
        };
        let behaviour = (policy_lag > 0).then(|| agents.clone());
        Self { agents, behaviour }
    }

    /// `D_k` as the policies saw it that rolled it out.
    #[must_use]
    pub fn seen<'a>(&self, batch: &'a Batch) -> Cow<'a, Batch> {
        let mut seen = Cow::Borrowed(batch);
        let acted = self.behaviour.as_ref().unwrap_or(&self.agents);
        for (index, moments) in acted.iter().enumerate() {
            let (standardisation, seen) = (moments.standardisation(), seen.to_mut());
            standardisation.apply(&mut seen.agents[index].observation);
            seen.finals
                .iter_mut()
                .for_each(|last| standardisation.apply(&mut last.observation[index]));
        }
        seen
    }

    /// Takes in `D_k` as the environment showed it, for the iterations after it.
    pub fn take_in(&mut self, batch: &Batch) {
        if let Some(behaviour) = &mut self.behaviour {
            behaviour.clone_from(&self.agents);
        }
        let agents = self.agents.par_iter_mut().zip(&batch.agents);
        agents.for_each(|(moments, agent)| moments.take_in(&agent.observation));
    }

    /// Policies that scale what they are shown by what is known now.
    #[must_use]
    pub fn snapshot(&self, mut policies: PolicySnapshot) -> PolicySnapshot {
        if !self.agents.is_empty() {
            let agents = policies.agents.into_iter().zip(&self.agents);
            let scaled = agents.map(|(policy, own)| policy.standardised(own.standardisation()));
            policies.agents = scaled.collect();
        }
        policies
    }

    /// `observation/agent_I.NAME`, and `observation/behaviour_I.NAME` where older policies act.
    #[must_use]
    pub fn arrays(&self) -> NamedArrays {
        let newest = self.agents.iter().enumerate();
        let acting = self.behaviour.iter().flatten().enumerate();
        let newest = newest.flat_map(|(index, moments)| moments.arrays(&newest_prefix(index)));
        newest
            .chain(acting.flat_map(|(index, moments)| moments.arrays(&acting_prefix(index))))
            .collect()
    }

    /// Takes over kept statistics.
    ///
    /// # Errors
    /// Names the array that is missing, unknown, or of another shape.
    pub fn restore(&mut self, arrays: &NamedArrays) -> Result<(), MarlError> {
        let known = self.arrays();
        let mut stored = arrays.keys().filter(|name| name.starts_with("observation/"));
        if let Some(name) = stored.find(|name| !known.contains_key(*name)) {
            return Err(MarlError::Restore(format!("{name} belongs to no agent of this run")));
        }
        let mut newest = self.agents.iter_mut().enumerate();
        newest.try_for_each(|(index, own)| own.restore(&newest_prefix(index), arrays))?;
        let mut acting = self.behaviour.iter_mut().flatten().enumerate();
        acting.try_for_each(|(index, own)| own.restore(&acting_prefix(index), arrays))
    }
}

fn newest_prefix(agent: usize) -> String {
    format!("observation/agent_{agent}.")
}

fn acting_prefix(agent: usize) -> String {
    format!("observation/behaviour_{agent}.")
}

#[cfg(test)]
mod tests {
    use policy::{RunSeed, Scratch};

    use super::*;
    use crate::probe;

    fn known() -> ObservationMoments {
        let mut known = ObservationMoments::new(ObservationScale::Running, &probe::problem(), 0);
        known.take_in(&probe::batch());
        known
    }

    #[test]
    fn a_snapshot_makes_of_what_it_is_shown_what_the_learner_makes_of_what_was_seen() {
        let (config, policy, batch) = (probe::config(), probe::policy(), probe::batch());
        let algorithm =
            crate::build(&config, &policy, &probe::problem(), RunSeed(0)).unwrap().snapshot();
        let (plain, known) = (algorithm.unwrap(), known());
        let (scaled, seen) = (known.snapshot(plain.clone()), known.seen(&batch));
        let scaled = PolicySnapshot::from_bytes(&scaled.to_bytes().unwrap()).unwrap();
        let log_prob = |policies: &PolicySnapshot, batch: &Batch, index: usize| {
            let (policy, own) = (&policies.agents[index], &batch.agents[index]);
            let mut hidden = vec![0.0; policy.hidden_size() * batch.rows()];
            let mut output = vec![0.0; policy.output_size() * batch.rows()];
            let (rows, scratch) = (batch.rows(), &mut Scratch::default());
            policy.forward(rows, &own.observation, &mut hidden, &mut output, scratch);
            let actions = own.action.chunks_exact(policy.action_size());
            let outputs = output.chunks_exact(policy.output_size());
            outputs.zip(actions).map(|(o, a)| policy.log_prob(o, a)).collect::<Vec<f32>>()
        };
        for index in 0..plain.agents.len() {
            let acted = log_prob(&scaled, &batch, index);
            assert_eq!(acted, log_prob(&plain, &seen, index));
            assert_ne!(acted, log_prob(&plain, &batch, index));
        }
    }

    #[test]
    fn observations_that_are_as_shown_are_not_even_copied() {
        let (batch, problem) = (probe::batch(), probe::problem());
        let mut plain = ObservationMoments::new(ObservationScale::AsShown, &problem, 0);
        plain.take_in(&batch);
        assert!(matches!(plain.seen(&batch), Cow::Borrowed(_)));
        assert!(plain.arrays().is_empty());
    }

    #[test]
    fn final_observations_are_scaled_like_all_others() {
        let (mut batch, known) = (probe::batch(), known());
        let first = batch.agents[1].observation[..batch.finals[0].observation[1].len()].to_vec();
        batch.finals[0].observation[1].clone_from(&first);
        let seen = known.seen(&batch);
        let last = &seen.finals[0].observation[1];
        assert_eq!(last, &seen.agents[1].observation[..first.len()]);
        assert_ne!(last, &first);
    }

    #[test]
    fn kept_statistics_are_taken_over_and_refused_where_there_are_none() {
        let (known, problem) = (known(), probe::problem());
        let mut other = ObservationMoments::new(ObservationScale::Running, &problem, 0);
        other.restore(&known.arrays()).unwrap();
        assert_eq!(other.arrays(), known.arrays());
        let mut plain = ObservationMoments::new(ObservationScale::AsShown, &problem, 0);
        let error = plain.restore(&known.arrays()).unwrap_err().to_string();
        assert!(error.contains("observation/agent_0"), "{error}");
    }

    #[test]
    fn what_older_policies_rolled_out_is_seen_with_their_statistics() {
        let (first, problem) = (probe::batch(), probe::problem());
        let mut second = first.clone();
        second.agents[0].observation.iter_mut().for_each(|x| *x = 1.5 * *x + 1.0);
        let mut newest = ObservationMoments::new(ObservationScale::Running, &problem, 0);
        let mut late = ObservationMoments::new(ObservationScale::Running, &problem, 1);
        // Iterations 0 and 1 are rolled out by the first policies, which know nothing yet.
        assert!(*late.seen(&first) == first);
        late.take_in(&first);
        assert!(*late.seen(&second) == second);
        late.take_in(&second);
        newest.take_in(&first);
        assert!(late.seen(&second) == newest.seen(&second));
        assert!(*late.seen(&second) != second);
        let mut restored = ObservationMoments::new(ObservationScale::Running, &problem, 1);
        restored.restore(&late.arrays()).unwrap();
        assert!(restored.seen(&second) == late.seen(&second));
        assert_eq!(restored.arrays(), late.arrays());
    }
}
