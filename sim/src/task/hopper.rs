//! Hopper, the example of docs/ADDING_A_TASK.md: hop forwards without falling. Compiled only for tests.

use rand::RngCore;

use super::{Motion, Rules, Task, motion_features};
use crate::description::Feature;
use crate::noise;
use crate::robot::{DEFAULT_SOFTNESS, Integration, Neighbourhood, Robot, RobotRow};

const HOPPER: RobotRow = RobotRow {
    name: "hopper",
    mjcf: include_str!("../../assets/hopper.xml"),
    frame_skip: 4,
    neighbourhood: &Neighbourhood {
        edges: &[&["hip", "knee"]],
        touching: &[],
        globals: &["rootz.position", "rooty.position"],
    },
    integration: Integration::Euler,
    limits: DEFAULT_SOFTNESS,
    contacts: DEFAULT_SOFTNESS,
    margin: 0.0,
    contact_compliance: 0.1,
};

/// One agent for the hip, one for the knee.
pub(super) const TWO: Task = Task {
    name: "hopper-2x1",
    robot: &HOPPER,
    agents: &[&["hip"], &["knee"]],
    episode_steps: 1000,
    rules: &Hopper,
};

/// Lowest height of the torso while the hopper stands, m.
const LOWEST: f32 = 0.7;

struct Hopper;

impl Rules for Hopper {
    fn randomise(&self, rng: &mut dyn RngCore, coordinates: &mut [f32], velocities: &mut [f32]) {
        let mut rng = rng;
        for number in coordinates.iter_mut().chain(velocities) {
            *number += noise::symmetric(&mut rng, 0.005);
        }
    }

    /// `dx/dt + 1 - 0.001 sum a^2`.
    fn reward(&self, before: &Motion<'_>, after: &Motion<'_>, action: &[f32], dt_secs: f32) -> f32 {
        let speed = (after.position(0) - before.position(0)) / dt_secs;
        speed + 1.0 - 1e-3 * action.iter().map(|a| a * a).sum::<f32>()
    }

    /// The torso's height is 1.2 m at rest, where its coordinate is 0.
    fn terminated(&self, after: &Motion<'_>) -> bool {
        after.position(1) + 1.2 < LOWEST
    }

    fn state_features(&self, robot: &Robot) -> Vec<Feature> {
        motion_features(&robot.coordinate_names()[1..], robot.velocity_names())
    }

    fn state(&self, motion: &Motion<'_>, out: &mut [f32]) {
        let positions = motion.coordinates.len() - 1;
        for (index, to) in out[..positions].iter_mut().enumerate() {
            *to = motion.position(index + 1);
        }
        out[positions..positions + motion.velocities.len()].copy_from_slice(motion.velocities);
    }
}

#[cfg(test)]
mod tests {
    use crate::config::{
        ContactForces, ObservationConfig, ObservationMode, ObservationNorm, PartitionSemantics,
        RootView, TaskConfig,
    };
    use crate::environment_batch::{EnvironmentBatch, Outcome};
    use crate::simulation::environments;

    fn hopper(mode: ObservationMode) -> Box<dyn EnvironmentBatch> {
        let observation = ObservationConfig {
            mode,
            norm: ObservationNorm::None,
            nearest: 1,
            globals: RootView::Shown,
            contact_forces: ContactForces::Absent,
        };
        let partition = PartitionSemantics::Labels;
        let config = TaskConfig { task: "hopper-2x1".to_owned(), observation, partition };
        environments(&config, 1).unwrap()
    }

    #[test]
    fn the_example_task_runs_and_terminates_without_control() {
        let mut world = hopper(ObservationMode::FullId);
        assert_eq!((world.description().agents.len(), world.description().state.len()), (2, 9));
        world.reset(0, 0, 1000, [1; 32]).unwrap();
        let mut outcome = [Outcome::default()];
        let mut steps = 0;
        while !outcome[0].terminated {
            world.step(&[0.0, 0.0], &mut outcome).unwrap();
            steps += 1;
            assert!(steps < 500 && !outcome[0].truncated && !outcome[0].fault);
        }
        assert!(steps > 10);
    }

    #[test]
    fn an_agent_of_the_example_observes_its_joint_the_neighbouring_angle_and_the_root() {
        let world = hopper(ObservationMode::KNearest);
        let names = world.description().agents[1].observation.iter();
        let names: Vec<&str> = names.map(|feature| feature.name.as_str()).collect();
        let expected =
            ["knee.position", "knee.velocity", "hip.position", "rootz.position", "rooty.position"];
        assert_eq!(names, expected);
    }
}
