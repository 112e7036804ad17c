//! Episodes of random actions: what they show of a task.

use anyhow::Context as _;
use policy::randomness::uniform;
use policy::{Draw, DrawKey, Purpose, RunSeed};
use proto::MAX_MAGNITUDE;
use sim::{EnvironmentBatch, Outcome, Pose};

use crate::figures::chart;
use crate::film::{self, RobotShapes, TimedPose, ViewDirection};

/// Seed of the random actions.
const SEED: RunSeed = RunSeed(0);
/// Pictures of a film.
const FRAMES: usize = 8;

/// What happens under random actions.
#[derive(Default)]
pub(super) struct Trial {
    /// Episodes that began.
    episodes: u32,
    /// Whether the last episode has no end, because the time was over.
    pub(super) is_cut: bool,
    steps: u64,
    total: f64,
    terminated: u32,
    pub(super) faults: u32,
    /// Smallest and largest value of each term of the reward in a step.
    terms: Vec<(f32, f32)>,
    /// Largest velocity, m/s or rad/s, and its name; `None` if nothing has moved.
    fastest: Option<(f32, String)>,
    /// The shapes of the first episode; `None` for a game.
    robot: Option<RobotShapes>,
    /// Poses of the first episode.
    poses: Vec<Pose>,
}

impl Trial {
    /// Plays up to `count` episodes, until `is_late`.
    pub(super) fn play_all(
        &mut self,
        world: &mut dyn EnvironmentBatch,
        count: u32,
        is_late: &dyn Fn() -> bool,
    ) -> anyhow::Result<()> {
        for episode in 0..count {
            self.play(world, episode, is_late)?;
            if self.is_cut {
                break;
            }
        }
        Ok(())
    }

    /// Plays an episode with uniformly distributed actions, at least a step of it, until `is_late`.
    fn play(
        &mut self,
        world: &mut dyn EnvironmentBatch,
        episode: u32,
        is_late: &dyn Fn() -> bool,
    ) -> anyhow::Result<()> {
        self.episodes += 1;
        let limit = world.description().episode_steps;
        let start = Draw::of(Purpose::EvaluationReset).iteration(episode.into());
        world.reset(0, 0, limit, DrawKey::of(SEED, start).0)?;
        if episode == 0 {
            self.robot = RobotShapes::of(world);
        }
        let mut outcome = [Outcome::default()];
        for step in 0.. {
            if episode == 0 {
                self.poses.push(world.pose(0));
            }
            let action = random_action(world, episode, step);
            world.step(&action, &mut outcome)?;
            self.steps += 1;
            self.total += f64::from(outcome[0].reward);
            demand_moderate(world, outcome[0].reward)?;
            self.note_terms(world.reward_terms(0));
            self.note_speed(world);
            if outcome[0].is_end() {
                break;
            }
            if is_late() {
                self.is_cut = true;
                break;
            }
        }
        self.terminated += u32::from(outcome[0].terminated);
        self.faults += u32::from(outcome[0].fault);
        Ok(())
    }

    fn note_terms(&mut self, values: &[f32]) {
        self.terms.resize(values.len(), (f32::INFINITY, f32::NEG_INFINITY));
        for (range, value) in self.terms.iter_mut().zip(values) {
            *range = (range.0.min(*value), range.1.max(*value));
        }
    }

    /// Warnings about the terms of the reward, named `names`, that were the same in every step, but for `alive`.
    pub(super) fn constant_terms(&self, names: &[String]) -> Vec<String> {
        let is_constant = |(name, (low, high)): &(&String, &(f32, f32))| {
            low == high && self.steps > 1 && name.split('_').next() != Some("alive")
        };
        let terms = names.iter().zip(&self.terms).filter(is_constant);
        let line = |(name, (value, _)): (&String, &(f32, f32))| {
            format!(
                "the reward's term `{name}` was {value} in every step of random actions; agents learn from it only if its \
                 weight is not 0 and other actions change it"
            )
        };
        terms.map(line).collect()
    }

