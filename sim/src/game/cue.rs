//! `cue-2x1`: two agents observe one of three cues and are rewarded if both choose it. Its information is known in
//! closed form: the actions of agents that follow the cue share `log 3` nats given the place, and none given place and
//! cue.
//!
//! The place is one of four on a ring and advances by one if both agents match the cue. The global state is the place.
//! Each agent observes the place, the cue and its own index, all one-hot. An episode's cues, one for each step and one
//! after the last, are drawn at its start and are part of its state. The cue of a step is therefore a function of the
//! reset key and the step.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use crate::config::{ObservationMode, ObservationNorm, TaskConfig};
use crate::description::{ActionRange, AgentDescription, Description, Feature, FeatureRole};
use crate::environment_batch::{EnvironmentBatch, Outcome};
use crate::error::{ActionError, SimError, StateError};
use crate::noise;
use crate::state::{STATE_VERSION, State, StateBounds};

/// Name of the task.
pub(crate) const NAME: &str = "cue-2x1";

const AGENTS: usize = 2;
const CUES: usize = 3;
const PLACES: usize = 4;
const EPISODE_STEPS: u32 = 50;
/// Size of an observation: place, cue, own index.
const OBSERVATION: usize = PLACES + CUES + AGENTS;
/// Reward of a step in which both agents choose the cue.
const REWARD: f32 = 1.0;
/// Duration of a step in recordings; the game itself has no time.
const STEP_SECS: f64 = 0.1;

/// The games of a slot.
pub(crate) struct CueEnvironments {
    description: Description,
    bounds: StateBounds,
    games: Vec<Game>,
}

/// Complete state of a game.
#[derive(Clone)]
struct Game {
    episode: u64,
    step: u32,
    limit: u32,
    place: usize,
    /// Cue before each step and after the last, `[EPISODE_STEPS + 1]`.
    cues: Vec<usize>,
}

impl CueEnvironments {
    /// Returns `count` games at place 0 with all cues 0, in episode 0.
    pub(crate) fn new(config: &TaskConfig, count: usize) -> Result<Self, SimError> {
        let (mode, norm) = (config.observation.mode, config.observation.norm);
        if (mode, norm) != (ObservationMode::FullId, ObservationNorm::None) {
            return Err(SimError::OnlyPlain { task: NAME });
        }
        if count == 0 {
            return Err(SimError::NoEnvironments);
        }
        let cues = vec![0; EPISODE_STEPS as usize + 1];
        let game = Game { episode: 0, step: 0, limit: EPISODE_STEPS, place: 0, cues };
        let bounds = bounds();
        Ok(Self { description: describe(&bounds), bounds, games: vec![game; count] })
    }

    fn check(&self, actions: &[f32]) -> Result<(), ActionError> {
        let (got, environments) = (actions.len(), self.count());
        if got != environments * AGENTS {
            return Err(ActionError::Length { got, environments, size: AGENTS });
        }
        let choice = |&a: &f32| a >= 0.0 && a < CUES as f32 && a.fract() == 0.0;
        match actions.iter().position(|action| !choice(action)) {
            None => Ok(()),
            Some(at) => {
                let (environment, agent, value) = (at / AGENTS, at % AGENTS, actions[at]);
                Err(ActionError::NoChoice { environment, agent, value, choices: CUES })
            }
        }
    }
}

impl EnvironmentBatch for CueEnvironments {
    fn description(&self) -> &Description {
        &self.description
    }

    fn state_bounds(&self) -> Option<&StateBounds> {
        Some(&self.bounds)
    }

    fn count(&self) -> usize {
        self.games.len()
    }

    fn reset(
        &mut self,
        environment: usize,
        episode: u64,
        limit: u32,
        key: [u8; 32],
    ) -> Result<(), SimError> {
        let mut rng = ChaCha8Rng::from_seed(key);
        self.games[environment] = Game {
            episode,
            step: 0,
            limit: limit.clamp(1, EPISODE_STEPS),
            place: noise::choice(&mut rng, PLACES),
            cues: (0..=EPISODE_STEPS).map(|_| noise::choice(&mut rng, CUES)).collect(),
        };
        Ok(())
    }

    fn restore(&mut self, environment: usize, bytes: &[u8]) -> Result<(), SimError> {
        let state = State::from_bytes(bytes, &self.bounds)?;
        let numbers = state.coordinates.iter().enumerate();
        let numbers = numbers.map(|(index, &value)| whole(index, value));
        let numbers = numbers.collect::<Result<Vec<_>, _>>()?;
        let (episode, step, limit) = (state.episode, state.step, state.limit);
        let (place, cues) = (numbers[0], numbers[1..].to_vec());
        self.games[environment] = Game { episode, step, limit, place, cues };
        Ok(())
    }

