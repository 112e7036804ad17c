//! Games whose best joint action is one of several on which agents could settle.

use marl::ActionKind;
use policy::{CoreKind, PolicySnapshot};
use rand::RngCore;

use crate::harness::{World, examine, train};
use crate::settings::{ON_POLICY, maddpg, on_policy};

const CHOICES: usize = 3;

/// What a joint choice pays. Agreeing on 0 is best; agreeing on 1 or 2 is an equilibrium too, which no
/// agent can leave alone without paying for it. Beside an even-handed partner 0 pays `-1/3` and the
/// others `-2/3`; two of them make `(1 + 0 + 0 - 6) / 9 = -5/9`.
const PAYOFF: [[f32; CHOICES]; CHOICES] = [[1.0, -1.0, -1.0], [-1.0, 0.0, -1.0], [-1.0, -1.0, 0.0]];

/// Four rounds of the game; both see what both chose in the last one.
struct Matrix {
    chosen: Option<[usize; 2]>,
}

impl World for Matrix {
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

/// The probability of the best joint choice, averaged over the rounds that are met.
fn best_choice(snapshot: &PolicySnapshot) -> f32 {
    let mut best = [Vec::new(), Vec::new()];
    examine::<Matrix>(snapshot, |turn| {
        best[turn.agent].push(turn.probability(0.0));
        turn.drawn(u64::MAX)
    });
    let joint = best[0].iter().zip(&best[1]).map(|(first, second)| first * second);
    joint.sum::<f32>() / best[0].len() as f32
}

fn solves_the_matrix_game(core: CoreKind) {
    for variant in &ON_POLICY {
        let [before, after] =
            train::<Matrix>(&on_policy(variant, core), 60).map(|policies| best_choice(&policies));
        assert!(before < 0.2, "{}: {before} before any training", variant.name);
        assert!(after > 0.9, "{}: {after}", variant.name);
    }
}

#[test]
fn every_rule_of_the_policy_gradient_finds_the_best_of_three_agreements_with_memory() {
    solves_the_matrix_game(CoreKind::Gru);
}

#[test]
fn every_rule_of_the_policy_gradient_finds_the_best_of_three_agreements_without_memory() {
    solves_the_matrix_game(CoreKind::Mlp);
}

/// The game's counterpart for real actions: `1 - 4 (a - b)^2 - (a + b - 1)^2`. Its best is 1, at
/// `a = b = 1/2`; two zeros pay 0, and an agent that goes to 1/2 alone pays for it:
/// `1 - 1 - 1/4 = -1/4`.
struct Meeting {
    chosen: [f32; 2],
}

impl World for Meeting {
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

#[test]
fn maddpg_meets_where_going_alone_costs() {
    let mean = |snapshot: &PolicySnapshot| {
        examine::<Meeting>(snapshot, |turn| turn.settled()).mean_return() / Meeting::STEPS as f32
    };
    let [before, after] = train::<Meeting>(&maddpg(), 60).map(|policies| mean(&policies));
    assert!(before < 0.2, "{before} before any training");
    assert!(after > 0.9, "{after}");
}