    fn note_speed(&mut self, world: &dyn EnvironmentBatch) {
        let Some(world) = world.world(0) else { return };
        let mut velocities = vec![0.0; world.robot().velocity_names().len()];
        world.velocities(&mut velocities);
        for (velocity, name) in velocities.into_iter().zip(world.robot().velocity_names()) {
            let fastest = self.fastest.as_ref().map_or(0.0, |fastest| fastest.0);
            if velocity.abs() > fastest {
                self.fastest = Some((velocity.abs(), name.clone()));
            }
        }
    }

    pub(super) fn summary(&self) -> String {
        let mean = |sum: f64| sum / f64::from(self.episodes);
        let episodes = chart::count_of(u64::from(self.episodes), "episode");
        let fastest = self.fastest.as_ref();
        let fastest = fastest.map(|(speed, name)| format!("; largest speed {speed:.1} ({name})"));
        format!(
            "{episodes} of random actions: mean length {:.1} steps, mean return {:.1}, {} ended by the task's \
             rules, {} by a physics fault{}",
            mean(self.steps as f64),
            mean(self.total),
            self.terminated,
            self.faults,
            fastest.unwrap_or_default(),
        )
    }

    /// Pictures of the first episode at equal distances.
    pub(super) fn film(&self, world: &dyn EnvironmentBatch) -> anyhow::Result<Vec<u8>> {
        let robot = self.robot.as_ref().context("only robots can be drawn")?;
        let dt_secs = world.description().dt_secs;
        let count = FRAMES.min(self.poses.len());
        let frame = |picture: usize| {
            let step = picture * (self.poses.len() - 1) / count.saturating_sub(1).max(1);
            TimedPose { time_secs: step as f64 * dt_secs, pose: &self.poses[step] }
        };
        film::strip(robot, &(0..count).map(frame).collect::<Vec<_>>(), ViewDirection::Side)
    }
}

/// Refuses a reward, and a term of it, that no learner accepts.
fn demand_moderate(world: &dyn EnvironmentBatch, reward: f32) -> anyhow::Result<()> {
    let terms = world.description().reward_terms.iter().zip(world.reward_terms(0));
    let largest = terms.max_by(|one, other| one.1.abs().total_cmp(&other.1.abs()));
    let Some((name, value)) = largest else { return Ok(()) };
    anyhow::ensure!(
        reward.abs().max(value.abs()) <= MAX_MAGNITUDE,
        "a step with random actions has the reward {reward:e}, of which `{name}` gives {value:e}; lower the term's weight: \
         rewards and their terms may be at most {MAX_MAGNITUDE:e}"
    );
    Ok(())
}

/// Actions of all agents, uniform in their ranges, `[A]`.
fn random_action(world: &dyn EnvironmentBatch, episode: u32, step: u32) -> Vec<f32> {
    let agents = (0..).zip(&world.description().agents);
    let draw = |(number, agent): (u32, &proto::AgentSpec)| {
        let key = Draw::of_action(0, episode, step, number);
        let mut rng = DrawKey::of(SEED, key).generator();
        let range = agent.action.low..agent.action.high;
        let width = range.end - range.start;
        (0..agent.action.size).map(|_| range.start + width * uniform(&mut rng)).collect::<Vec<_>>()
    };
    agents.flat_map(draw).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn terms_that_are_the_same_in_every_step_are_named_but_for_alive() {
        let names = ["forward_speed", "alive", "alive_2", "in_range"].map(str::to_owned);
        let mut trial = Trial::default();
        for (steps, speed) in [(1, 0.5), (2, 0.75)] {
            trial.note_terms(&[speed, 1.0, 2.0, 0.0]);
            trial.steps = steps;
            let found = trial.constant_terms(&names);
            assert_eq!(found.len(), steps as usize - 1, "{found:?}");
            assert!(found.iter().all(|line| line.contains("`in_range` was 0 in every step")));
        }
    }

    #[test]
    fn episodes_stop_in_a_step_after_which_the_time_is_over() {
        let mut world = super::super::world("walker2d-2x3").unwrap();
        let mut trial = Trial::default();
        trial.play_all(&mut *world, 20, &|| true).unwrap();
        assert_eq!((trial.episodes, trial.steps, trial.is_cut), (1, 1, true));
        let mut trial = Trial::default();
        trial.play_all(&mut *world, 2, &|| false).unwrap();
        assert_eq!((trial.episodes, trial.is_cut), (2, false));
    }
}