    fn encode(&self, environment: usize) -> Result<Vec<u8>, SimError> {
        let game = &self.games[environment];
        let numbers = std::iter::once(&game.place).chain(&game.cues);
        let state = State {
            episode: game.episode,
            step: game.step,
            limit: game.limit,
            coordinates: numbers.map(|&number| number as f32).collect(),
            velocities: Vec::new(),
            contact_forces: Vec::new(),
            actions: Vec::new(),
        };
        Ok(state.to_bytes(&self.bounds.kind))
    }

    fn episode(&self, environment: usize) -> u64 {
        self.games[environment].episode
    }

    fn episode_step(&self, environment: usize) -> u32 {
        self.games[environment].step
    }

    fn step(&mut self, actions: &[f32], outcome: &mut [Outcome]) -> Result<(), SimError> {
        assert_eq!(outcome.len(), self.count(), "outcome [E]");
        self.check(actions)?;
        let rows = self.games.iter_mut().zip(actions.chunks_exact(AGENTS));
        for ((game, action), outcome) in rows.zip(outcome) {
            *outcome = game.step(action);
        }
        Ok(())
    }

    fn observation(&self, environment: usize, agent: usize, out: &mut [f32]) {
        assert_eq!(out.len(), OBSERVATION, "observation");
        let game = &self.games[environment];
        out.fill(0.0);
        out[game.place] = 1.0;
        out[PLACES + game.cue()] = 1.0;
        out[PLACES + CUES + agent] = 1.0;
    }

    fn state(&self, environment: usize, out: &mut [f32]) {
        assert_eq!(out.len(), PLACES, "state");
        out.fill(0.0);
        out[self.games[environment].place] = 1.0;
    }
}

impl Game {
    /// Cue before the next step; the last cue after the last step.
    fn cue(&self) -> usize {
        self.cues[(self.step as usize).min(self.cues.len() - 1)]
    }

    fn step(&mut self, action: &[f32]) -> Outcome {
        let cue = self.cue() as f32;
        self.step = self.step.saturating_add(1);
        let matched = action.iter().all(|&a| a == cue);
        if matched {
            self.place = (self.place + 1) % PLACES;
        }
        Outcome {
            reward: if matched { REWARD } else { 0.0 },
            truncated: self.step >= self.limit,
            ..Outcome::default()
        }
    }
}

/// Converts a value within bounds to an integer.
fn whole(index: usize, value: f32) -> Result<usize, StateError> {
    if value.fract() != 0.0 {
        return Err(StateError::Fraction { field: "coordinate", index, value });
    }
    Ok(value as usize)
}

fn bounds() -> StateBounds {
    let mut coordinates = vec![[0.0, (CUES - 1) as f32]; EPISODE_STEPS as usize + 2];
    coordinates[0] = [0.0, (PLACES - 1) as f32];
    StateBounds {
        kind: "discrete/cue".to_owned(),
        longest: EPISODE_STEPS,
        coordinates,
        velocities: 0,
        fastest: 0.0,
        contact_forces: 0,
        actions: 0,
        orientation: None,
    }
}

fn describe(bounds: &StateBounds) -> Description {
    let features = |name: &str, count: usize, role: FeatureRole| -> Vec<Feature> {
        (0..count).map(|k| Feature { name: format!("{name}.{k}"), role }).collect()
    };
    let state = features("place", PLACES, FeatureRole::Signal);
    let cue = features("cue", CUES, FeatureRole::Signal);
    let number = features("id", AGENTS, FeatureRole::Identity);
    let agent = |index: usize| AgentDescription {
        name: format!("agent_{index}"),
        joints: Vec::new(),
        observation: [state.clone(), cue.clone(), number.clone()].concat(),
        // The global state does not contain the cue.
        seen: Vec::new(),
        near: Vec::new(),
        action: ActionRange {
            size: 1,
            low: 0.0,
            high: (CUES - 1) as f32,
            choices: Some(CUES as u32),
        },
    };
    Description {
        task: NAME.to_owned(),
        agents: (0..AGENTS).map(agent).collect(),
        dt_secs: STEP_SECS,
        episode_steps: EPISODE_STEPS,
        state_kind: bounds.kind.clone(),
        state_version: STATE_VERSION,
        max_state_bytes: bounds.bytes() as u32,
        state,
    }
}
