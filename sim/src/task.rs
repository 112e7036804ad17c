//! Tasks: a robot, its partition among agents, and the rules for starts, rewards and ends of episodes.

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

/// A task, without its settings.
pub(crate) struct Task {
    pub(crate) name: &'static str,
    pub(crate) robot: &'static RobotRow,
    /// The published joint names of each agent.
    pub(crate) agents: &'static [&'static [&'static str]],
    /// Steps after which an episode is truncated.
    pub(crate) episode_steps: u32,
    pub(crate) rules: &'static dyn Rules,
}

/// Start, reward, end and global state of an episode.
pub(crate) trait Rules: Sync {
    /// Adds the start noise to a rest pose `[nq]` with zero velocities `[nv]`.
    fn randomise(&self, rng: &mut dyn RngCore, coordinates: &mut [f32], velocities: &mut [f32]);
    /// Reward of one step. `action` has the actions of all agents in agent order, not clamped.
    fn reward(&self, before: &Motion<'_>, after: &Motion<'_>, action: &[f32], dt_secs: f32) -> f32;
    /// Whether the episode terminates for a reason other than its length.
    fn terminated(&self, after: &Motion<'_>) -> bool;
    /// Whether contact forces can be observed.
    fn feels_contacts(&self) -> bool {
        false
    }
    /// Features of the global state, without contact forces.
    fn state_features(&self, robot: &Robot) -> Vec<Feature>;
    /// Writes the global state, without contact forces, to the start of `out`.
    fn state(&self, motion: &Motion<'_>, out: &mut [f32]);
}

/// Coordinates, velocities and contact forces of a robot at one time.
#[derive(Clone, Copy)]
pub(crate) struct Motion<'a> {
    /// Relative to the rest pose `[nq]`.
    pub(crate) coordinates: &'a [f32],
    /// Offset from these coordinates to the model's own, `[nq]`.
    pub(crate) reference: &'a [f32],
    /// `[nv]`.
    pub(crate) velocities: &'a [f32],
    /// Contact forces on the model's bodies, `[bodies, 6]`, clipped; empty unless they are observed.
    pub(crate) contact_forces: &'a [f32],
}

impl Motion<'_> {
    /// A coordinate in the model's own frame, m or rad.
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
/// Names of the robots' tasks, then of the games.
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

/// Names of all tasks.
pub fn task_names() -> &'static [&'static str] {
    &NAMES
}

/// Finds a robot's task by its name.
pub(crate) fn find(name: &str) -> Result<&'static Task, SimError> {
    let found = TASKS.iter().find(|task| task.name == name);
    found.ok_or_else(|| SimError::UnknownTask {
        asked: name.to_owned(),
        nearest: nearest(name).to_owned(),
        known: NAMES.join(", "),
    })
}

impl Robot {
    /// Builds the robot of a task.
    ///
    /// # Errors
    /// If no robot has a task with this name.
    pub fn of_task(task: &str) -> Result<Self, SimError> {
        Self::build(find(task)?.robot)
    }
}

/// Features for the positions and velocities of the named joints.
pub(crate) fn motion_features(coordinates: &[String], velocities: &[String]) -> Vec<Feature> {
    let signal = |name| Feature { name, role: FeatureRole::Signal };
    let positions = coordinates.iter().map(|name| signal(format!("{name}.position")));
    positions.chain(velocities.iter().map(|name| signal(format!("{name}.velocity")))).collect()
}

fn nearest(name: &str) -> &'static str {
    NAMES.iter().min_by_key(|known| edit_distance(name, known)).copied().unwrap_or("")
}

/// Levenshtein distance: inserted, removed and changed characters.
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
    fn the_error_for_an_unknown_task_suggests_the_nearest_name() {
        let error = find("halfchetah-6x1").err().unwrap();
        assert!(error.to_string().contains("did you mean `halfcheetah-6x1`"), "{error}");
        assert_eq!(edit_distance("kitten", "sitting"), 3);
    }

    #[test]
    fn each_actuator_has_exactly_one_label_in_every_task() {
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
