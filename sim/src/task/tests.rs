//! Task files: the example, the terms by hand, and refusals.

mod activations;
mod balls;
mod bodies;
mod commands;
mod disturbances;
mod hostile;
mod own_models;
mod physics;
mod reward_terms;
mod starts;
mod values;

use super::*;
use crate::config::{ContactForces, ObservationConfig, ObservationMode, ObservationNorm, RootView};
use crate::environment_batch::environments;
use crate::environment_batch::{EnvironmentBatch, Outcome};
use crate::robot::{JointPlan, Law, Reference, Softness};

const HOPPER: &str = include_str!("../../assets/hopper.toml");

fn config(file: &str, mode: ObservationMode) -> TaskConfig {
    let observation = ObservationConfig {
        mode,
        norm: ObservationNorm::None,
        nearest: 1,
        globals: RootView::Shown,
        contact_forces: ContactForces::Absent,
    };
    let model = include_str!("../../assets/hopper.xml").to_owned();
    TaskConfig {
        task: "hopper-2x1".to_owned(),
        definition: Some(TaskDefinition { file: file.to_owned(), model }),
        weights: None,
        observation,
    }
}

fn hopper(file: &str) -> Box<dyn EnvironmentBatch> {
    environments(&config(file, ObservationMode::FullId), 1).unwrap()
}

fn changed(from: &str, to: &str) -> String {
    assert!(HOPPER.contains(from), "{from}");
    HOPPER.replacen(from, to, 1)
}

fn refusal(file: &str) -> String {
    environments(&config(file, ObservationMode::FullId), 1).err().expect(file).to_string()
}

#[test]
fn the_error_for_an_unknown_task_names_the_known_ones() {
    let config = TaskConfig {
        task: "halfchetah-6x1".to_owned(),
        definition: None,
        ..config(HOPPER, ObservationMode::FullId)
    };
    let error = find(&config).err().unwrap();
    let start = "there is no task `halfchetah-6x1`; known tasks: halfcheetah-2x3, ";
    assert!(error.to_string().starts_with(start), "{error}");
}

#[test]
fn every_task_of_the_program_can_be_built() {
    for &task in task_names().iter().filter(|name| !game::NAMES.contains(*name)) {
        let named = TaskConfig {
            task: task.to_owned(),
            definition: None,
            ..config(HOPPER, ObservationMode::KNearest)
        };
        assert_eq!(find(&named).unwrap().name, task);
    }
}

#[test]
fn the_example_task_runs_and_terminates_without_control() {
    let mut world = hopper(HOPPER);
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
    let expected =
        ["knee.position", "knee.velocity", "hip.position", "rootz.position", "rooty.position"];
    assert_eq!(observed_by(1, HOPPER), expected);
}

#[test]
fn no_agent_observes_a_hidden_angle_of_a_driven_joint() {
    let file = changed("hidden = [\"rootx\"]", "hidden = [\"rootx\", \"hip\"]");
    assert_eq!(observed_by(0, &file)[..2], ["hip.velocity", "knee.position"]);
    let expected = ["knee.position", "knee.velocity", "rootz.position", "rooty.position"];
    assert_eq!(observed_by(1, &file), expected);
    assert_eq!(hopper(&file).description().state.len(), 8);
}

/// Names of what an agent of this task file observes of its neighbourhood.
fn observed_by(agent: usize, file: &str) -> Vec<String> {
    let world = environments(&config(file, ObservationMode::KNearest), 1).unwrap();
    world.description().agents[agent].observation.iter().map(|own| own.name.clone()).collect()
}

/// Rewards of two steps with the actions (1, -1) and (0.5, 0) under one `[[reward]]` of weight 1.
fn rewards(term: &str) -> [f32; 2] {
    let kept = HOPPER.find("\n[[reward]]").unwrap()..HOPPER.find("\n[[healthy]]").unwrap();
    let mut file = HOPPER.to_owned();
    file.replace_range(kept, &format!("\n[[reward]]\nweight = 1.0\n{term}\n\n"));
    let mut world = hopper(&file);
    [[1.0, -1.0], [0.5, 0.0]].map(|action| {
        let mut outcome = [Outcome::default()];
        world.step(&action, &mut outcome).unwrap();
        outcome[0].reward
    })
}

#[test]
fn terms_of_actions_are_sums_of_squares() {
    assert_eq!(rewards("term = \"control\""), [2.0, 0.25]);
    // (1, -1) - (0, 0), then (0.5, 0) - (1, -1).
    assert_eq!(rewards("term = \"action_rate\""), [2.0, 1.25]);
    assert_eq!(rewards("term = \"alive\""), [1.0, 1.0]);
}

