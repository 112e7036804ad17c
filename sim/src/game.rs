//! Games: tasks without physics, whose states are a few numbers and whose optima are known.

use proto::{ActionSpec, AgentSpec, EnvironmentSpec, EpisodePosition, FeatureRole, FeatureSpec};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use crate::config::{ObservationNorm, TaskConfig};
use crate::environment_batch::{EnvironmentBatch, Outcome, check_actions};
use crate::error::SimError;
use crate::state::{STATE_VERSION, State, StateBounds};

pub(crate) mod cue;
pub(crate) mod jump;
pub(crate) mod signal;

/// Steps of an episode of every game.
const EPISODE_STEPS: u32 = 50;
/// Duration of a step in recordings; games have no time.
const STEP_SECS: f64 = 0.1;

/// A game whose agents' actions are one number each. The value is its state before step `step`.
pub(crate) trait Game: Clone + Send {
    /// Name of the task.
    const NAME: &'static str;
    /// Name of the encoding of its states.
    const STATE_KIND: &'static str;
    /// Whether all its numbers are whole.
    const IS_WHOLE: bool;
    /// Number of agents.
    const AGENTS: usize;
    /// The action of every agent.
    const ACTION: ActionSpec;

    /// Features of an agent's observation.
    fn observed(agent: usize) -> Vec<FeatureSpec>;

    /// Indices in the global state of the observed features; empty if the state lacks any of them.
    fn seen(agent: usize) -> Vec<usize>;

    /// Features of the global state.
    fn global() -> Vec<FeatureSpec>;

    /// Draws the start of an episode.
    fn start(rng: &mut ChaCha8Rng) -> Self;

    /// Range of each of its numbers.
    fn bounds() -> Vec<[f32; 2]>;

    /// The game with these numbers, which are within bounds.
    fn from_numbers(numbers: &[f32]) -> Self;

    /// The numbers that define the game.
    fn numbers(&self) -> Vec<f32>;

    /// Takes a step and returns the reward. `actions` has a valid action of each agent.
    fn step(&mut self, step: u32, actions: &[f32]) -> f32;

    /// Writes the observation of an agent, `[obs]`, zeroed before.
    fn observe(&self, step: u32, agent: usize, out: &mut [f32]);

    /// Writes the global state, `[S]`, zeroed before.
    fn state(&self, step: u32, out: &mut [f32]);
}

/// Names of the games.
pub(crate) const NAMES: [&str; 3] = [cue::Cue::NAME, signal::Signal::NAME, jump::Jump::NAME];

/// The games of a slot.
pub(crate) struct GameEnvironments<G> {
    description: EnvironmentSpec,
    bounds: StateBounds,
    episodes: Vec<GameState<G>>,
}

/// Complete state of an environment.
#[derive(Clone)]
struct GameState<G> {
    position: EpisodePosition,
    game: G,
}

impl<G: Game> GameEnvironments<G> {
    /// Returns `count` games whose numbers are all 0, in episode 0.
    pub(crate) fn new(config: &TaskConfig, count: usize) -> Result<Self, SimError> {
        if config.observation.norm != ObservationNorm::None {
            let why = format!(
                "{} is a game, which scales no features: set observation.norm=none",
                G::NAME
            );
            return Err(SimError::Task(why));
        }
        let bounds = bounds::<G>();
        let game = G::from_numbers(&vec![0.0; bounds.coordinates.len()]);
        let position = EpisodePosition { episode: 0, step: 0, limit: EPISODE_STEPS };
        let episode = GameState { position, game };
        Ok(Self { description: describe::<G>(&bounds), bounds, episodes: vec![episode; count] })
    }
}

impl<G: Game> EnvironmentBatch for GameEnvironments<G> {
    fn description(&self) -> &EnvironmentSpec {
        &self.description
    }

    fn state_bounds(&self) -> Option<&StateBounds> {
        Some(&self.bounds)
    }

    fn count(&self) -> usize {
        self.episodes.len()
    }

