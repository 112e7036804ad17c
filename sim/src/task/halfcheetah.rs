//! HalfCheetah: run forwards at a low control cost. Episodes never terminate before their limit.

use rand::RngCore;

use super::{Motion, Rules, Task, motion_features};
use crate::description::Feature;
use crate::noise;
use crate::robot::{HALFCHEETAH, Robot};

/// Back leg and front leg.
pub(super) const TWO: Task =
    task("halfcheetah-2x3", &[&["bfoot", "bshin", "bthigh"], &["ffoot", "fshin", "fthigh"]]);
/// Neighbours in the chain from one foot to the other.
pub(super) const THREE: Task =
    task("halfcheetah-3x2", &[&["bfoot", "bshin"], &["bthigh", "ffoot"], &["fshin", "fthigh"]]);
/// One joint per agent.
pub(super) const SIX: Task = task(
    "halfcheetah-6x1",
    &[&["bfoot"], &["bshin"], &["bthigh"], &["ffoot"], &["fshin"], &["fthigh"]],
);

const fn task(name: &'static str, agents: &'static [&'static [&'static str]]) -> Task {
    Task { name, robot: &HALFCHEETAH, agents, episode_steps: 1000, rules: &HalfCheetah }
}

/// Cost per squared unit of action.
const CONTROL_COST: f32 = 0.1;
/// Half-width of the uniform noise on each start coordinate, m or rad.
const POSITION_NOISE: f32 = 0.1;
/// Standard deviation of the normal noise on each start velocity, m/s or rad/s.
const VELOCITY_NOISE: f32 = 0.1;

struct HalfCheetah;

impl Rules for HalfCheetah {
    fn randomise(&self, rng: &mut dyn RngCore, coordinates: &mut [f32], velocities: &mut [f32]) {
        let mut rng = rng;
        for coordinate in coordinates {
            *coordinate += noise::symmetric(&mut rng, POSITION_NOISE);
        }
        for velocity in velocities {
            *velocity += VELOCITY_NOISE * noise::normal(&mut rng);
        }
    }

    /// `dx/dt - 0.1 sum a^2` with the action before clamping.
    fn reward(&self, before: &Motion<'_>, after: &Motion<'_>, action: &[f32], dt_secs: f32) -> f32 {
        let speed = (after.position(0) - before.position(0)) / dt_secs;
        speed - CONTROL_COST * action.iter().map(|a| a * a).sum::<f32>()
    }

    fn terminated(&self, _after: &Motion<'_>) -> bool {
        false
    }

    fn state_features(&self, robot: &Robot) -> Vec<Feature> {
        motion_features(&robot.coordinate_names()[1..], robot.velocity_names())
    }

    /// All coordinates except x, then all velocities.
    fn state(&self, motion: &Motion<'_>, out: &mut [f32]) {
        let positions = motion.coordinates.len() - 1;
        for (index, to) in out[..positions].iter_mut().enumerate() {
            *to = motion.position(index + 1);
        }
        out[positions..positions + motion.velocities.len()].copy_from_slice(motion.velocities);
    }
}