/// The example with these control ranges of hip and knee and these agents, and the reward `control`.
fn ranged([hip, knee]: [&str; 2], agents: &str) -> Box<dyn EnvironmentBatch> {
    let mut file = HOPPER.replace("2x1 = [[\"hip\"], [\"knee\"]]", &format!("2x1 = {agents}"));
    let rewards = file.find("\n[[reward]]").unwrap()..file.find("\n[[healthy]]").unwrap();
    file.replace_range(rewards, "\n[[reward]]\nterm = \"control\"\nweight = 1.0\n");
    let mut config = config(&file, ObservationMode::FullId);
    let model = &mut config.definition.as_mut().unwrap().model;
    for (joint, range) in [("hip", hip), ("knee", knee)] {
        let motor = format!("<motor name=\"{joint}\"");
        assert!(model.contains(&motor));
        *model = model.replace(&motor, &format!("{motor} ctrlrange=\"{range}\""));
    }
    environments(&config, 1).unwrap()
}

/// Reward and torques of hip and knee, whose gears are 80, for an action.
fn driven(world: &mut dyn EnvironmentBatch, action: [f32; 2]) -> (f32, [f32; 2]) {
    let mut outcome = [Outcome::default()];
    world.step(&action, &mut outcome).unwrap();
    let torques: Vec<f32> = world.world(0).unwrap().efforts().collect();
    (outcome[0].reward, [torques[0], torques[1]])
}

#[test]
fn an_action_of_minus_one_or_one_is_an_end_of_the_control_range_of_its_motor() {
    let several = "[[\"hip\", \"knee\"]]";
    for (ranges, agents, action, controls) in [
        (["-0.5 0.5", "2 10"], several, [0.5, -0.25], [0.25, 5.0]),
        (["-0.5 0.5", "2 10"], several, [-1.0, 1.0], [-0.5, 10.0]),
        (["0 10", "0 10"], several, [0.0, -1.0], [5.0, 0.0]),
        (["-80 80", "-80 80"], several, [0.25, 1.0], [20.0, 80.0]),
        (["-4 12", "0 10"], "[[\"hip\"], [\"knee\"]]", [0.5, 0.5], [8.0, 7.5]),
        // Agents act in the order of their lists, not of the motors.
        (["-4 12", "0 10"], "[[\"knee\"], [\"hip\"]]", [0.5, -0.5], [0.0, 7.5]),
    ] {
        let mut world = ranged(ranges, agents);
        for agent in &world.description().agents {
            assert_eq!((agent.action.low, agent.action.high), (-1.0, 1.0));
        }
        let [hip, knee] = controls;
        // The gears are 80, and the reward is the sum of the squared controls.
        let expected = (hip * hip + knee * knee, [80.0 * hip, 80.0 * knee]);
        assert_eq!(driven(&mut *world, action), expected, "{ranges:?}");
    }
    // Controls -1 and 18, clamped to -0.5 and 10 for the torque, not for the reward.
    let mut world = ranged(["-0.5 0.5", "2 10"], several);
    assert_eq!(driven(&mut *world, [-2.0, 3.0]), (325.0, [-40.0, 800.0]));
}

#[test]
fn a_motor_of_gear_80_and_one_of_gear_1_with_80_times_the_control_range_are_the_same() {
    let uncosted = changed("weight = 1e-3", "weight = 0.0");
    let [strong, wide] = ["gear=\"80\"", "gear=\"1\" ctrlrange=\"-80 80\""].map(|motor| {
        let mut config = config(&uncosted, ObservationMode::FullId);
        let model = &mut config.definition.as_mut().unwrap().model;
        *model = model.replace("gear=\"80\"", motor);
        let mut world = environments(&config, 1).unwrap();
        world.reset(0, 0, 1000, [1; 32]).unwrap();
        let mut trace = Vec::new();
        for action in [[0.3, -0.7], [1.5, 0.1], [-0.4, 0.9]] {
            let mut outcome = [Outcome::default()];
            world.step(&action, &mut outcome).unwrap();
            let mut state = vec![0.0; world.description().state.len()];
            world.state(0, &mut state);
            trace.push((outcome[0].reward, state));
        }
        trace
    });
    assert_eq!(strong, wide);
}

#[test]
fn the_controls_of_all_robots_can_be_explored_and_those_of_the_published_runs_are_actions() {
    for &task in task_names().iter().filter(|name| !game::NAMES.contains(*name)) {
        let robot = Robot::of_task(task).unwrap();
        let is_action = robot.blueprint.motors.iter().all(|motor| motor.range == [-1.0, 1.0]);
        assert_eq!(is_action, robot.blueprint.law != Law::Constraints, "{task}");
        let named = TaskConfig {
            task: task.to_owned(),
            definition: None,
            ..config(HOPPER, ObservationMode::FullId)
        };
        let world = environments(&named, 1).unwrap();
        let of_motors = |line: &String| line.starts_with("the motor of");
        assert!(!world.warnings().iter().any(of_motors), "{task}: {:?}", world.warnings());
    }
}