    fn reset(
        &mut self,
        environment: usize,
        episode: u64,
        limit: u32,
        key: [u8; 32],
    ) -> Result<(), SimError> {
        let limit = limit.clamp(1, EPISODE_STEPS);
        let game = G::start(&mut ChaCha8Rng::from_seed(key));
        let position = EpisodePosition { episode, step: 0, limit };
        self.episodes[environment] = GameState { position, game };
        Ok(())
    }

    fn restore(&mut self, environment: usize, bytes: &[u8]) -> Result<(), SimError> {
        let state = State::from_bytes(bytes, &self.bounds)?;
        let game = G::from_numbers(&state.coordinates);
        self.episodes[environment] = GameState { position: state.position, game };
        Ok(())
    }

    fn encode(&self, environment: usize) -> Result<Vec<u8>, SimError> {
        let episode = &self.episodes[environment];
        let (position, coordinates) = (episode.position, episode.game.numbers());
        let state = State { position, coordinates, ..State::default() };
        Ok(state.to_bytes(&self.bounds.kind))
    }

    fn position(&self, environment: usize) -> EpisodePosition {
        self.episodes[environment].position
    }

    fn step(&mut self, actions: &[f32], outcome: &mut [Outcome]) -> Result<(), SimError> {
        assert_eq!(outcome.len(), self.count(), "outcome [E]");
        check_actions(&self.description, self.count(), actions)?;
        let rows = self.episodes.iter_mut().zip(actions.chunks_exact(G::AGENTS));
        for ((episode, actions), outcome) in rows.zip(outcome) {
            let position = &mut episode.position;
            let reward = episode.game.step(position.step, actions);
            position.step = position.step.saturating_add(1);
            let truncated = position.step >= position.limit;
            *outcome = Outcome { reward, truncated, ..Outcome::default() };
        }
        Ok(())
    }

    fn observation(&self, environment: usize, agent: usize, out: &mut [f32]) {
        assert_eq!(out.len(), self.description.agents[agent].observation.len(), "observation");
        let episode = &self.episodes[environment];
        out.fill(0.0);
        episode.game.observe(episode.position.step, agent, out);
    }

    fn state(&self, environment: usize, out: &mut [f32]) {
        assert_eq!(out.len(), self.description.state.len(), "state");
        let episode = &self.episodes[environment];
        out.fill(0.0);
        episode.game.state(episode.position.step, out);
    }
}

/// The number of a list with one for each step and one after the last that belongs to `step`.
fn at<T: Copy>(numbers: &[T], step: u32) -> T {
    numbers[(step as usize).min(numbers.len() - 1)]
}

/// A feature that carries a signal.
fn feature(name: &str) -> FeatureSpec {
    FeatureSpec { name: name.to_owned(), role: FeatureRole::Signal }
}

/// Features `name.0`, `name.1` and so on.
fn features(name: &str, count: usize, role: FeatureRole) -> Vec<FeatureSpec> {
    (0..count).map(|k| FeatureSpec { name: format!("{name}.{k}"), role }).collect()
}

fn bounds<G: Game>() -> StateBounds {
    StateBounds {
        kind: G::STATE_KIND.to_owned(),
        longest: EPISODE_STEPS,
        coordinates: G::bounds(),
        is_whole: G::IS_WHOLE,
        ..StateBounds::default()
    }
}

fn describe<G: Game>(bounds: &StateBounds) -> EnvironmentSpec {
    let agent = |index: usize| AgentSpec {
        name: format!("agent_{index}"),
        joints: Vec::new(),
        observation: G::observed(index),
        seen: G::seen(index),
        near: G::seen(index),
        action: G::ACTION,
    };
    EnvironmentSpec {
        task: G::NAME.to_owned(),
        agents: (0..G::AGENTS).map(agent).collect(),
        dt_secs: STEP_SECS,
        episode_steps: EPISODE_STEPS,
        state_kind: bounds.kind.clone(),
        state_version: STATE_VERSION,
        max_state_bytes: bounds.bytes() as u32,
        state: G::global(),
        feature_z: false,
        reward_terms: Vec::new(),
    }
}
