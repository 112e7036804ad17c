//! Commands: their draws, who observes them, the reward that follows them, and refusals.

use super::{HOPPER, Outcome, config, environments, hopper, refusal};
use crate::config::ObservationMode;
use crate::environment_batch::Disturbances;
use crate::robot::Robot;
use crate::task::Motion;
use crate::task::command::{CommandRanges, CommandRow, Heading};
use crate::task::terms::{Tilt, upright};

const FORWARD: &str = "\n[command]\nforward = [0.5, 2.0]\n";

/// Index of the command in the global state of the example.
const COMMAND: usize = 9;
/// Index of the speed along x.
const SPEED: usize = 4;

#[test]
fn a_command_is_drawn_per_episode_and_observed_by_critic_and_agents() {
    for mode in [ObservationMode::FullId, ObservationMode::KNearest] {
        let mut world = environments(&config(&format!("{HOPPER}{FORWARD}"), mode), 1).unwrap();
        assert_eq!(world.description().state[COMMAND].name, "command.forward");
        let mut drawn = Vec::new();
        for key in 1..10 {
            world.set_disturbances(Disturbances::Off);
            world.reset(0, 0, 1000, [key; 32]).unwrap();
            let command = world.state_of(0)[COMMAND];
            assert!((0.5..2.0).contains(&command), "{command}");
            let mut outcome = [Outcome::default()];
            world.step(&[0.1, 0.2], &mut outcome).unwrap();
            assert_eq!(world.state_of(0)[COMMAND], command);
            for (agent, observation) in world.observations_of(0).iter().enumerate() {
                let mut features = world.description().agents[agent].observation.iter();
                let place = features.position(|feature| feature.name == "command.forward");
                assert_eq!(observation[place.unwrap()], command);
            }
            drawn.push(command);
        }
        drawn.dedup();
        assert_eq!(drawn.len(), 9);
    }
}

/// The example with this reward instead of its own.
fn rewarded(term: &str, command: &str) -> String {
    let kept = HOPPER.find("\n[[reward]]").unwrap()..HOPPER.find("\n[[healthy]]").unwrap();
    let mut file = HOPPER.to_owned();
    file.replace_range(kept, &format!("\n[[reward]]\nweight = 2.0\n{term}\n\n"));
    format!("{file}{command}")
}

#[test]
fn velocity_tracking_is_the_exponential_of_the_squared_error() {
    let mut world = hopper(&rewarded("term = \"velocity_tracking\"\nsigma = 0.5", FORWARD));
    world.reset(0, 0, 1000, [3; 32]).unwrap();
    let mut outcome = [Outcome::default()];
    for _ in 0..10 {
        world.step(&[0.5, -0.5], &mut outcome).unwrap();
        let state = world.state_of(0);
        let error = f64::from(state[SPEED] - state[COMMAND]);
        let expected = 2.0 * libm::exp(-error * error / 0.25);
        assert!((f64::from(outcome[0].reward) - expected).abs() < 1e-6, "{outcome:?}");
    }
}

/// Velocity and cosine of the tilt of an Ant's root, or of this body, if the root has this orientation (w x y z), moves at
/// (1, 2, 0) m/s in the world and turns at 3 rad/s.
fn velocities(quaternion: [f32; 4], of: Option<&str>) -> ([f32; 3], f32) {
    let robot = Robot::of_task("ant-2x4").unwrap();
    let row: CommandRow =
        toml::from_str("forward = [0, 1]\nsideways = [0, 1]\nyaw = [0, 1]").unwrap();
    let command = CommandRanges::new(&row, &robot).unwrap();
    let command = of.map_or(command.clone(), |body| command.of("term", body, &robot).unwrap());
    let mut coordinates = robot.rest().to_vec();
    coordinates[3..7].copy_from_slice(&quaternion);
    let mut velocities = vec![0.0; robot.velocity_names().len()];
    velocities[..6].copy_from_slice(&[1.0, 2.0, 0.0, 0.0, 0.0, 3.0]);
    let motion =
        Motion { coordinates: &coordinates, reference: robot.reference(), velocities: &velocities };
    let headings = [Heading::Forward, Heading::Sideways, Heading::Yaw];
    let tilt = upright(&motion, &Tilt::new("term", of, &robot).unwrap());
    (headings.map(|part| command.velocity(part, &motion)), tilt)
}

#[test]
fn a_bodys_velocity_is_that_in_its_heading_and_its_tilt_that_of_its_z_axis() {
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let sine = 0.75_f32.sqrt();
    for (quaternion, expected, cosine) in [
        ([1.0, 0.0, 0.0, 0.0], [1.0, 2.0, 3.0], 1.0),
        // Turned by 90 degrees to the left, it faces along y, and x is to its right.
        ([half, 0.0, 0.0, half], [2.0, -1.0, 3.0], 1.0),
        // Pitched by 60 degrees, it still faces along x.
        ([sine, 0.0, 0.5, 0.0], [1.0, 2.0, 3.0], 0.5),
    ] {
        for of in [None, Some("torso")] {
            let (velocities, tilt) = velocities(quaternion, of);
            for (velocity, expected) in velocities.iter().zip(expected) {
                assert!((velocity - expected).abs() < 1e-5, "{quaternion:?} {of:?}: {velocity}");
            }
            assert!((tilt - cosine).abs() < 1e-6, "{quaternion:?} {of:?}: {tilt}");
        }
    }
}

#[test]
fn invalid_commands_and_terms_are_refused_with_their_key() {
    let tracking = "term = \"velocity_tracking\"";
    for (term, command, part) in [
        ("term = \"alive\"", "[command]\nforward = [2, 1]", "command.forward must be [low, high]"),
        (
            "term = \"alive\"",
            "[command]\nsideways = [0, 1]",
            "command.sideways needs a robot with a free joint",
        ),
        ("term = \"alive\"\nsigma = 1.0", "", "reward.alive has no key `sigma`"),
        (tracking, FORWARD, "reward.velocity_tracking needs the key `sigma`"),
        (
            "term = \"velocity_tracking\"\nsigma = 0.0",
            FORWARD,
            "reward.velocity_tracking.sigma must lie in 0.001..=1000, is 0",
        ),
        (
            "term = \"velocity_tracking\"\nsigma = 0.5",
            "",
            "reward.velocity_tracking follows nothing: state a range in [command]",
        ),
        (
            "term = \"velocity_tracking\"\nsigma = 0.5\nof = \"torsoo\"",
            FORWARD,
            "reward.velocity_tracking.of: the robot has no body `torsoo`; did you mean `torso`?",
        ),
        (
            "term = \"alive\"",
            "[command]\nof = \"world\"\nforward = [0, 1]",
            "command needs a free root or a planar root (slides along x and z and a hinge about y",
        ),
        (
            "term = \"velocity_tracking\"\nsigma = 0.5\ncomponents = [\"yaw\"]",
            FORWARD,
            "reward.velocity_tracking: [command] has no range `yaw`",
        ),
    ] {
        let message = refusal(&rewarded(term, &format!("\n{command}\n")));
        assert!(message.contains(part) && !message.contains('\n'), "{command}: {message}");
    }
}
