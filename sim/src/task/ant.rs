//! Ant: run along +x on four legs without falling.

use rand::RngCore;
use rapier3d::math::{Rotation, Vector};

use super::{Motion, Rules, Task, motion_features};
use crate::description::Feature;
use crate::noise;
use crate::robot::{ANT, Robot};

/// Two neighbouring legs per agent.
pub(super) const TWO: Task = task(
    "ant-2x4",
    &[&["hip_1", "ankle_1", "hip_2", "ankle_2"], &["hip_3", "ankle_3", "hip_4", "ankle_4"]],
);
/// Two opposite legs per agent.
pub(super) const TWO_DIAGONAL: Task = task(
    "ant-2x4d",
    &[&["hip_1", "ankle_1", "hip_3", "ankle_3"], &["hip_2", "ankle_2", "hip_4", "ankle_4"]],
);
/// One leg per agent.
pub(super) const FOUR: Task = task(
    "ant-4x2",
    &[&["hip_1", "ankle_1"], &["hip_2", "ankle_2"], &["hip_3", "ankle_3"], &["hip_4", "ankle_4"]],
);
/// One joint per agent.
pub(super) const EIGHT: Task = task(
    "ant-8x1",
    &[
        &["hip_1"],
        &["ankle_1"],
        &["hip_2"],
        &["ankle_2"],
        &["hip_3"],
        &["ankle_3"],
        &["hip_4"],
        &["ankle_4"],
    ],
);

const fn task(name: &'static str, agents: &'static [&'static [&'static str]]) -> Task {
    Task { name, robot: &ANT, agents, episode_steps: 1000, rules: &Ant }
}

/// Cost per squared unit of action.
const CONTROL_COST: f32 = 0.5;
/// Cost per squared newton or newton metre of contact, if contacts are observed.
const CONTACT_COST: f32 = 5e-4;
/// Reward for every step, including the last.
const ALIVE: f32 = 1.0;
/// Half-width of the uniform noise on each start coordinate, m or rad.
const POSITION_NOISE: f32 = 0.1;
/// Standard deviation of the normal noise on each start velocity, m/s or rad/s.
const VELOCITY_NOISE: f32 = 0.1;
/// Range of the torso's height while the robot stands, m, bounds included.
const HEIGHT: [f32; 2] = [0.2, 1.0];

/// Indices of the torso's quaternion (w x y z) in the coordinates and of its angular velocity in the velocities.
const QUATERNION: std::ops::Range<usize> = 3..7;
const TURNING: std::ops::Range<usize> = 3..6;

struct Ant;

impl Rules for Ant {
    fn randomise(&self, rng: &mut dyn RngCore, coordinates: &mut [f32], velocities: &mut [f32]) {
        let mut rng = rng;
        for coordinate in coordinates.iter_mut() {
            *coordinate += noise::symmetric(&mut rng, POSITION_NOISE);
        }
        let length = coordinates[QUATERNION].iter().map(|q| q * q).sum::<f32>().sqrt();
        coordinates[QUATERNION].iter_mut().for_each(|q| *q /= length);
        for velocity in velocities {
            *velocity += VELOCITY_NOISE * noise::normal(&mut rng);
        }
    }

    /// `dx/dt + 1 - 0.5 sum a^2 - 0.0005 sum c^2` with the action `a` before clamping and the observed contact forces
    /// `c`.
    fn reward(&self, before: &Motion<'_>, after: &Motion<'_>, action: &[f32], dt_secs: f32) -> f32 {
        let squares = |numbers: &[f32]| numbers.iter().map(|x| x * x).sum::<f32>();
        let speed = (after.position(0) - before.position(0)) / dt_secs;
        let cost = CONTROL_COST * squares(action) + CONTACT_COST * squares(after.contact_forces);
        speed + ALIVE - cost
    }

    fn terminated(&self, after: &Motion<'_>) -> bool {
        !(HEIGHT[0]..=HEIGHT[1]).contains(&after.position(2))
    }

    fn feels_contacts(&self) -> bool {
        true
    }

    fn state_features(&self, robot: &Robot) -> Vec<Feature> {
        motion_features(&robot.coordinate_names()[2..], robot.velocity_names())
    }

    /// All coordinates except x and y, then all velocities. The torso's angular velocity is in its own axes.
    fn state(&self, motion: &Motion<'_>, out: &mut [f32]) {
        let positions = motion.coordinates.len() - 2;
        for (index, to) in out[..positions].iter_mut().enumerate() {
            *to = motion.position(index + 2);
        }
        let velocities = &mut out[positions..][..motion.velocities.len()];
        velocities.copy_from_slice(motion.velocities);
        let [w, x, y, z] = std::array::from_fn(|k| motion.coordinates[QUATERNION.start + k]);
        let [a, b, c] = std::array::from_fn(|k| motion.velocities[TURNING.start + k]);
        let turning = Rotation::from_xyzw(x, y, z, w).inverse() * Vector::new(a, b, c);
        velocities[TURNING].copy_from_slice(&turning.to_array());
    }
}