#[test]
fn a_root_of_three_joints_in_another_order_is_a_chain_of_links_without_masses() {
    let mut config = config(HOPPER, ObservationMode::FullId);
    let model = &mut config.definition.as_mut().unwrap().model;
    let slides = [
        "name=\"rootx\" type=\"slide\" axis=\"1 0 0\"",
        "name=\"rootz\" type=\"slide\" axis=\"0 0 1\"",
    ];
    *model = model
        .replace(slides[0], "x")
        .replace(slides[1], slides[0])
        .replace("<joint x", &format!("<joint {}", slides[1]));
    let file = &mut config.definition.as_mut().unwrap().file;
    let term = "term = \"forward_speed\"";
    *file = file.replacen(term, &format!("{term}\ncoordinate = \"rootx\""), 1);
    let mut world = environments(&config, 1).unwrap();
    let names = world.description().state.iter().map(|feature| feature.name.as_str());
    assert_eq!(names.take(2).collect::<Vec<_>>(), ["rootz.position", "rooty.position"]);
    let mut outcome = [Outcome::default()];
    (0..20).for_each(|_| world.step(&[0.0, 0.0], &mut outcome).unwrap());
    assert!(!outcome[0].fault && outcome[0].reward > 0.0, "{outcome:?}");
}

#[test]
fn terms_of_the_motion_describe_a_hopper_that_stands() {
    let speed = rewards("term = \"forward_speed\"");
    let height = rewards("term = \"forward_speed\"\ncoordinate = \"rootz\"");
    assert!(speed != height && speed[0].abs() < 1.0 && height[0].abs() < 1.0);
    let of_all = rewards("term = \"mass_centre_speed\"");
    assert!(of_all != speed && of_all[0].abs() < 1.0);
    let upright = rewards("term = \"upright\"")[0];
    assert!(upright > 0.99 && upright <= 1.0, "{upright}");
    let within =
        |range| rewards(&format!("term = \"in_range\"\ncoordinate = \"rootz\"\nrange = {range}"));
    assert_eq!((within("[-0.5, 0.5]"), within("[0.5, 1.0]")), ([1.0; 2], [0.0; 2]));
    // A target 3 m ahead and 4 m up is 5 m away.
    let distance = rewards("term = \"target_distance\"\ntarget = { rootx = 3.0, rootz = 4.0 }")[0];
    assert!((distance - 5.0).abs() < 0.1, "{distance}");
}

/// Integrator, softness of the first contact and limit, margin and law of the example's robot, whose model states its own,
/// with these lines under `[physics]`.
fn physics(lines: &str) -> String {
    let geom = "<geom type=\"capsule\"";
    let soft = "solref=\"0.03 1\" solimp=\"0.8 0.85 0.002\" margin=\"0.004\"";
    let joint = "solreflimit=\"0.05 1\" solimplimit=\"0.7 0.75 0.03\"";
    let model = include_str!("../../assets/hopper.xml")
        .replace("<option ", "<option integrator=\"RK4\" ")
        .replace(geom, &format!("{geom} {soft}"))
        .replace("<joint axis", &format!("<joint {joint} axis"));
    let file = TaskFile::parse(&format!("{HOPPER}\n[physics]\n{lines}")).unwrap();
    let robot = Robot::build(file.robot_row(model)).unwrap();
    let blueprint = &robot.blueprint;
    let contact = blueprint.shapes().find_map(|shape| blueprint.floor_contact(shape)).unwrap();
    let limit = blueprint.links.iter().find_map(|link| match &link.joint {
        JointPlan::Hinge(hinge) => Some(hinge.limit),
        _ => None,
    });
    let softness = |Softness { reference, impedance: [first, last], width, .. }: Softness| {
        let Reference::Timed { time_constant_secs, .. } = reference else {
            panic!("{reference:?}")
        };
        format!("{time_constant_secs} {first} {last} {width}")
    };
    let [contacts, limits] = [contact.softness, limit.unwrap()].map(softness);
    let (integration, margin) = (blueprint.integration, contact.margin);
    format!("{integration:?}, {contacts}, {limits}, {margin}, {:?}", blueprint.law)
}

