//! Environments for other programs: named and set as in commands, with the episodes of training, stepped by several threads.

use std::iter;
use std::sync::{Mutex, PoisonError};
use std::thread::{self, ScopedJoinHandle};

use anyhow::{Context as _, ensure};
use policy::RunSeed;
use policy::setting::between;
use proto::EnvironmentSpec;
use serde_json::json;
use sim::{Disturbances, EnvironmentBatch, ObservationNorm, Outcome, Pose, Robot, SimError};

use super::agents;
use crate::config::Request;
use crate::config::keys;
use crate::config::layers;
use crate::config::message_steps::WINDOW;
use crate::config::run_config::RunConfig;
use crate::errors::Usage;
use crate::film::{self, RobotShapes};

/// Most environments, and most threads.
const LIMITS: [i64; 2] = [65_536, 1024];

/// Settings that change environments, besides the task, or on which one of these depends; of a name with a dot at its end, all
/// that begin with it.
const EFFECTIVE: [&str; 10] = [
    "observation.mode",
    "observation.nearest",
    "observation.globals",
    "observation.contact_forces",
    "reward.",
    "run.seed",
    "environments.steps",
    WINDOW,
    "preset",
    "algorithm",
];

/// Environments of one task, `E` in number. Environment `e` is environment `e` of a run with the same settings: it starts its
/// episodes in the same states, and is rebuilt from its state after the steps of a slot.
pub struct Environments {
    shares: Vec<Share>,
    seed: RunSeed,
    /// Whether an episode has begun; before, environments are at rest in episode 0.
    has_begun: bool,
    /// The shapes of a robot and its rest pose, for pictures.
    drawn: Option<(RobotShapes, Pose)>,
}

/// Consecutive environments, which one thread steps.
struct Share {
    /// Index of the first.
    first: usize,
    world: Box<dyn EnvironmentBatch>,
    /// Of the last step, `[e]`; none is an end after a reset.
    outcomes: Vec<Outcome>,
    /// Of all agents in their order, `[e, O]`.
    observations: Vec<f32>,
    /// Of the last step, `[e, J]`; 0 after a reset.
    efforts: Vec<f32>,
    /// Steps since the start or since a state was saved or restored, `[e]`.
    taken: Vec<u64>,
    /// Steps of a slot.
    slot_steps: u64,
}

/// A picture.
pub struct Picture {
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// Red, green and blue of each pixel, row by row.
    pub rgb: Vec<u8>,
}

impl Environments {
    /// Builds `count` environments, stepped by at most `threads` threads. `settings` are the task or the path of its file, then
    /// pairs `key=value`, as commands take them.
    ///
    /// # Errors
    /// If the task, a setting or a number is invalid.
    pub fn new(
        settings: Vec<String>,
        [count, threads]: [i64; 2],
        disturbances: Disturbances,
    ) -> anyhow::Result<Self> {
        between("num_envs", count, 1, LIMITS[0])?;
        between("threads", threads, 1, LIMITS[1])?;
        let keys = settings.iter().skip(1).filter_map(|setting| setting.split_once('='));
        demand_effect(keys.map(|(key, _)| key))?;
        let settings_place = Some("settings".to_owned());
        let request = Request { settings, settings_place, ..Request::default() };
        let mut config = RunConfig::of(&request)?;
        let is_own = config.task.definition.is_some();
        if !is_own && Robot::of_task(&config.task.task).is_err() {
            // A game scales no observations, whatever its algorithm's runs of robots do.
            config.task.observation.norm = ObservationNorm::None;
        }
        let (count, threads) = (count as usize, threads as usize);
        let size = count.div_ceil(threads);
        let slot_steps = config.learner.environments.steps as u64;
        let share = |first: usize| {
            let mut world = sim::environments(&config.task, size.min(count - first))?;
            world.set_disturbances(disturbances);
            Ok(Share::new(first, world, slot_steps))
        };
        let shares: Result<Vec<Share>, SimError> = (0..count).step_by(size).map(share).collect();
        let shares = shares.context("cannot build the task")?;
        let world = &*shares[0].world;
        let drawn = RobotShapes::of(world).map(|shapes| (shapes, world.pose(0)));
        Ok(Self { seed: RunSeed(config.run.seed), has_begun: false, drawn, shares })
    }

    /// Description of the task.
    fn task(&self) -> &EnvironmentSpec {
        self.shares[0].world.description()
    }

    /// The task and its agents as JSON, as Python's `TaskSpec` has them.
    pub fn about(&self) -> String {
        let (task, world) = (self.task(), &*self.shares[0].world);
        let state = task.state.iter().map(|feature| feature.name.as_str());
        let about = json!({
            "name": task.task,
            "dt_secs": task.dt_secs,
            "episode_steps": task.episode_steps,
            "state": state.collect::<Vec<_>>(),
            "reward_terms": task.reward_terms,
            "joints": world.robot().map(Robot::effort_names).unwrap_or_default(),
            "agents": agents::of_task(world),
        });
        about.to_string()
    }

