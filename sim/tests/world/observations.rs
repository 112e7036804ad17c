//! Layouts, partitions and descriptions of the HalfCheetah tasks.

use crate::{config, environments, key, random_actions, seeded, step};
use proto::{EpisodePosition, FeatureRole};
use sim::SimError;

const STATE: [&str; 17] = [
    "rootz.position",
    "rooty.position",
    "bthigh.position",
    "bshin.position",
    "bfoot.position",
    "fthigh.position",
    "fshin.position",
    "ffoot.position",
    "rootx.velocity",
    "rootz.velocity",
    "rooty.velocity",
    "bthigh.velocity",
    "bshin.velocity",
    "bfoot.velocity",
    "fthigh.velocity",
    "fshin.velocity",
    "ffoot.velocity",
];

#[test]
fn every_task_has_its_published_sizes() {
    for (task, agents, actions) in
        [("halfcheetah-2x3", 2, 3), ("halfcheetah-3x2", 3, 2), ("halfcheetah-6x1", 6, 1)]
    {
        assert!(sim::task_names().contains(&task));
        let world = environments(task, 1);
        let description = world.description();
        assert_eq!(description.agents.len(), agents);
        assert_eq!((description.dt_secs, description.episode_steps), (0.05, 1000));
        assert_eq!(description.state_kind, "rapier/halfcheetah");
        assert_eq!(description.max_state_bytes as usize, world.encode(0).unwrap().len());
        let names: Vec<&str> = description.state.iter().map(|f| f.name.as_str()).collect();
        assert_eq!(names, STATE);
        for agent in &description.agents {
            assert_eq!(agent.observation.len(), 17 + agents);
            assert_eq!(agent.action.size, actions);
            assert_eq!((agent.action.low, agent.action.high), (-1.0, 1.0));
            assert!(agent.observation[..17].iter().all(|f| f.role == FeatureRole::Signal));
            assert!(agent.observation[17..].iter().all(|f| f.role == FeatureRole::Identity));
        }
    }
}

fn joints(task: &str) -> Vec<String> {
    let world = sim::environments(&config(task, "none"), 1).unwrap();
    world.description().agents.iter().map(|agent| agent.joints.join(" ")).collect()
}

#[test]
fn partitions_are_the_published_ones() {
    assert_eq!(joints("halfcheetah-2x3"), ["bthigh bshin bfoot", "fthigh fshin ffoot"]);
    assert_eq!(joints("halfcheetah-3x2"), ["bthigh bshin", "bfoot fthigh", "fshin ffoot"]);
    assert_eq!(joints("halfcheetah-6x1"), ["bthigh", "bshin", "bfoot", "fthigh", "fshin", "ffoot"]);
}

#[test]
fn in_full_id_all_agents_observe_the_same_signals() {
    for norm in ["none", "feature_z"] {
        let mut world = sim::environments(&config("halfcheetah-6x1", norm), 1).unwrap();
        let (mut rng, mut actions) = (seeded(4), [0.0; 6]);
        world.reset(0, 0, 1000, key(&mut rng)).unwrap();
        for _ in 0..50 {
            random_actions(&mut rng, &mut actions);
            step(&mut *world, &actions);
            let mut first = [0.0; 23];
            world.observation(0, 0, &mut first);
            for agent in 1..6 {
                let mut other = [0.0; 23];
                world.observation(0, agent, &mut other);
                assert_eq!(first[..17], other[..17]);
                assert_eq!((first[17], first[18]), (other[17 + agent], other[17]));
            }
            let mut state = [0.0; 17];
            world.state(0, &mut state);
            assert_eq!(state == first[..17], norm == "none");
        }
    }
}

#[test]
fn a_standardised_observation_has_mean_zero_and_deviation_one() {
    let mut world = environments("halfcheetah-2x3", 1);
    world.reset(0, 0, 1000, [12; 32]).unwrap();
    let mut seen = [0.0_f32; 19];
    world.observation(0, 1, &mut seen);
    let mean = seen.iter().sum::<f32>() / 19.0;
    let square = seen.iter().map(|x| x * x).sum::<f32>() / 19.0;
    assert!(mean.abs() < 1e-6 && (square - 1.0).abs() < 1e-5);
}

#[test]
fn start_noise_has_the_published_widths() {
    let mut world = environments("halfcheetah-2x3", 1);
    let mut rng = seeded(13);
    let (mut widest, mut square, episodes) = (0.0_f32, 0.0_f64, 500);
    for episode in 0..episodes {
        world.reset(0, episode, 1000, key(&mut rng)).unwrap();
        let state =
            sim::State::from_bytes(&world.encode(0).unwrap(), world.state_bounds().unwrap())
                .unwrap();
        assert_eq!(state.position, EpisodePosition { episode, step: 0, limit: 1000 });
        widest = state.coordinates.iter().fold(widest, |most, q| most.max(q.abs()));
        square += state.velocities.iter().map(|v| f64::from(v * v)).sum::<f64>();
    }
    assert!((0.099..=0.1).contains(&widest), "{widest}");
    let deviation = (square / (9.0 * episodes as f64)).sqrt();
    assert!((deviation - 0.1).abs() < 0.005, "{deviation}");
    world.reset(0, 1, 0, [14; 32]).unwrap();
    let outcome = step(&mut *world, &[0.0; 6]);
    assert!(outcome.truncated, "a limit of 0 is clamped to 1");
}

#[test]
fn the_reward_is_the_speed_minus_the_control_cost() {
    let mut world = environments("halfcheetah-2x3", 1);
    let before = crate::coordinates(world.world(0).unwrap())[0];
    let outcome = step(&mut *world, &[0.5, -0.5, 0.5, -0.5, 0.5, 2.0]);
    let speed = (crate::coordinates(world.world(0).unwrap())[0] - before) / 0.05;
    assert!((outcome.reward - (speed - 0.1 * 5.25)).abs() < 1e-5);
}

#[test]
fn unknown_tasks_and_empty_slots_are_rejected() {
    let unknown = sim::environments(&config("halfcheeta-2x3", "none"), 1).err().unwrap();
    assert!(unknown.to_string().contains("known tasks: "), "{unknown}");
    let none = sim::environments(&config("halfcheetah-2x3", "none"), 0).err().unwrap();
    assert!(matches!(none, SimError::NoEnvironments));
}

#[test]
fn poses_and_shapes_cover_every_link() {
    let world = environments("halfcheetah-2x3", 1);
    let pose = world.pose(0);
    assert_eq!(pose.links.len(), 7);
    assert_eq!(pose.joints.len(), 6);
    assert_eq!(pose.links[0].name, "torso");
    assert!((pose.links[0].position[2] - 0.7).abs() < 1e-6);
    let shapes = sim::Robot::of_task("halfcheetah-2x3").unwrap().shapes();
    assert_eq!(shapes.len(), 8);
    assert!(shapes.iter().all(|shape| pose.links.iter().any(|link| link.name == shape.link)));
}
