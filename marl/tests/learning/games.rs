//! Games with several equilibria, of which one is best.

use marl::ActionKind;
use policy::{PolicySnapshot, standard_normal};
use rand::RngCore;

use crate::harness::{TwoAgentGame, evaluate, mean_return, train};
use crate::settings::{happo_with_one_network, happo_with_recurrent_critics, maddpg, on_policy};

const CHOICES: usize = 3;

/// Reward of a joint choice. Agreeing on 0 is best. Agreeing on 1 or 2 is also an equilibrium: an agent that deviates
/// alone gets a lower reward. With a uniform partner, 0 has the mean reward `-1/3` and the others `-2/3`; two uniform
/// agents have `(1 + 0 + 0 - 6) / 9 = -5/9`.
const PAYOFF: [[f32; CHOICES]; CHOICES] = [[1.0, -1.0, -1.0], [-1.0, 0.0, -1.0], [-1.0, -1.0, 0.0]];

/// Four rounds of the game. Both agents observe both choices of the previous round.
struct Matrix {
    chosen: Option<[usize; 2]>,
}

impl TwoAgentGame for Matrix {
    const STEPS: usize = 4;
    const STATE: usize = 2 * CHOICES;
    const ACTION: ActionKind = ActionKind::Discrete { choices: CHOICES };

    fn begin(_: &mut impl RngCore) -> Self {
        Self { chosen: None }
    }

    fn state(&self) -> Vec<f32> {
        let mut seen = vec![0.0; Self::STATE];
        for (agent, choice) in self.chosen.into_iter().flatten().enumerate() {
            seen[agent * CHOICES + choice] = 1.0;
        }
        seen
    }

    fn step(&mut self, actions: [f32; 2]) -> f32 {
        let [first, second] = actions.map(|action| action as usize);
        self.chosen = Some([first, second]);
        PAYOFF[first][second]
    }
}

/// Probability of the best joint choice, averaged over the rounds played.
fn best_choice(snapshot: &PolicySnapshot) -> f32 {
    let mut best = [Vec::new(), Vec::new()];
    evaluate::<Matrix>(snapshot, |turn| {
        best[turn.agent].push(turn.probability(0.0));
        turn.sampled_action(u64::MAX)
    });
    let joint = best[0].iter().zip(&best[1]).map(|(first, second)| first * second);
    joint.sum::<f32>() / best[0].len() as f32
}

#[test]
fn every_on_policy_rule_finds_the_best_of_three_equilibria_with_and_without_memory() {
    for settings in on_policy() {
        let [before, after] = train::<Matrix>(&settings, 60).map(|policies| best_choice(&policies));
        assert!(before < 0.2, "{}: {before} before training", settings.name);
        assert!(after > 0.9, "{}: {after}", settings.name);
    }
}

/// The same for continuous actions: `1 - 4 (a - b)^2 - (a + b - 1)^2`. The best reward is 1, at `a = b = 1/2`; two
/// zeros have 0. An agent that deviates alone to 1/2 gets `1 - 1 - 1/4 = -1/4`.
struct Meeting {
    chosen: [f32; 2],
}

impl TwoAgentGame for Meeting {
    const STEPS: usize = 4;
    const STATE: usize = 2;
    const ACTION: ActionKind = ActionKind::Continuous;

    fn begin(_: &mut impl RngCore) -> Self {
        Self { chosen: [0.0; 2] }
    }

    fn state(&self) -> Vec<f32> {
        self.chosen.to_vec()
    }

    fn step(&mut self, actions: [f32; 2]) -> f32 {
        let [a, b] = actions;
        self.chosen = actions;
        1.0 - 4.0 * (a - b) * (a - b) - (a + b - 1.0) * (a + b - 1.0)
    }
}

/// Mean reward of the mean actions.
fn mean_reward<W: TwoAgentGame>(snapshot: &PolicySnapshot) -> f32 {
    mean_return(&evaluate::<W>(snapshot, |turn| turn.mode_action()).0) / W::STEPS as f32
}

#[test]
fn maddpg_finds_the_best_of_several_continuous_equilibria() {
    let [before, after] =
        train::<Meeting>(&maddpg(), 60).map(|policies| mean_reward::<Meeting>(&policies));
    assert!(before < 0.2, "{before} before training");
    assert!(after > 0.9, "{after}");
}

/// `1 - (a + b - x)^2`, a sum that no agent controls alone. The next state `[x, y]` does not depend on the actions.
struct Sum {
    states: Vec<Vec<f32>>,
    step: usize,
}

impl TwoAgentGame for Sum {
    const STEPS: usize = 4;
    const STATE: usize = 2;
    const ACTION: ActionKind = ActionKind::Continuous;

    fn begin(rng: &mut impl RngCore) -> Self {
        let mut state = |_| (0..Self::STATE).map(|_| 0.5 * standard_normal(rng)).collect();
        Self { states: (0..=Self::STEPS).map(&mut state).collect(), step: 0 }
    }

    fn state(&self) -> Vec<f32> {
        self.states[self.step].clone()
    }

    fn step(&mut self, [a, b]: [f32; 2]) -> f32 {
        let error = a + b - self.states[self.step][0];
        self.step += 1;
        1.0 - error * error
    }
}

#[test]
fn agents_that_update_one_network_in_turn_learn_a_sum_that_none_controls_alone() {
    // Later agents also undo part of the earlier agents' updates.
    let [before, after] =
        train::<Sum>(&happo_with_one_network(), 100).map(|policies| mean_reward::<Sum>(&policies));
    // Means of zero leave an error of x, whose variance is .25.
    assert!(before < 0.8 && after > 0.9, "{before} {after}");
}

#[test]
fn agents_with_recurrent_critics_learn_a_sum_that_none_controls_alone() {
    for settings in happo_with_recurrent_critics() {
        let [before, after] =
            train::<Sum>(&settings, 100).map(|policies| mean_reward::<Sum>(&policies));
        assert!(before < 0.8 && after > 0.9, "{}: {before} {after}", settings.name);
    }
}