#[test]
fn every_physics_key_is_optional_and_replaces_only_its_number_of_the_model() {
    // The plane has the softness and margin of its class, the capsules' one: margins add up.
    assert_eq!(
        physics(""),
        "RungeKutta, 0.03 0.8 0.85 0.002, 0.05 0.7 0.75 0.03, 0.008, Constraints"
    );
    for (line, expected) in [
        (
            "integration = \"euler\"",
            "Euler, 0.03 0.8 0.85 0.002, 0.05 0.7 0.75 0.03, 0.008, Constraints",
        ),
        (
            "contacts.width = 0.1",
            "RungeKutta, 0.03 0.8 0.85 0.1, 0.05 0.7 0.75 0.03, 0.008, Constraints",
        ),
        (
            "limits = { impedance = [0.0, 0.9], time_constant_secs = 0.5 }",
            "RungeKutta, 0.03 0.8 0.85 0.002, 0.5 0 0.9 0.03, 0.008, Constraints",
        ),
        ("margin = 0.0", "RungeKutta, 0.03 0.8 0.85 0.002, 0.05 0.7 0.75 0.03, 0, Constraints"),
        (
            "contact_compliance = 0.5",
            "RungeKutta, 0.03 0.8 0.85 0.002, 0.05 0.7 0.75 0.03, 0.008, Engine { compliance: 0.5 }",
        ),
    ] {
        assert_eq!(physics(line), expected, "{line}");
    }
    let refusal = TaskFile::parse(&format!("{HOPPER}\n[physics]\nlimits.width = 0.0")).err();
    assert!(refusal.unwrap().to_string().contains("physics.limits.width must lie in"));
}

#[test]
fn a_restored_state_continues_a_reward_that_reads_the_last_action() {
    let file = changed("term = \"control\"", "term = \"action_rate\"");
    let (mut first, mut second) = (hopper(&file), hopper(&file));
    let mut outcome = [Outcome::default()];
    first.step(&[0.7, -0.2], &mut outcome).unwrap();
    second.restore(0, &first.encode(0).unwrap()).unwrap();
    let mut again = [Outcome::default()];
    first.step(&[0.1, 0.3], &mut outcome).unwrap();
    second.step(&[0.1, 0.3], &mut again).unwrap();
    let difference = (outcome[0].reward - again[0].reward).abs();
    // The weight is 0.001 and the squares sum to 0.61: a forgotten action would differ by 0.0005.
    assert!(difference < 1e-4, "{difference}");
}

#[test]
fn an_invalid_file_is_refused_with_its_key_and_the_nearest_valid_name() {
    for (from, to, parts) in [
        (
            "frame_skip = 4",
            "fram_skip = 4",
            &["line 5", "`fram_skip`", "did you mean `frame_skip`?"][..],
        ),
        ("frame_skip = 4", "frame_skip = 0", &["frame_skip must lie in 1..=1000, is 0"]),
        ("frame_skip = 4", "frame_skip = -4", &["`-4`, expected a whole number from 1 to 1000"]),
        (
            "frame_skip = 4",
            "frame_skip = 99999999999",
            &["`frame_skip`: ", "expected a whole number from 1 to 1000"],
        ),
        ("robot = \"hopper\"", "robot = \"../x\"", &["robot must be", "`../x`"]),
        ("\"alive\"", "\"alife\"", &["`alife`", "did you mean `alive`?"]),
        ("[\"knee\"]]", "[\"kne\"]]", &["agents: ", "`kne`; did you mean `knee`?"]),
        ("[\"knee\"]]", "[\"hip\"]]", &["agents: `hip` stands for an actuator that"]),
        (", [\"knee\"]]", "]", &["agents: the joint `knee` belongs to no agent"]),
        (", [\"knee\"]]", ", []]", &["agents: agent 1 has no joint"]),
        ("weight = 1e-3", "weight = nan", &["cost.control.weight must lie in -1e9..=1e9"]),
        ("weight = 1e-3", "weight = 1e-3\nrange = [0, 1]", &["cost.control has no key `range`"]),
        (
            "term = \"alive\"",
            "term = \"in_range\"",
            &["reward.in_range needs the key `coordinate`"],
        ),
        ("\"rootz\"", "\"rotz\"", &["healthy.coordinate", "`rotz`; did you mean `rootz`?"]),
        ("at_least = -0.5", "at_least = 1.0\nat_most = 0.5", &["healthy.rootz: the lower bound 1"]),
        ("at_least = -0.5", "", &["healthy.rootz needs a bound"]),
        ("at_least = -0.5", "at_least = inf", &["healthy.rootz.at_least must lie in"]),
        (
            "velocities = { uniform",
            "velocities = { even",
            &["`even`, expected `uniform` or `normal`"],
        ),
        (
            "\"rooty.position\"",
            "\"rooty.positions\"",
            &["neighbourhood.globals", "did you mean `rooty.position`?"],
        ),
        (
            "hidden = [",
            "angular_velocity = \"body\"\nhidden = [",
            &["state.angular_velocity = \"body\" needs a robot with a free joint"],
        ),
        (
            "hidden = [",
            "linear_velocity = \"body\"\nhidden = [",
            &["state.linear_velocity = \"body\" needs a robot with a free joint"],
        ),
    ] {
        let message = refusal(&changed(from, to));
        assert!(parts.iter().all(|part| message.contains(part)), "{to}: {message}");
        assert!(!message.contains('\n'), "{message}");
    }
}
