//! Environments of another program, behind the interface of simulated ones. This module counts episodes and steps,
//! truncates episodes at their limits, and restores an episode in the next slot.
//!
//! An encoded state starts with the episode's index (u64), step (u32) and limit (u32), little-endian. The saved state
//! of the program follows. If the program does not save states, the episode's key (32 bytes) and its actions so far
//! (f32 `[step, A]`) follow, from which the episode is replayed.

mod actions;
mod header;

use std::cell::RefCell;
use std::ops::Range;

use proto::name::LONGEST;
use proto::{ActionSpec, Digest, EnvironmentSpec, EpisodePosition, View};
use sim::{EnvironmentBatch, ObservationNorm, Outcome, SimError, StateError, standardise};

use crate::client::{EnvironmentClient, Play};
use crate::error::{ActorError, EnvironmentError};
use crate::outside::actions::{by_agent, width};
use crate::outside::header::{HEADER_BYTES, KEY_BYTES, header, history, read_header};

/// How an episode is restored in another slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum States {
    /// The program saves and restores its state.
    Saved,
    /// The episode is replayed from its key and actions.
    Replayed,
}

impl States {
    /// Name in manifests.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Saved => "saved",
            Self::Replayed => "replayed",
        }
    }
}

/// A connection to a program that provides an environment.
#[derive(Clone, Debug)]
pub struct EnvironmentService {
    client: EnvironmentClient,
    /// Specification as the program describes it.
    offered: EnvironmentSpec,
    /// How episodes are restored.
    pub states: States,
    /// Specification that every actor of the run must provide, with the encoded state of this module.
    pub spec: EnvironmentSpec,
}

impl EnvironmentService {
    /// Connects to the program at `url` and requests its specification.
    ///
    /// # Errors
    /// If the program does not answer or sends an invalid answer, or the actions of an episode exceed the size limit.
    pub async fn connect(url: &str) -> Result<Self, ActorError> {
        let mut client = EnvironmentClient::connect(url).await?;
        let offered = client.describe().await?;
        let states = if offered.max_state_bytes > 0 { States::Saved } else { States::Replayed };
        let spec = spec_of_run(&offered, states).ok_or_else(|| {
            let why = match states {
                States::Saved => "its max_state_bytes are too many; a state has at most 4 GiB",
                States::Replayed => "the actions of an episode need more than 4 GiB",
            };
            ActorError::environment_url(url, why)
        })?;
        Ok(Self { client, offered, states, spec })
    }

    /// Scales observations as `norm` says. Policies apply [`ObservationNorm::Running`], so it changes nothing here.
    #[must_use]
    pub fn scaled(mut self, norm: ObservationNorm) -> Self {
        self.spec.feature_z = norm == ObservationNorm::FeatureZ;
        self
    }

    /// A function that decodes the states of these environments as far as the program is not needed: the header, and the
    /// history of an episode that is replayed.
    pub fn state_decoder(&self) -> impl Fn(&[u8]) -> Result<EpisodePosition, SimError> + use<> {
        let states = self.states;
        let longest = self.spec.episode_steps;
        let most = self.spec.max_state_bytes as usize;
        let width = width(&self.offered);
        move |state| {
            if state.len() > most {
                let why = format!("it has {} bytes; a state has at most {most}", state.len());
                return Err(StateError(why).into());
            }
            let (position, rest) = read_header(state, longest)?;
            if states == States::Replayed {
                history(position.step, rest, width)?;
            }
            Ok(position)
        }
    }

    /// Returns `count` environments before their first reset. Call it inside a tokio runtime; step the environments on
    /// a thread that may block.
    #[must_use]
    pub fn environments(&self, count: usize) -> OutsideEnvironments {
        let rows = self.offered.agents.iter().map(|agent| vec![0.0; agent.observation.len()]);
        let episode = CurrentEpisode {
            position: EpisodePosition { episode: 0, step: 0, limit: self.spec.episode_steps },
            key: [0; KEY_BYTES],
            actions: Vec::new(),
            observations: rows.collect(),
            state: vec![0.0; self.offered.state.len()],
        };
        OutsideEnvironments {
            spec: self.spec.clone(),
            offered: self.offered.clone(),
            states: self.states,
            scale: if self.spec.feature_z { standardise } else { |_| {} },
            play: RefCell::new(self.client.play(&self.offered)),
            episodes: vec![episode; count],
        }
    }
}

