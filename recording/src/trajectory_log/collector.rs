//! Collects the shares of the logged episodes of a lease while the stepping thread plays them.

use policy::RunSeed;
use proto::trajectory_log::{AgentStep, FinalObservation, Kind, Share, ShareEnd, Step};
use proto::{
    EpisodePosition, Episodes, Lease, RolloutWork, RunDescription, WeightsName, rollout_episode_id,
};
use rollout::{EvaluationEpisode, PlayedStep, StepEvent};
use sim::{EnvironmentBatch, Outcome, Pose, SimError};

use crate::share::{LoggedShare, LoggedStep};

/// Collects the logged steps of a slot or of an evaluation episode.
pub struct ShareCollector<'a> {
    /// Header fields common to all shares of the lease.
    common: Share,
    kind: Collected<'a>,
    /// In the order of their starts.
    shares: Vec<LoggedShare>,
    /// The current share of each environment; `None` if it is not logged.
    open: Vec<Option<OpenShare>>,
    is_whole: bool,
    /// Why the state of an environment cannot be encoded.
    failure: Option<SimError>,
}

enum Collected<'a> {
    /// The selected episodes of a slot with this number of steps.
    Slot { work: &'a RolloutWork, episodes: Episodes, steps: u32 },
    /// A whole episode.
    Evaluation,
}

/// A share that continues, and its environment before the current step.
struct OpenShare {
    /// Index of the share.
    index: usize,
    pose: Pose,
    state: Vec<f32>,
}

impl<'a> ShareCollector<'a> {
    /// Starts a collector of a slot.
    pub(crate) fn rollout(
        episodes: Episodes,
        run: &RunDescription,
        lease: &Lease,
        work: &'a RolloutWork,
    ) -> Self {
        let iteration = work.iteration;
        let slot = work.slot;
        let kind = Kind::Rollout.into();
        let head = head(RunSeed(run.seed), lease.weights, lease.attempt);
        let common = Share { iteration, slot, kind, ..head };
        Self::new(common, Collected::Slot { work, episodes, steps: run.slot_steps })
    }

    /// Starts a collector of an evaluation episode of the weights, in their lease with number `attempt`.
    pub(crate) fn evaluation(
        episode: EvaluationEpisode,
        (weights, attempt): (WeightsName, u32),
    ) -> Self {
        let common = Share {
            episode_id: episode.id(),
            kind: Kind::Evaluation.into(),
            iteration: episode.iteration,
            episode: episode.index.into(),
            ..head(episode.seed, weights, attempt)
        };
        Self::new(common, Collected::Evaluation)
    }

    fn new(common: Share, kind: Collected<'a>) -> Self {
        let (shares, open) = (Vec::new(), Vec::new());
        Self { common, kind, shares, open, is_whole: false, failure: None }
    }

    /// Collects a step of all environments.
    pub fn observe(&mut self, event: &StepEvent<'_>) {
        match event {
            StepEvent::Before(step, world) => self.before(*step, *world),
            StepEvent::After(played) => self.after(played),
        }
    }

    /// Starts shares, and reads what the step will change.
    fn before(&mut self, step: u32, world: &dyn EnvironmentBatch) {
        self.open.resize_with(world.count(), || None);
        for environment in 0..world.count() {
            if step == 0 || world.position(environment).step == 0 {
                self.open[environment] = self.begin(environment, world);
            }
            if let Some(open) = &mut self.open[environment] {
                open.pose = world.pose(environment);
                open.state = world.state_of(environment);
            }
        }
    }

