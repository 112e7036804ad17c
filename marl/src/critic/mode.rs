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

    #[test]
    fn with_surprise_values_are_of_every_agents_own_reward_and_otherwise_of_the_teams() {
        let team = vec![1.0, 2.0];
        let own = vec![vec![0.0, -1.0], vec![2.0, 3.0]];
        let advantages = [vec![0.5], vec![1.5]];
        for (mode, valued, expected) in [
            (CriticMode::PerAgent, own.clone(), [0.5, 1.5]),
            (CriticMode::Team, vec![team.clone()], [0.5, 0.5]),
        ] {
            assert_eq!(mode.values(2), valued.len());
            assert_eq!(mode.rewards(&team, &own), valued);
            assert_eq!([0, 1].map(|agent| mode.of_agent(&advantages, agent)[0]), expected);
        }
    }
}
