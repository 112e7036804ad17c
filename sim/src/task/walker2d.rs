//! Walker2d: walk forwards without falling.

use rand::RngCore;

use super::{Motion, Rules, Task, motion_features};
use crate::description::Feature;
use crate::noise;
use crate::robot::{Robot, WALKER2D};

/// Right leg and left leg.
pub(super) const TWO: Task =
    task("walker2d-2x3", &[&["foot", "leg", "thigh"], &["foot_left", "leg_left", "thigh_left"]]);
/// Neighbours in the chain from one foot to the other.
pub(super) const THREE: Task =
    task("walker2d-3x2", &[&["foot", "leg"], &["thigh", "foot_left"], &["leg_left", "thigh_left"]]);
/// One joint per agent.
pub(super) const SIX: Task = task(
    "walker2d-6x1",
    &[&["foot"], &["leg"], &["thigh"], &["foot_left"], &["leg_left"], &["thigh_left"]],
);

const fn task(name: &'static str, agents: &'static [&'static [&'static str]]) -> Task {
    Task { name, robot: &WALKER2D, agents, episode_steps: 1000, rules: &Walker2d }
}

/// Cost per squared unit of action.
const CONTROL_COST: f32 = 1e-3;
/// Reward for every step, including the last.
const ALIVE: f32 = 1.0;
/// Half-width of the uniform noise on each start coordinate (m or rad) and velocity (m/s or rad/s).
const NOISE: f32 = 0.005;
/// Ranges of the torso's height (m) and pitch (rad) while the walker stands, bounds excluded.
const HEIGHT: [f32; 2] = [0.8, 2.0];
const LEAN: [f32; 2] = [-1.0, 1.0];
/// Observed velocities are clipped to this, m/s or rad/s.
const FASTEST_SEEN: f32 = 10.0;

struct Walker2d;

impl Rules for Walker2d {
    fn randomise(&self, rng: &mut dyn RngCore, coordinates: &mut [f32], velocities: &mut [f32]) {
        let mut rng = rng;
        for number in coordinates.iter_mut().chain(velocities) {
            *number += noise::symmetric(&mut rng, NOISE);
        }
    }

    /// `dx/dt + 1 - 0.001 sum a^2` with the action before clamping.
    fn reward(&self, before: &Motion<'_>, after: &Motion<'_>, action: &[f32], dt_secs: f32) -> f32 {
        let speed = (after.position(0) - before.position(0)) / dt_secs;
        speed + ALIVE - CONTROL_COST * action.iter().map(|a| a * a).sum::<f32>()
    }

    fn terminated(&self, after: &Motion<'_>) -> bool {
        let within = |value: f32, [low, high]: [f32; 2]| low < value && value < high;
        !(within(after.position(1), HEIGHT) && within(after.position(2), LEAN))
    }

    fn state_features(&self, robot: &Robot) -> Vec<Feature> {
        motion_features(&robot.coordinate_names()[1..], robot.velocity_names())
    }

    /// All coordinates except x, then all velocities, clipped.
    fn state(&self, motion: &Motion<'_>, out: &mut [f32]) {
        let positions = motion.coordinates.len() - 1;
        for (index, to) in out[..positions].iter_mut().enumerate() {
            *to = motion.position(index + 1);
        }
        for (to, velocity) in out[positions..].iter_mut().zip(motion.velocities) {
            *to = velocity.clamp(-FASTEST_SEEN, FASTEST_SEEN);
        }
    }
}