    /// Starts a share; `None` if it is not logged.
    fn begin(&mut self, environment: usize, world: &dyn EnvironmentBatch) -> Option<OpenShare> {
        let mut head = self.common.clone();
        if let Collected::Slot { work, episodes, .. } = &self.kind {
            let index = work.environments[environment].environment;
            let EpisodePosition { episode, step, .. } = world.position(environment);
            if !episodes.include_rollout(index, episode) {
                return None;
            }
            head.episode_id = rollout_episode_id(index, episode);
            (head.first_step, head.environment, head.episode) = (step, index, episode);
        }
        match world.encode(environment) {
            Ok(state) => head.environment_state = state,
            Err(error) => self.failure = Some(error),
        }
        self.shares.push(LoggedShare { head, steps: Vec::new(), end: ShareEnd::default() });
        Some(OpenShare { index: self.shares.len() - 1, pose: Pose::default(), state: Vec::new() })
    }

    fn after(&mut self, played: &PlayedStep<'_>) {
        self.is_whole = match self.kind {
            Collected::Slot { steps, .. } => played.step == steps,
            Collected::Evaluation => played.outcomes[0].is_end(),
        };
        for (environment, open) in self.open.iter_mut().enumerate() {
            let Some(OpenShare { index, pose, state }) = open else { continue };
            let share = &mut self.shares[*index];
            let Outcome { reward, terminated, truncated, .. } = played.outcomes[environment];
            let state = std::mem::take(state);
            let step = share.next_step();
            let reward_terms = played.world.reward_terms(environment).to_vec();
            let signal = row(played, environment, played.signal);
            let robot = played.world.world(environment);
            share.steps.push(LoggedStep {
                pose: std::mem::take(pose),
                efforts: robot.map(|robot| robot.efforts().collect()).unwrap_or_default(),
                agents: agents(played, environment),
                step: Step { step, reward, terminated, truncated, state, reward_terms, signal },
            });
            if played.outcomes[environment].is_end() {
                share.end = end(played.world, environment, share.steps.len());
                *open = None;
            } else if self.is_whole {
                share.end = end(played.world, environment, share.steps.len());
                match played.world.encode(environment) {
                    Ok(state) => share.end.environment_state = state,
                    Err(error) => self.failure = Some(error),
                }
            }
        }
    }

    /// Number of shares and of their steps.
    pub(crate) fn count(&self) -> (usize, usize) {
        (self.shares.len(), self.shares.iter().map(|share| share.steps.len()).sum())
    }

    /// The shares; none if the slot or the episode is not finished.
    ///
    /// # Errors
    /// If the state of an environment could not be encoded.
    pub(crate) fn finish(self) -> Result<Vec<LoggedShare>, SimError> {
        match self.failure {
            _ if !self.is_whole => Ok(Vec::new()),
            Some(error) => Err(error),
            None => Ok(self.shares),
        }
    }
}

/// Header fields common to all shares of a lease.
fn head(seed: RunSeed, weights: WeightsName, attempt: u32) -> Share {
    Share {
        attempt,
        seed: seed.0,
        weights_version: weights.version.0,
        weights_sha256: weights.digest.0.to_vec(),
        ..Share::default()
    }
}

/// The row of an environment in `all` `[E, features]`.
fn row(played: &PlayedStep<'_>, environment: usize, all: &[f32]) -> Vec<f32> {
    let width = all.len() / played.outcomes.len();
    all[environment * width..][..width].to_vec()
}

/// What each agent observed and did in an environment.
fn agents(played: &PlayedStep<'_>, environment: usize) -> Vec<AgentStep> {
    let row = |all| row(played, environment, all);
    let agent = |agent: usize| AgentStep {
        observation: row(&played.observation[agent]),
        action: row(&played.actions[agent]),
        log_prob: played.log_probs.map(|log_probs| log_probs[agent][environment]),
    };
    (0..played.actions.len()).map(agent).collect()
}

/// End of a share of `steps` steps, without the environment's state.
fn end(world: &dyn EnvironmentBatch, environment: usize, steps: usize) -> ShareEnd {
    let observation = |observation| FinalObservation { observation };
    ShareEnd {
        steps: steps as u32,
        environment_state: Vec::new(),
        state: world.state_of(environment),
        observations: world.observations_of(environment).into_iter().map(observation).collect(),
    }
}
