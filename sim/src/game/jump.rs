//! `jump-4x1`: four agents are rewarded only in steps in which all of them jump at once.
//!
//! An agent jumps with an action above 0.75. A step in which all four jump has the reward 1, every other one 0: one agent
//! alone learns nothing from its jump. All agents observe the global state: the share of the episode that has passed, and
//! whether all jumped in the step before.
//!
//! Optimum: a return of 50. An untrained policy, whose sigma is 0.37, jumps with probability 1/50, and all four agents at
//! once with one in six millions if their noise is independent.

use proto::{ActionSpec, FeatureSpec};
use rand_chacha::ChaCha8Rng;

use super::{EPISODE_STEPS, Game, feature};

/// Lowest action that is no jump.
const THRESHOLD: f32 = 0.75;

/// State of a game.
#[derive(Clone)]
pub(crate) struct Jump {
    /// 1 if all agents jumped in the step before, else 0.
    together: f32,
}

impl Game for Jump {
    const NAME: &'static str = "jump-4x1";
    const STATE_KIND: &'static str = "game/jump";
    const IS_WHOLE: bool = true;
    const AGENTS: usize = 4;
    const ACTION: ActionSpec = ActionSpec::continuous(1);

    fn observed(_agent: usize) -> Vec<FeatureSpec> {
        Self::global()
    }

    fn seen(_agent: usize) -> Vec<usize> {
        vec![0, 1]
    }

    fn global() -> Vec<FeatureSpec> {
        vec![feature("passed"), feature("together")]
    }

    fn start(_rng: &mut ChaCha8Rng) -> Self {
        Self { together: 0.0 }
    }

    fn bounds() -> Vec<[f32; 2]> {
        vec![[0.0, 1.0]]
    }

    fn from_numbers(numbers: &[f32]) -> Self {
        Self { together: numbers[0] }
    }

    fn numbers(&self) -> Vec<f32> {
        vec![self.together]
    }

    fn step(&mut self, _step: u32, actions: &[f32]) -> f32 {
        self.together = if actions.iter().all(|&action| action > THRESHOLD) { 1.0 } else { 0.0 };
        self.together
    }

    fn observe(&self, step: u32, _agent: usize, out: &mut [f32]) {
        self.state(step, out);
    }

    fn state(&self, step: u32, out: &mut [f32]) {
        out.copy_from_slice(&[step as f32 / EPISODE_STEPS as f32, self.together]);
    }
}