/// Specification with the encoded states that actors exchange; `None` if these are too large.
fn spec_of_run(offered: &EnvironmentSpec, states: States) -> Option<EnvironmentSpec> {
    let (kind, more) = match states {
        States::Saved => (offered.state_kind.as_str(), u64::from(offered.max_state_bytes)),
        States::Replayed => {
            let actions = (width(offered) as u64)
                .checked_mul(offered.episode_steps.into())?
                .checked_mul(4)?;
            (offered.task.as_str(), actions.checked_add(KEY_BYTES as u64)?)
        }
    };
    let mut agents = offered.agents.clone();
    let mut ranges = String::new();
    for (index, agent) in agents.iter_mut().enumerate() {
        let ActionSpec { low, high, choices, .. } = agent.action;
        if choices.is_none() && (low, high) != (-1.0, 1.0) {
            // The same actions lead to other states in another range.
            ranges += &format!("/{index}:{low}..{high}");
            (agent.action.low, agent.action.high) = (-1.0, 1.0);
        }
    }
    let mut state_kind = format!("outside/{}/{kind}{ranges}", states.name());
    if state_kind.len() > LONGEST {
        state_kind = format!("outside/{}/{}", states.name(), Digest::of(state_kind.as_bytes()));
    }
    Some(EnvironmentSpec {
        agents,
        state_kind,
        max_state_bytes: u32::try_from(more.checked_add(HEADER_BYTES as u64)?).ok()?,
        ..offered.clone()
    })
}

/// Environments of a slot, stepped by another program.
#[derive(Debug)]
pub struct OutsideEnvironments {
    /// Description for the run.
    spec: EnvironmentSpec,
    /// Description by the program.
    offered: EnvironmentSpec,
    states: States,
    /// Scales an observation.
    scale: fn(&mut [f32]),
    /// In a cell, because saving a state needs the stream but does not change the environments.
    play: RefCell<Play>,
    episodes: Vec<CurrentEpisode>,
}

/// Current episode of an environment.
#[derive(Clone, Debug)]
struct CurrentEpisode {
    position: EpisodePosition,
    key: [u8; KEY_BYTES],
    /// Actions so far, `[step, A]`, in units of half a range; kept only if episodes are replayed.
    actions: Vec<f32>,
    /// Observation of each agent, `[obs]`.
    observations: Vec<Vec<f32>>,
    /// Global state, `[S]`.
    state: Vec<f32>,
}

impl CurrentEpisode {
    /// Copies row `row` of a view.
    fn read_row(&mut self, view: &View, row: usize, scale: fn(&mut [f32])) {
        let views = view.observations.iter().zip(&mut self.observations);
        for (rows, own) in views.chain([(&view.state, &mut self.state)]) {
            let size = own.len();
            own.copy_from_slice(&rows[row * size..][..size]);
        }
        self.observations.iter_mut().for_each(|observation| scale(observation));
    }

    /// The key and the actions so far.
    fn history(&self) -> Vec<u8> {
        let actions = self.actions.iter().flat_map(|number| number.to_le_bytes());
        self.key.into_iter().chain(actions).collect()
    }
}

impl EnvironmentBatch for OutsideEnvironments {
    fn description(&self) -> &EnvironmentSpec {
        &self.spec
    }

    fn count(&self) -> usize {
        self.episodes.len()
    }

    fn reset(
        &mut self,
        environment: usize,
        episode: u64,
        limit: u32,
        key: [u8; KEY_BYTES],
    ) -> Result<(), SimError> {
        let view = self.play.get_mut().reset(environment as u32, key);
        let view = view.map_err(|error| error.at("after a reset"))?;
        let limit = limit.clamp(1, self.spec.episode_steps);
        let now = &mut self.episodes[environment];
        now.position = EpisodePosition { episode, step: 0, limit };
        now.key = key;
        now.actions.clear();
        now.read_row(&view, 0, self.scale);
        Ok(())
    }

    fn restore(&mut self, environment: usize, state: &[u8]) -> Result<(), SimError> {
        self.restore_all(&[(environment, state)])
    }

    fn restore_all(&mut self, states: &[(usize, &[u8])]) -> Result<(), SimError> {
        self.restore_states(states).map_err(of_state)
    }

    fn encode(&self, environment: usize) -> Result<Vec<u8>, SimError> {
        let mut states = self.encode_range(environment..environment + 1)?;
        Ok(states.pop().expect("one environment has one state"))
    }

    fn encode_all(&self) -> Result<Vec<Vec<u8>>, SimError> {
        self.encode_range(0..self.count())
    }

    fn position(&self, environment: usize) -> EpisodePosition {
        self.episodes[environment].position
    }

    fn step(&mut self, actions: &[f32], outcome: &mut [Outcome]) -> Result<(), SimError> {
        let environments = (0..self.count()).collect::<Vec<_>>();
        self.step_some(&environments, actions, outcome)
    }

    fn observation(&self, environment: usize, agent: usize, out: &mut [f32]) {
        out.copy_from_slice(&self.episodes[environment].observations[agent]);
    }

    fn state(&self, environment: usize, out: &mut [f32]) {
        out.copy_from_slice(&self.episodes[environment].state);
    }
}

