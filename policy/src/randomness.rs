//! Every random draw of a run. A draw has a key that states its purpose. It does not depend on time, thread, process or
//! order of arrival.

use rand::{RngCore, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Seed of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RunSeed(pub u64);

/// Purpose of a draw. The numbers are part of a run's identity and never change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Purpose {
    /// Initial state of a training episode.
    Reset = 1,
    /// Noise of a training action.
    Action = 2,
    /// Initial state of an evaluation episode.
    EvaluationReset = 3,
    /// Initial weights of an actor.
    Initialisation = 4,
    /// Order of the agents in an update.
    AgentOrder = 5,
    /// Order of an actor's minibatches.
    Minibatch = 6,
    /// Initial weights of a posterior.
    PosteriorInitialisation = 7,
    /// Order of a posterior's minibatches.
    PosteriorMinibatch = 8,
    /// Initial weights of the critic.
    CriticInitialisation = 9,
    /// Order of the critic's minibatches.
    CriticMinibatch = 10,
    /// The fixed computations of the numeric fingerprint.
    Probe = 12,
    /// Transitions sampled from a replay buffer.
    Replay = 13,
    /// Initial weights of a density.
    DensityInitialisation = 20,
    /// Order of a density's minibatches.
    DensityMinibatch = 21,
    /// Latent noise of a density, when it is fitted and evaluated.
    DensityNoise = 22,
    /// Noise of a served action.
    ServedAction = 23,
    /// Bootstrap resampling of runs, for confidence intervals.
    Bootstrap = 30,
    /// Noise of the actions that an off-policy update draws.
    UpdateAction = 31,
    /// The part of the noise of training actions that all agents share.
    Signal = 40,
    /// The part of the noise of served actions that all agents share.
    ServedSignal = 41,
    /// The part of the noise of the actions that an off-policy update draws that all agents share.
    UpdateSignal = 42,
}

/// The key of a draw. Fields that do not apply stay 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Draw {
    /// Purpose of the draw.
    pub purpose: Purpose,
    /// Iteration; for resets and served actions the episode's index, for evaluation resets the evaluated iteration.
    pub iteration: u64,
    /// Environment index in the whole run.
    pub environment: u32,
    /// Step in the slot or episode, or epoch.
    pub step: u32,
    /// Agent.
    pub agent: u32,
}

impl Draw {
    /// A draw for `purpose`, all other fields 0.
    #[must_use]
    pub fn of(purpose: Purpose) -> Self {
        Self { purpose, iteration: 0, environment: 0, step: 0, agent: 0 }
    }

    /// The noise of an agent's action in a step of a slot; `environment` is counted over the whole run.
    #[must_use]
    pub fn of_action(iteration: u64, environment: u32, step: u32, agent: u32) -> Self {
        Self { purpose: Purpose::Action, iteration, environment, step, agent }
    }

    /// The noise of an agent's action in a step of an episode of a trained team, in the given environment.
    #[must_use]
    pub fn of_served_action((episode, environment): (u64, u32), step: u32, agent: u32) -> Self {
        Self { purpose: Purpose::ServedAction, iteration: episode, environment, step, agent }
    }

    /// With this iteration (or episode index).
    #[must_use]
    pub fn iteration(self, iteration: u64) -> Self {
        Self { iteration, ..self }
    }

    /// With this environment.
    #[must_use]
    pub fn environment(self, environment: u32) -> Self {
        Self { environment, ..self }
    }

    /// With this step (or epoch).
    #[must_use]
    pub fn step(self, step: u32) -> Self {
        Self { step, ..self }
    }

    /// With this agent.
    #[must_use]
    pub fn agent(self, agent: u32) -> Self {
        Self { agent, ..self }
    }
}

/// The ChaCha key of one draw. Its 32 bytes are, little-endian: run seed (8), purpose (4), agent (4),
/// iteration (8), environment (4), step (4).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DrawKey(pub [u8; 32]);

impl DrawKey {
    /// The key of `draw` in the run with `seed`.
    #[must_use]
    pub fn of(seed: RunSeed, draw: Draw) -> Self {
        let mut key = [0_u8; 32];
        key[0..8].copy_from_slice(&seed.0.to_le_bytes());
        key[8..12].copy_from_slice(&(draw.purpose as u32).to_le_bytes());
        key[12..16].copy_from_slice(&draw.agent.to_le_bytes());
        key[16..24].copy_from_slice(&draw.iteration.to_le_bytes());
        key[24..28].copy_from_slice(&draw.environment.to_le_bytes());
        key[28..32].copy_from_slice(&draw.step.to_le_bytes());
        Self(key)
    }

    /// The key of the initial state of evaluation episode `episode` after `iteration`.
    #[must_use]
    pub fn of_evaluation(seed: RunSeed, iteration: u64, episode: u32) -> Self {
        let draw = Draw::of(Purpose::EvaluationReset).iteration(iteration).environment(episode);
        Self::of(seed, draw)
    }

    /// A new generator with this key.
    #[must_use]
    pub fn generator(self) -> ChaCha8Rng {
        ChaCha8Rng::from_seed(self.0)
    }
}

/// The generator of one draw, with the key [`DrawKey::of`].
#[must_use]
pub fn generator(seed: RunSeed, draw: Draw) -> ChaCha8Rng {
    DrawKey::of(seed, draw).generator()
}

/// One standard normal number (Box-Muller): `sqrt(-2 ln u) cos(2 pi v)` with two 32-bit draws,
/// `u` in (0, 1] and `v` in [0, 1). Computed in f64 with `libm`, for the same bits on every machine.
pub fn standard_normal(rng: &mut impl RngCore) -> f32 {
    const UNIT: f64 = 1.0 / 4_294_967_296.0;
    let u = (f64::from(rng.next_u32()) + 1.0) * UNIT;
    let v = f64::from(rng.next_u32()) * UNIT;
    let radius = libm::sqrt(-2.0 * libm::log(u));
    (radius * libm::cos(core::f64::consts::TAU * v)) as f32
}

/// One uniform number in [0, 1), a multiple of `2^-24`.
pub fn uniform(rng: &mut impl RngCore) -> f32 {
    const UNIT: f32 = 1.0 / 16_777_216.0;
    (rng.next_u32() >> 8) as f32 * UNIT
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn every_field_of_the_key_changes_the_stream() {
        let draw = Draw::of(Purpose::Action);
        let streams = [
            generator(RunSeed(1), draw),
            generator(RunSeed(2), draw),
            generator(RunSeed(1), Draw::of(Purpose::Reset)),
            generator(RunSeed(1), draw.iteration(1)),
            generator(RunSeed(1), draw.environment(1)),
            generator(RunSeed(1), draw.step(1)),
            generator(RunSeed(1), draw.agent(1)),
        ];
        let firsts: BTreeSet<u64> = streams.into_iter().map(|mut rng| rng.next_u64()).collect();
        assert_eq!(firsts.len(), 7);
    }

    #[test]
    fn normal_numbers_have_the_normal_distributions_moments() {
        let mut rng = generator(RunSeed(3), Draw::of(Purpose::Probe));
        let numbers: Vec<f64> =
            (0..100_000).map(|_| f64::from(standard_normal(&mut rng))).collect();
        let mean = |power: fn(f64) -> f64| numbers.iter().map(|&x| power(x)).sum::<f64>() / 1e5;
        assert!(mean(|x| x).abs() < 0.012);
        assert!((mean(|x| x * x) - 1.0).abs() < 0.02);
        assert!(mean(|x| x * x * x).abs() < 0.05);
        assert!((mean(|x| x * x * x * x) - 3.0).abs() < 0.12);
    }
}
