//! Two agents move one point to its target in directions that are not orthogonal.

use marl::ActionKind;
use policy::PolicySnapshot;
use policy::randomness::uniform;
use rand::RngCore;

use crate::harness::{TwoAgentGame, evaluate, mean_return, train};
use crate::settings::{hasac, maddpg, on_policy};

/// Displacement of the point by a full action of each agent. The two are neither equal nor orthogonal, so the best
/// action of one agent depends on the other's. The farthest target, `(1, -1)`, takes `1 / 0.32 = 3.1` steps of the
/// second agent and `(1 + 0.75) / 0.4 = 4.4` of the first.
const PUSHES: [[f32; 2]; 2] = [[0.4, 0.0], [0.24, 0.32]];

/// A point with `offset` from its target. The reward of a step is the decrease of the distance, so an episode's return
/// is the initial distance minus the final one, at most the former.
struct Reaching {
    first: f32,
    offset: [f32; 2],
}

fn length([x, y]: [f32; 2]) -> f32 {
    (x * x + y * y).sqrt()
}

impl TwoAgentGame for Reaching {
    const STEPS: usize = 8;
    const STATE: usize = 2;
    const ACTION: ActionKind = ActionKind::Continuous;

    fn begin(rng: &mut impl RngCore) -> Self {
        let offset = [0, 1].map(|_| 2.0 * uniform(rng) - 1.0);
        Self { first: length(offset), offset }
    }

    fn state(&self) -> Vec<f32> {
        self.offset.to_vec()
    }

    fn step(&mut self, actions: [f32; 2]) -> f32 {
        let before = length(self.offset);
        for (push, action) in PUSHES.iter().zip(actions) {
            for (offset, push) in self.offset.iter_mut().zip(push) {
                *offset += push * action.clamp(-1.0, 1.0);
            }
        }
        before - length(self.offset)
    }
}

/// Final distance from the target with mean actions, and the return as a fraction of the best one; both averaged over
/// episodes.
fn skill(snapshot: &PolicySnapshot) -> (f32, f32) {
    let (batch, worlds) = evaluate::<Reaching>(snapshot, |turn| turn.mode_action());
    let mean =
        |number: fn(&Reaching) -> f32| worlds.iter().map(number).sum::<f32>() / worlds.len() as f32;
    (mean(|world| length(world.offset)), mean_return(&batch) / mean(|world| world.first))
}

#[test]
fn every_rule_solves_the_reaching_task_with_and_without_memory() {
    let on_policy = on_policy().into_iter().map(|settings| (settings, 60));
    for (settings, iterations) in on_policy.chain([(maddpg(), 40), (hasac(), 40)]) {
        let name = &settings.name;
        let [before, after] =
            train::<Reaching>(&settings, iterations).map(|policies| skill(&policies));
        // Untrained policies leave the point at its start, 0.77 from its target on average.
        assert!(before.0 > 0.5 && before.1 < 0.2, "{name}: {before:?} before training");
        assert!(after.0 < 0.1 && after.1 > 0.85, "{name}: {after:?}");
    }
}