impl OutsideEnvironments {
    /// Restores encoded states.
    fn restore_states(&mut self, states: &[(usize, &[u8])]) -> Result<(), SimError> {
        let read = |&(environment, state): &(usize, _)| {
            let (position, rest) = read_header(state, self.spec.episode_steps)?;
            Ok((environment, position, rest))
        };
        let states = states.iter().map(read).collect::<Result<Vec<_>, SimError>>()?;
        match self.states {
            States::Saved => self.restore_saved(&states)?,
            States::Replayed => {
                for (environment, position, past) in &states {
                    self.replay(*environment, *position, past)?;
                }
            }
        }
        for (environment, position, _) in states {
            self.episodes[environment].position = position;
        }
        Ok(())
    }

    /// Steps the given environments; `actions` is `[n, A]`, `outcome` `[n]`.
    fn step_some(
        &mut self,
        environments: &[usize],
        actions: &[f32],
        outcome: &mut [Outcome],
    ) -> Result<(), SimError> {
        let numbers = environments.iter().map(|environment| *environment as u32).collect();
        let actions_by_agent = by_agent(&self.offered, actions);
        let answer = self.play.get_mut().step(numbers, actions_by_agent);
        let steps = answer.map_err(|error| error.at(&self.place(environments)))?;
        let width = width(&self.offered);
        for (row, &environment) in environments.iter().enumerate() {
            let now = &mut self.episodes[environment];
            now.read_row(&steps.view, row, self.scale);
            if self.states == States::Replayed {
                now.actions.extend_from_slice(&actions[row * width..][..width]);
            }
            let position = &mut now.position;
            position.step = position.step.saturating_add(1);
            let terminated = steps.terminated[row];
            let truncated =
                steps.truncated[row] || (!terminated && position.step >= position.limit);
            outcome[row] =
                Outcome { reward: steps.reward[row], terminated, truncated, fault: false };
        }
        Ok(())
    }

    /// The step of their episodes that these environments take, for errors.
    fn place(&self, environments: &[usize]) -> String {
        let steps =
            environments.iter().map(|environment| self.episodes[*environment].position.step);
        let (first, last) =
            steps.fold((u32::MAX, 0), |(first, last), step| (first.min(step), last.max(step)));
        if first == last {
            format!("step {first} of the episode")
        } else {
            format!("steps {first} to {last} of {} episodes", environments.len())
        }
    }

    /// Restores states that the program saved; the header of each is already read.
    fn restore_saved(
        &mut self,
        states: &[(usize, EpisodePosition, &[u8])],
    ) -> Result<(), SimError> {
        let saved = |&(environment, _, state): &(usize, _, _)| (environment as u32, state);
        let saved = states.iter().map(saved).collect::<Vec<_>>();
        let views = self.play.get_mut().restore(&saved)?;
        for ((environment, ..), view) in states.iter().zip(&views) {
            self.episodes[*environment].read_row(view, 0, self.scale);
        }
        Ok(())
    }

    /// Encodes the states of these environments.
    fn encode_range(&self, environments: Range<usize>) -> Result<Vec<Vec<u8>>, SimError> {
        let episodes = &self.episodes[environments.clone()];
        let rest = match self.states {
            States::Saved => {
                let numbers = environments.start as u32..environments.end as u32;
                self.play.borrow_mut().save(numbers)?
            }
            States::Replayed => episodes.iter().map(CurrentEpisode::history).collect(),
        };
        let encoded =
            |(now, rest): (&CurrentEpisode, Vec<u8>)| [header(now.position), rest].concat();
        Ok(episodes.iter().zip(rest).map(encoded).collect())
    }

    /// Restores an episode by repeating its actions. It is an error if the episode ends early.
    fn replay(
        &mut self,
        environment: usize,
        position: EpisodePosition,
        past: &[u8],
    ) -> Result<(), SimError> {
        let EpisodePosition { episode, step: steps, limit } = position;
        let width = width(&self.offered);
        let (key, actions) = history(steps, past, width)?;
        self.reset(environment, episode, limit, key)?;
        for (step, action) in actions.chunks_exact(width).enumerate() {
            let mut outcome = [Outcome::default()];
            self.step_some(&[environment], action, &mut outcome)?;
            if outcome[0].terminated || outcome[0].truncated {
                let why = format!(
                    "its replay ends after step {} of {steps}; the environment must be deterministic",
                    step + 1
                );
                return Err(StateError(why).into());
            }
        }
        Ok(())
    }
}

/// An error of the program while it restores a state: if it rejects the request, the state is invalid.
fn of_state(error: SimError) -> SimError {
    let external = match error {
        SimError::External(external) => external.downcast::<EnvironmentError>(),
        own => return own,
    };
    match external {
        Ok(error) if error.is_rejection() => StateError(error.to_string()).into(),
        Ok(error) => (*error).into(),
        Err(other) => SimError::External(other),
    }
}