    /// Number of environments `E`.
    pub fn count(&self) -> usize {
        self.shares.iter().map(|share| share.world.count()).sum()
    }

    /// Starts the next episode of every environment or, with a seed, episode 0. `limits` are the steps until truncation, `[E]`;
    /// empty: those of the task.
    ///
    /// # Errors
    /// If `limits` has a wrong length or a limit is out of range.
    pub fn reset(&mut self, seed: Option<u64>, limits: &[i64]) -> anyhow::Result<()> {
        let (count, most) = (self.count(), self.task().episode_steps);
        let given = limits.len();
        ensure!([0, count].contains(&given), "got {given} limits for {count} environments");
        limits.iter().try_for_each(|limit| between("limit", *limit, 1, most.into()))?;
        let is_first = seed.is_some() || !self.has_begun;
        let seed = seed.map_or(self.seed, RunSeed);
        (self.seed, self.has_begun) = (seed, true);
        self.each(|share| {
            if is_first {
                share.taken.fill(0);
            }
            for position in 0..share.world.count() {
                let limit = limits.get(share.first + position).map_or(most, |limit| *limit as u32);
                let episode = share.world.position(position).episode;
                let episode = if is_first { 0 } else { episode + 1 };
                share.start(position, seed, episode, limit)?;
            }
            share.observe();
            Ok(())
        })
    }

    /// Steps every environment with the actions `[E, A]` of all agents in their order. An environment whose episode ended in
    /// the step before starts its next episode instead, with the reward 0.
    ///
    /// # Errors
    /// Before the first reset, or if an action is invalid; no environment is stepped.
    pub fn step(&mut self, actions: &[f32]) -> anyhow::Result<()> {
        self.demand_episode()?;
        let (count, seed) = (self.count(), self.seed);
        sim::check_actions(self.task(), count, actions)?;
        let size = actions.len() / count;
        self.each(|share| {
            let own = &actions[share.first * size..][..share.world.count() * size];
            share.step(own, seed)
        })
    }

    /// Results of the last step, `[E]`.
    pub fn outcomes(&self) -> impl Iterator<Item = &Outcome> {
        self.shares.iter().flat_map(|share| &share.outcomes)
    }

    /// Terms of the rewards of the last step, `[E, K]` in the order of [`EnvironmentSpec::reward_terms`].
    pub fn reward_terms(&self) -> impl Iterator<Item = &f32> {
        let worlds = self.shares.iter().map(|share| &share.world);
        let each = worlds.flat_map(|world| (0..world.count()).map(move |index| (world, index)));
        each.flat_map(|(world, index)| world.reward_terms(index))
    }

    /// Mean torques of the actuators in the last step, `[E, J]` in the order of [`Robot::effort_names`], N m, or forces on slides,
    /// N. 0 after a fault and after a reset.
    pub fn efforts(&self) -> impl Iterator<Item = &f32> {
        self.shares.iter().flat_map(|share| &share.efforts)
    }

    /// Observations of all agents in their order, `[E, O]`.
    pub fn observations(&self) -> impl Iterator<Item = &f32> {
        self.shares.iter().flat_map(|share| &share.observations)
    }

    /// The global states, `[E, S]`.
    pub fn states(&self) -> impl Iterator<Item = f32> {
        let of_share = |share: &Share| {
            (0..share.world.count())
                .flat_map(|index| share.world.state_of(index))
                .collect::<Vec<_>>()
        };
        self.shares.iter().flat_map(of_share)
    }

    /// The encoded state of an environment, as logs and checkpoints of a run have it. The environment continues from it, as
    /// after [`Self::restore`].
    ///
    /// # Errors
    /// Before the first reset or restored state, or if its episode is over.
    pub fn save(&mut self, environment: usize) -> anyhow::Result<Vec<u8>> {
        self.demand_episode()?;
        let (share, position) = self.place(environment);
        let share = &self.shares[share];
        ensure!(!share.outcomes[position].is_end(), "the episode is over; reset the environment");
        let state = share.world.encode(position)?;
        self.restore(environment, &state)?;
        Ok(state)
    }

    /// Continues an environment from an encoded state.
    ///
    /// # Errors
    /// If the bytes are not a state of this task; nothing is changed.
    pub fn restore(&mut self, environment: usize, state: &[u8]) -> anyhow::Result<()> {
        let (share, position) = self.place(environment);
        let share = &mut self.shares[share];
        share.world.restore(position, state)?;
        share.outcomes[position] = Outcome::default();
        share.taken[position] = 0;
        share.observe();
        self.has_begun = true;
        Ok(())
    }

