//! `cue-2x1`: two agents observe one of three cues and are rewarded if both choose it. Its information is known in
//! closed form: the actions of agents that follow the cue share `log 3` nats given the place, and none given place and
//! cue.
//!
//! The place is one of four on a ring and advances by one if both agents match the cue. The global state is the place.
//! Each agent observes the place, the cue and its own index, all one-hot. An episode's cues, one for each step and one
//! after the last, are drawn at its start and are part of its state. The cue of a step is therefore a function of the
//! reset key and the step.

use proto::{ActionSpec, FeatureRole, FeatureSpec};
use rand_chacha::ChaCha8Rng;

use super::{EPISODE_STEPS, Game, at, features};
use crate::noise;

const CUES: usize = 3;
const PLACES: usize = 4;
/// Reward of a step in which both agents choose the cue.
const REWARD: f32 = 1.0;

/// State of a game.
#[derive(Clone)]
pub(crate) struct Cue {
    place: usize,
    /// Cue before each step and after the last, `[EPISODE_STEPS + 1]`.
    cues: Vec<usize>,
}

impl Game for Cue {
    const NAME: &'static str = "cue-2x1";
    const STATE_KIND: &'static str = "discrete/cue";
    const IS_WHOLE: bool = true;
    const AGENTS: usize = 2;
    const ACTION: ActionSpec =
        ActionSpec { size: 1, low: 0.0, high: (CUES - 1) as f32, choices: Some(CUES as u32) };

    fn observed(_agent: usize) -> Vec<FeatureSpec> {
        let cue = features("cue", CUES, FeatureRole::Signal);
        [Self::global(), cue, features("id", Self::AGENTS, FeatureRole::Identity)].concat()
    }

    /// The global state does not contain the cue.
    fn seen(_agent: usize) -> Vec<usize> {
        Vec::new()
    }

    fn global() -> Vec<FeatureSpec> {
        features("place", PLACES, FeatureRole::Signal)
    }

    fn start(rng: &mut ChaCha8Rng) -> Self {
        let place = noise::choice(rng, PLACES);
        Self { place, cues: (0..=EPISODE_STEPS).map(|_| noise::choice(rng, CUES)).collect() }
    }

    fn bounds() -> Vec<[f32; 2]> {
        let mut bounds = vec![[0.0, (CUES - 1) as f32]; EPISODE_STEPS as usize + 2];
        bounds[0] = [0.0, (PLACES - 1) as f32];
        bounds
    }

    fn from_numbers(numbers: &[f32]) -> Self {
        let numbers = numbers.iter().map(|&number| number as usize).collect::<Vec<_>>();
        Self { place: numbers[0], cues: numbers[1..].to_vec() }
    }

    fn numbers(&self) -> Vec<f32> {
        let numbers = std::iter::once(&self.place).chain(&self.cues);
        numbers.map(|&number| number as f32).collect()
    }

    fn step(&mut self, step: u32, actions: &[f32]) -> f32 {
        let cue = at(&self.cues, step) as f32;
        if actions.iter().any(|&action| action != cue) {
            return 0.0;
        }
        self.place = (self.place + 1) % PLACES;
        REWARD
    }

    fn observe(&self, step: u32, agent: usize, out: &mut [f32]) {
        out[self.place] = 1.0;
        out[PLACES + at(&self.cues, step)] = 1.0;
        out[PLACES + CUES + agent] = 1.0;
    }

    fn state(&self, _step: u32, out: &mut [f32]) {
        out[self.place] = 1.0;
    }
}
