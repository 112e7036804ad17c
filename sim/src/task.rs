//! Tasks: a robot, who drives what, and the rules that start, pay and end an episode.

mod ant;
mod halfcheetah;
#[cfg(test)]
mod hopper;
mod walker2d;

use rand::RngCore;

use crate::description::{Feature, FeatureRole};
use crate::error::SimError;
use crate::game;
use crate::robot::{Robot, RobotRow};

/// One task: everything but what a caller configures.
pub(crate) struct Task {
    pub(crate) name: &'static str,
    pub(crate) robot: &'static RobotRow,
    /// The published joint names of each agent.
    pub(crate) agents: &'static [&'static [&'static str]],
    /// Steps after which an episode is truncated.
    pub(crate) episode_steps: u32,
    pub(crate) rules: &'static dyn Rules,
}

/// How an episode starts, what it pays, when it ends, and what its global state is.
pub(crate) trait Rules: Sync {
    /// Adds the start noise to a rest pose `[nq]` without motion `[nv]`.
    fn randomise(&self, rng: &mut dyn RngCore, coordinates: &mut [f32], velocities: &mut [f32]);
    /// The reward of one step; `action` is all agents' actions in agent order, not clamped.
    fn reward(&self, before: &Motion<'_>, after: &Motion<'_>, action: &[f32], dt_secs: f32) -> f32;
    /// Whether the episode is over for another reason than its length.
    fn terminated(&self, after: &Motion<'_>) -> bool;
    /// Whether contact forces may be part of what is observed.
    fn feels_contacts(&self) -> bool {
        false
    }
    /// The global state's features, contact forces apart.
    fn state_features(&self, robot: &Robot) -> Vec<Feature>;
    /// The global state, contact forces apart, into the first places of `out`.
    fn state(&self, motion: &Motion<'_>, out: &mut [f32]);
}

/// A robot's numbers at a moment.
#[derive(Clone, Copy)]
pub(crate) struct Motion<'a> {
    /// Relative to the rest pose `[nq]`.
    pub(crate) coordinates: &'a [f32],
    /// What a coordinate of 0 is in the model's own coordinates `[nq]`.
    pub(crate) reference: &'a [f32],
    /// `[nv]`.
    pub(crate) velocities: &'a [f32],
    /// What contacts do to the model's bodies, `[bodies, 6]`, clipped; empty unless the task is asked for it.
    pub(crate) contact_forces: &'a [f32],
}

impl Motion<'_> {
    /// A coordinate as the model counts it, m or rad.
    pub(crate) fn position(&self, index: usize) -> f32 {
        self.coordinates[index] + self.reference[index]
    }
}

const TASKS: &[Task] = &[
    halfcheetah::TWO,
    halfcheetah::THREE,
    halfcheetah::SIX,
    walker2d::TWO,
    walker2d::THREE,
    walker2d::SIX,
    ant::TWO,
    ant::TWO_DIAGONAL,
    ant::FOUR,
    ant::EIGHT,
    #[cfg(test)]
    hopper::TWO,
];
/// The robots' tasks, then the games.
const NAMES: [&str; TASKS.len() + 1] = names();

const fn names() -> [&'static str; TASKS.len() + 1] {
    let mut names = [game::cue::NAME; TASKS.len() + 1];
    let mut index = 0;
    while index < TASKS.len() {
        names[index] = TASKS[index].name;
        index += 1;
    }
    names
}

/// All tasks' names.
pub fn task_names() -> &'static [&'static str] {
    &NAMES
}

/// The robot's task of this name.
pub(crate) fn find(name: &str) -> Result<&'static Task, SimError> {
    let found = TASKS.iter().find(|task| task.name == name);
    found.ok_or_else(|| SimError::UnknownTask {
        asked: name.to_owned(),
        nearest: nearest(name).to_owned(),
        known: NAMES.join(", "),
    })
}

impl Robot {
    /// The robot of a task.
    ///
    /// # Errors
    /// If no robot has a task of this name.
    pub fn of_task(task: &str) -> Result<Self, SimError> {
        Self::build(find(task)?.robot)
    }
}

/// Positions and velocities of the named joints, as features.
pub(crate) fn motion_features(coordinates: &[String], velocities: &[String]) -> Vec<Feature> {
    let signal = |name| Feature { name, role: FeatureRole::Signal };
    let positions = coordinates.iter().map(|name| signal(format!("{name}.position")));
    positions.chain(velocities.iter().map(|name| signal(format!("{name}.velocity")))).collect()
}

fn nearest(name: &str) -> &'static str {
    NAMES.iter().min_by_key(|known| edit_distance(name, known)).copied().unwrap_or("")
}

/// Levenshtein's distance: inserted, removed and changed characters.
fn edit_distance(a: &str, b: &str) -> usize {
    let mut row: Vec<usize> = (0..=b.chars().count()).collect();
    for (i, x) in a.chars().enumerate() {
        let mut corner = std::mem::replace(&mut row[0], i + 1);
        for (j, y) in b.chars().enumerate() {
            let changed = corner + usize::from(x != y);
            corner = row[j + 1];
            row[j + 1] = changed.min(row[j] + 1).min(corner + 1);
        }
    }
    row.last().copied().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_task_is_answered_with_the_nearest_name() {
        let error = find("halfchetah-6x1").err().unwrap();
        assert!(error.to_string().contains("did you mean `halfcheetah-6x1`"), "{error}");
        assert_eq!(edit_distance("kitten", "sitting"), 3);
    }

    #[test]
    fn the_labels_of_every_task_name_each_actuator_of_its_robot_once() {
        for task in TASKS {
            let robot = Robot::build(task.robot).unwrap();
            let mut actuators: Vec<&str> = robot.actuators().collect();
            let mut labels: Vec<&str> = task.agents.concat();
            actuators.sort_unstable();
            labels.sort_unstable();
            assert_eq!(actuators, labels, "{}", task.name);
        }
    }
}
