//! `signal-2x1`: a sender feels a target that the receiver needs, and can show it only by the position of its leg.
//!
//! Each step has a target, drawn uniformly from `[-1, 1]`. The sender observes it and moves its leg to any position in
//! `[-1, 1]`. In the next step the receiver observes that position, and the reward is `1 - (a - y)^2` for the receiver's
//! action `a` and the target `y` of the step before. In the first step both are 0.
//!
//! Optimum: a sender that moves to the target and a receiver that repeats the position have a return of 50. Without
//! information from the sender the best action is 0, and the expected return `1 + 49 (1 - 1/3) = 33.7`.

use proto::{ActionSpec, FeatureSpec};
use rand_chacha::ChaCha8Rng;

use super::{EPISODE_STEPS, Game, at, feature};
use crate::noise;

/// Index of the agent that observes the target; the other one is the receiver.
const SENDER: usize = 0;
const RECEIVER: usize = 1;

/// State of a game.
#[derive(Clone)]
pub(crate) struct Signal {
    /// Position of the sender's leg.
    leg: f32,
    /// Target of the step before.
    needed: f32,
    /// Target of each step, and one after the last, `[EPISODE_STEPS + 1]`.
    targets: Vec<f32>,
}

impl Game for Signal {
    const NAME: &'static str = "signal-2x1";
    const STATE_KIND: &'static str = "game/signal";
    const IS_WHOLE: bool = false;
    const AGENTS: usize = 2;
    const ACTION: ActionSpec = ActionSpec::continuous(1);

    fn observed(agent: usize) -> Vec<FeatureSpec> {
        match agent {
            SENDER => vec![feature("target"), feature("leg")],
            _ => vec![feature("leg")],
        }
    }

    fn seen(agent: usize) -> Vec<usize> {
        match agent {
            SENDER => vec![0, 2],
            _ => vec![2],
        }
    }

    fn global() -> Vec<FeatureSpec> {
        vec![feature("target"), feature("needed"), feature("leg")]
    }

    fn start(rng: &mut ChaCha8Rng) -> Self {
        let targets = (0..=EPISODE_STEPS).map(|_| noise::symmetric(rng, 1.0)).collect();
        Self { leg: 0.0, needed: 0.0, targets }
    }

    fn bounds() -> Vec<[f32; 2]> {
        vec![[-1.0, 1.0]; EPISODE_STEPS as usize + 3]
    }

    fn from_numbers(numbers: &[f32]) -> Self {
        Self { leg: numbers[0], needed: numbers[1], targets: numbers[2..].to_vec() }
    }

    fn numbers(&self) -> Vec<f32> {
        [&[self.leg, self.needed], self.targets.as_slice()].concat()
    }

    fn step(&mut self, step: u32, actions: &[f32]) -> f32 {
        let error = actions[RECEIVER].clamp(-1.0, 1.0) - self.needed;
        self.leg = actions[SENDER].clamp(-1.0, 1.0);
        self.needed = at(&self.targets, step);
        1.0 - error * error
    }

    fn observe(&self, step: u32, agent: usize, out: &mut [f32]) {
        if agent == SENDER {
            out[0] = at(&self.targets, step);
        }
        *out.last_mut().expect("each agent observes the leg") = self.leg;
    }

    fn state(&self, step: u32, out: &mut [f32]) {
        out.copy_from_slice(&[at(&self.targets, step), self.needed, self.leg]);
    }
}
