//! The rewards that the critic values, and each agent's advantage.

use crate::config::TrainingConfig;
use crate::data::batch::Rewards;

/// The returns that are valued.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CriticMode {
    /// One network with one value per agent, each normalised separately. HAPPO's theorem needs one common reward, and
    /// does not hold for rewards that differ.
    PerAgent,
    /// One value of the team's reward: without surprise, all agents' rewards are equal.
    Team,
}

impl CriticMode {
    /// The returns that differ with these settings.
    pub(crate) fn of(config: &TrainingConfig) -> Self {
        if config.surprise.alpha == 0.0 { Self::Team } else { Self::PerAgent }
    }

    /// Number of values, `V`, for `agents` agents.
    pub(crate) fn values(self, agents: usize) -> usize {
        match self {
            Self::PerAgent => agents,
            Self::Team => 1,
        }
    }

    /// The valued rewards, `[V][T, B]`: the team's `[T, B]`, or the agents' `[N][T, B]`, which include surprise.
    pub(crate) fn rewards(self, team: &[f32], agents: &Rewards) -> Rewards {
        match self {
            Self::PerAgent => agents.clone(),
            Self::Team => vec![team.to_vec()],
        }
    }

    /// Advantage, value or return of agent `agent` in `[V][T, B]`.
    pub(crate) fn of_agent(self, valued: &[Vec<f64>], agent: usize) -> Vec<f64> {
        match self {
            Self::PerAgent => valued[agent].clone(),
            Self::Team => valued[0].clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::batch::{Batch, Final};
    use crate::objective::advantage::{Horizon, advantage, next_values};

    const HALF: Horizon = Horizon { gamma: 0.5, lambda: 0.5 };

    /// Two steps of one environment without an episode's end; the team rewards are 1 and 2.
    fn batch() -> Batch {
        Batch {
            steps: 2,
            environments: 1,
            reward: vec![1.0, 2.0],
            terminated: vec![false; 2],
            truncated: vec![false; 2],
            finals: vec![Final { step: 1, environment: 0, ..Final::default() }],
            ..Batch::default()
        }
    }

    /// Both agents' advantages if all states have the values `values`, `[V]`.
    fn advantages(mode: CriticMode, rewards: &Rewards, values: &[f64]) -> [Vec<f64>; 2] {
        let batch = batch();
        let valued = mode.rewards(&batch.reward, rewards);
        assert_eq!(valued.len(), mode.values(2));
        let one = |(reward, &value): (&Vec<f32>, &f64)| {
            let now = [value; 2];
            advantage(&batch, reward, &now, &next_values(&batch, &now, &[value]), HALF)
        };
        let valued: Vec<Vec<f64>> = valued.iter().zip(values).map(one).collect();
        [0, 1].map(|agent| mode.of_agent(&valued, agent))
    }

    #[test]
    fn without_surprise_both_modes_give_the_same_advantages() {
        let rewards = vec![vec![1.0, 2.0]; 2];
        // A1 = 2 + 2 - 4 = 0, A0 = 1 + 2 - 4 + A1 / 4 = -1
        for (mode, values) in [(CriticMode::PerAgent, &[4.0, 4.0][..]), (CriticMode::Team, &[4.0])]
        {
            assert_eq!(advantages(mode, &rewards, values), [[-1.0, 0.0], [-1.0, 0.0]], "{mode:?}");
        }
    }

    #[test]
    fn with_surprise_every_agent_has_the_advantages_of_its_own_reward() {
        // The surprise rewards are -1 and -3 for the first agent, 1 and 1 for the second.
        let rewards = vec![vec![0.0, -1.0], vec![2.0, 3.0]];
        // A1 = r1, A0 = r0 + A1 / 4 for values of 0.
        let found = advantages(CriticMode::PerAgent, &rewards, &[0.0, 0.0]);
        assert_eq!(found, [[-0.25, -1.0], [2.75, 3.0]]);
    }
}
