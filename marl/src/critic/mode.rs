//! The rewards that the critic values, and each agent's advantage.

use crate::config::CriticMode;
use crate::data::batch::Rewards;

impl CriticMode {
    /// Number of values, `V`, for `agents` agents.
    #[must_use]
    pub fn values(self, agents: usize) -> usize {
        match self {
            Self::PerAgent => agents,
            Self::SharedExtrinsicPlusIntrinsic => 1 + agents,
            Self::TeamMean => 1,
        }
    }

    /// The valued rewards, `[V][T, B]`, from the team's `[T, B]` and the agents' `[N][T, B]`, which include surprise:
    /// the agents' rewards; or the team's reward and each agent's surprise reward; or the team's reward plus the mean
    /// surprise reward.
    #[must_use]
    pub fn rewards(self, team: &[f32], agents: &Rewards) -> Rewards {
        match self {
            Self::PerAgent => agents.clone(),
            Self::SharedExtrinsicPlusIntrinsic => {
                let added =
                    agents.iter().map(|own| own.iter().zip(team).map(|(a, r)| a - r).collect());
                std::iter::once(team.to_vec()).chain(added).collect()
            }
            Self::TeamMean => vec![(0..team.len()).map(|row| mean(agents, row)).collect()],
        }
    }

    /// Advantage, value or return of agent `agent`: the sum of its entries in `[V][T, B]`.
    #[must_use]
    pub fn of_agent(self, valued: &[Vec<f64>], agent: usize) -> Vec<f64> {
        match self {
            Self::PerAgent => valued[agent].clone(),
            Self::SharedExtrinsicPlusIntrinsic => valued[0]
                .iter()
                .zip(&valued[1 + agent])
                .map(|(extrinsic, own)| extrinsic + own)
                .collect(),
            Self::TeamMean => valued[0].clone(),
        }
    }
}

fn mean(agents: &Rewards, row: usize) -> f32 {
    let sum: f64 = agents.iter().map(|own| f64::from(own[row])).sum();
    (sum / agents.len() as f64) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::batch::{Batch, Final};
    use crate::objective::advantage::{Horizon, advantage, next_values};

    const MODES: [CriticMode; 3] =
        [CriticMode::PerAgent, CriticMode::SharedExtrinsicPlusIntrinsic, CriticMode::TeamMean];
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
    fn without_surprise_all_modes_give_the_same_advantages() {
        let rewards = vec![vec![1.0, 2.0]; 2];
        // A1 = 2 + 2 - 4 = 0, A0 = 1 + 2 - 4 + A1 / 4 = -1
        for (mode, values) in MODES.into_iter().zip([&[4.0, 4.0][..], &[4.0, 0.0, 0.0], &[4.0]]) {
            assert_eq!(advantages(mode, &rewards, values), [[-1.0, 0.0], [-1.0, 0.0]], "{mode:?}");
        }
    }

    #[test]
    fn with_surprise_every_mode_matches_its_worked_case() {
        // The surprise rewards are -1 and -3 for the first agent, 1 and 1 for the second.
        let rewards = vec![vec![0.0, -1.0], vec![2.0, 3.0]];
        let of = |mode, values: &[f64]| advantages(mode, &rewards, values);
        // A1 = r1, A0 = r0 + A1 / 4 for values of 0.
        let own = [vec![-0.25, -1.0], vec![2.75, 3.0]];
        assert_eq!(of(CriticMode::PerAgent, &[0.0, 0.0]), own);
        // Advantages are linear in rewards and values, so the parts add up.
        let shared = CriticMode::SharedExtrinsicPlusIntrinsic;
        assert_eq!(of(shared, &[0.0, 0.0, 0.0]), own);
        assert_eq!(of(shared, &[3.0, -1.0, 1.0]), of(CriticMode::PerAgent, &[2.0, 4.0]));
        // The mean surprise rewards are 0 and -1: both agents receive 1 and 1.
        assert_eq!(of(CriticMode::TeamMean, &[0.0]), [[1.25, 1.0], [1.25, 1.0]]);
    }
}