    /// A picture of the robot of an environment.
    ///
    /// # Errors
    /// If the task is a game.
    pub fn picture(&self, environment: usize) -> anyhow::Result<Picture> {
        let task = &self.task().task;
        let is_game = || Usage::new(format!("{task} is a game: there is nothing to draw"));
        let (shapes, rest) = self.drawn.as_ref().ok_or_else(is_game)?;
        let (share, position) = self.place(environment);
        let pixels = film::still(shapes, rest, &self.shares[share].world.pose(position));
        let rgb = pixels.data().chunks_exact(4).flat_map(|pixel| &pixel[..3]).copied().collect();
        Ok(Picture { width: pixels.width(), height: pixels.height(), rgb })
    }

    fn demand_episode(&self) -> anyhow::Result<()> {
        ensure!(self.has_begun, "no episode has begun; call reset()");
        Ok(())
    }

    /// The share of an environment, and its position in the share.
    fn place(&self, environment: usize) -> (usize, usize) {
        let size = self.shares[0].world.count();
        (environment / size, environment % size)
    }

    /// Does `work` for each share, in this and other threads. No result depends on their number, so a thread that cannot start
    /// is no error.
    fn each(
        &mut self,
        work: impl Fn(&mut Share) -> anyhow::Result<()> + Sync,
    ) -> anyhow::Result<()> {
        let others = 1..self.shares.len();
        let waiting = Mutex::new(self.shares.iter_mut());
        let next = || waiting.lock().unwrap_or_else(PoisonError::into_inner).next();
        let work_off = || iter::from_fn(next).map(&work).fold(Ok(()), Result::and);
        thread::scope(|scope| {
            let start = |_| {
                let thread = thread::Builder::new().name("environments".to_owned());
                thread.spawn_scoped(scope, work_off).ok()
            };
            let started: Vec<_> = others.filter_map(start).collect();
            let own = work_off();
            started.into_iter().map(joined).fold(own, Result::and)
        })
    }
}

/// The result of a thread, or its panic.
fn joined<T>(thread: ScopedJoinHandle<'_, T>) -> T {
    thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}

/// Refuses the first known setting that changes no environment.
fn demand_effect<'a>(mut given: impl Iterator<Item = &'a str>) -> anyhow::Result<()> {
    let is_without = |key: &&str| layers::default_of(key).is_ok() && !keys::covers(&EFFECTIVE, key);
    let Some(key) = given.find(is_without) else { return Ok(()) };
    let known = EFFECTIVE.join(", ").replace("reward.", "the weights of reward");
    let why = format!("settings: `{key}` has no effect on an environment; {known} have");
    Err(Usage::new(why).into())
}

impl Share {
    fn new(first: usize, world: Box<dyn EnvironmentBatch>, slot_steps: u64) -> Self {
        let count = world.count();
        let agents = world.description().agents.iter();
        let features: usize = agents.map(|agent| agent.observation.len()).sum();
        let observations = vec![0.0; count * features];
        let joints = world.robot().map_or(0, |robot| robot.effort_names().len());
        let efforts = vec![0.0; count * joints];
        let (outcomes, taken) = (vec![Outcome::default(); count], vec![0; count]);
        Self { first, world, outcomes, observations, efforts, taken, slot_steps }
    }

    fn start(
        &mut self,
        position: usize,
        seed: RunSeed,
        episode: u64,
        limit: u32,
    ) -> anyhow::Result<()> {
        let index = u32::try_from(self.first + position).expect("environments have a limit");
        self.outcomes[position] = Outcome::default();
        Ok(rollout::start_episode(&mut *self.world, seed, (position, index), episode, limit)?)
    }

    fn step(&mut self, actions: &[f32], seed: RunSeed) -> anyhow::Result<()> {
        let ended: Vec<bool> = self.outcomes.iter().map(Outcome::is_end).collect();
        self.world.step(actions, &mut self.outcomes)?;
        let limit = self.world.description().episode_steps;
        for (position, ended) in ended.into_iter().enumerate() {
            if ended {
                let episode = self.world.position(position).episode + 1;
                self.start(position, seed, episode, limit)?;
                self.note_efforts(position);
                continue;
            }
            // A rebuild discards them.
            self.note_efforts(position);
            self.taken[position] += 1;
            let is_slot_end = self.taken[position].is_multiple_of(self.slot_steps);
            if is_slot_end && !self.outcomes[position].is_end() {
                let state = self.world.encode(position)?;
                self.world.restore(position, &state)?;
            }
        }
        self.observe();
        Ok(())
    }

    fn note_efforts(&mut self, position: usize) {
        let Some(world) = self.world.world(position) else { return };
        let joints = self.efforts.len() / self.world.count();
        let own = &mut self.efforts[position * joints..][..joints];
        own.iter_mut().zip(world.efforts()).for_each(|(own, effort)| *own = effort);
    }

    fn observe(&mut self) {
        let mut rest = self.observations.as_mut_slice();
        for environment in 0..self.world.count() {
            for (agent, spec) in self.world.description().agents.iter().enumerate() {
                let (own, after) = rest.split_at_mut(spec.observation.len());
                self.world.observation(environment, agent, own);
                rest = after;
            }
        }
    }
}
