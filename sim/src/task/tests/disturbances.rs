//! Disturbances: their draws, what they change, who observes it, and refusals.

use super::{EnvironmentBatch, HOPPER, Outcome, changed, hopper, refusal};
use crate::environment_batch::Disturbances;

/// Everything that can be drawn.
const EVERYTHING: &str = concat!(
    "[command]\nforward = [-1.0, 1.0]\n[disturbance]\n",
    include_str!("disturbance.toml"),
    "[[disturbance.payload]]\nlink = \"thigh\"\nmass = [0.5, 1.0]\n",
);

/// The example with these lines at its end.
fn with(lines: &str) -> Box<dyn EnvironmentBatch> {
    hopper(&format!("{HOPPER}\n{lines}"))
}

/// As [`with`], and the critic observes the disturbances.
fn shown_to(audience: &str, lines: &str) -> Box<dyn EnvironmentBatch> {
    let hidden = "hidden = [\"rootx\"]";
    let file = changed(hidden, &format!("{hidden}\ndisturbances = \"{audience}\""));
    hopper(&format!("{file}\n{lines}"))
}

pub(super) fn start(world: &mut dyn EnvironmentBatch, key: u8) {
    world.reset(0, 4, 1000, [key; 32]).unwrap();
}

pub(super) fn step(world: &mut dyn EnvironmentBatch, action: [f32; 2]) -> Outcome {
    let mut outcome = [Outcome::default()];
    world.step(&action, &mut outcome).unwrap();
    outcome[0]
}

/// Actions that differ from step to step.
pub(super) fn action(step: usize) -> [f32; 2] {
    [((7 * step) % 11) as f32 / 11.0 - 0.5, ((5 * step) % 13) as f32 / 13.0 - 0.5]
}

/// Value of a feature of the global state.
fn feature(world: &dyn EnvironmentBatch, name: &str) -> f32 {
    let mut features = world.description().state.iter();
    world.state_of(0)[features.position(|feature| feature.name == name).expect(name)]
}

#[test]
fn an_episode_with_all_disturbances_continues_bit_for_bit_in_another_environment() {
    let [mut first, mut second] = [(); 2].map(|()| shown_to("critic", EVERYTHING));
    start(&mut *first, 3);
    for index in 0..30 {
        step(&mut *first, action(index));
    }
    let bytes = first.encode(0).unwrap();
    for world in [&mut first, &mut second] {
        world.restore(0, &bytes).unwrap();
        assert_eq!(world.encode(0).unwrap(), bytes);
    }
    for index in 30..90 {
        let ends = [&mut first, &mut second].map(|world| step(&mut **world, action(index)));
        assert_eq!(ends[0], ends[1]);
        assert_eq!(first.encode(0).unwrap(), second.encode(0).unwrap());
        assert_eq!(first.observations_of(0), second.observations_of(0));
        assert_eq!(first.state_of(0), second.state_of(0));
    }
}

#[test]
fn a_restored_episode_has_the_draws_of_the_uninterrupted_one() {
    let [mut straight, mut restored] = [(); 2].map(|()| shown_to("critic", EVERYTHING));
    start(&mut *straight, 5);
    let motion = 9;
    for index in 0..60 {
        restored.restore(0, &straight.encode(0).unwrap()).unwrap();
        assert_eq!(straight.state_of(0)[motion..], restored.state_of(0)[motion..], "step {index}");
        let before = straight.state_of(0)[..motion].to_vec();
        assert_eq!(before, restored.state_of(0)[..motion]);
        assert_eq!(straight.observations_of(0), restored.observations_of(0));
        step(&mut *straight, action(index));
    }
}

#[test]
fn the_state_has_a_named_feature_for_everything_that_is_drawn() {
    let world = shown_to("critic", EVERYTHING);
    let names = world.description().state[9..].iter().map(|feature| feature.name.as_str());
    let expected = [
        "command.forward",
        "disturbance.friction",
        "disturbance.gravity.x",
        "disturbance.gravity.y",
        "disturbance.payload.thigh",
        "disturbance.motor_strength.hip",
        "disturbance.motor_strength.knee",
        "disturbance.joint_damping.hip",
        "disturbance.joint_damping.knee",
        "disturbance.action_delay",
        "disturbance.observation_delay",
        "disturbance.sensor_bias.rootz.position",
        "disturbance.sensor_bias.rooty.position",
        "disturbance.sensor_bias.hip.position",
        "disturbance.sensor_bias.knee.position",
        "disturbance.push.torso.x",
        "disturbance.push.torso.y",
        "disturbance.push.torso.z",
    ];
    assert_eq!(names.collect::<Vec<_>>(), expected);
}

#[test]
fn agents_observe_disturbances_only_if_the_task_states_it() {
    let line = "[disturbance]\nfriction = [0.5, 0.5]";
    for (audience, state, observed) in [("nobody", 9, 9), ("critic", 10, 9), ("agents", 10, 10)] {
        let mut world = shown_to(audience, line);
        start(&mut *world, 1);
        let agent = &world.description().agents[1];
        let ids = 2;
        let sizes = (world.description().state.len(), agent.observation.len() - ids);
        assert_eq!(sizes, (state, observed), "{audience}");
        assert_eq!(agent.seen, (0..observed).collect::<Vec<_>>());
        let observation = &world.observations_of(0)[1];
        assert_eq!(observation[..observed], world.state_of(0)[..observed]);
    }
}

#[test]
fn what_is_drawn_lies_in_its_range_and_differs_between_episodes_and_joints() {
    let mut world = shown_to("critic", EVERYTHING);
    let mut frictions = Vec::new();
    for key in 1..20 {
        start(&mut *world, key);
        let at = |name: &str| feature(&*world, &format!("disturbance.{name}"));
        for (name, low, high) in [
            ("friction", 0.5, 1.5),
            ("payload.thigh", 0.5, 1.0),
            ("motor_strength.hip", 0.8, 1.2),
            ("joint_damping.knee", 0.5, 2.0),
            ("action_delay", 1.0, 3.0),
            ("observation_delay", 1.0, 3.0),
            ("sensor_bias.hip.position", -0.02, 0.02),
        ] {
            assert!((low..=high).contains(&at(name)), "{name}: {}", at(name));
        }
        assert_ne!(at("motor_strength.hip"), at("motor_strength.knee"));
        frictions.push(at("friction"));
    }
    assert!(frictions.iter().any(|friction| *friction < 0.8));
    assert!(frictions.iter().any(|friction| *friction > 1.2));
}

#[test]
fn an_undisturbed_episode_is_that_of_the_task_without_disturbances() {
    let lines = EVERYTHING.split_once("[disturbance]").unwrap().1;
    let mut off = with(&format!("[disturbance]{lines}"));
    let mut plain = hopper(HOPPER);
    off.set_disturbances(Disturbances::Off);
    for world in [&mut off, &mut plain] {
        start(&mut **world, 2);
    }
    for index in 0..60 {
        assert_eq!(off.state_of(0), plain.state_of(0), "step {index}");
        assert_eq!(off.observations_of(0), plain.observations_of(0), "step {index}");
        assert_eq!(step(&mut *off, action(index)), step(&mut *plain, action(index)));
    }
}

#[test]
fn evaluations_are_disturbed_only_if_the_task_states_it_and_a_state_remembers_it() {
    let friction = "[disturbance]\nfriction = [0.5, 0.5]\n";
    for (lines, expected) in [("", 1.0), ("in_evaluations = true", 0.5)] {
        let mut world = shown_to("critic", &format!("{friction}{lines}"));
        world.set_disturbances(Disturbances::AsInEvaluations);
        start(&mut *world, 1);
        assert_eq!(feature(&*world, "disturbance.friction"), expected, "{lines}");
        let bytes = world.encode(0).unwrap();
        world.set_disturbances(Disturbances::AsInTraining);
        world.restore(0, &bytes).unwrap();
        assert_eq!(feature(&*world, "disturbance.friction"), expected, "{lines}");
        start(&mut *world, 1);
        assert_eq!(feature(&*world, "disturbance.friction"), 0.5);
    }
}

#[test]
fn a_delay_of_two_actions_is_two_steps_of_action_0_first() {
    let mut delayed = with("[disturbance]\naction_delay = [2, 2]");
    let mut plain = hopper(HOPPER);
    for world in [&mut delayed, &mut plain] {
        start(&mut **world, 6);
    }
    for index in 0..50 {
        step(&mut *delayed, action(index));
        step(&mut *plain, index.checked_sub(2).map_or([0.0; 2], action));
        assert_eq!(delayed.state_of(0), plain.state_of(0), "step {index}");
    }
}

#[test]
fn a_delay_of_two_observations_shows_the_state_two_steps_before() {
    let mut world = with("[disturbance]\nobservation_delay = [2, 2]");
    start(&mut *world, 6);
    let mut states = vec![world.state_of(0)];
    for index in 0..50 {
        let observed = &world.observations_of(0)[0][..9];
        assert_eq!(observed, states[index.max(2) - 2], "step {index}");
        step(&mut *world, action(index));
        states.push(world.state_of(0));
    }
    assert!(world.description().agents[0].seen.is_empty());
}

/// Differences between what the agents and the critic observe, for 200 steps; all agents observe the same.
fn errors(lines: &str, key: u8) -> Vec<Vec<f32>> {
    let mut world = with(&format!("[disturbance]\n{lines}"));
    start(&mut *world, key);
    let error = |index| {
        let observations = world.observations_of(0);
        assert_eq!(observations[0][..9], observations[1][..9]);
        let errors = observations[0].iter().zip(world.state_of(0)).map(|(seen, is)| seen - is);
        let errors = errors.collect();
        step(&mut *world, action(index));
        errors
    };
    (0..200).map(error).collect()
}

#[test]
fn sensor_noise_has_its_distribution_and_changes_only_what_the_agents_observe() {
    let errors = errors("sensor_noise = { positions = { normal = 0.01 } }", 1);
    let positions = || errors.iter().flat_map(|row| &row[..4]);
    let squares: f32 = positions().map(|error| error * error).sum();
    // 800 draws: the relative standard error of the variance is sqrt(2 / 800) = 0.05.
    assert!((squares / 800.0 / 1e-4 - 1.0).abs() < 0.2, "{squares}");
    assert!(positions().sum::<f32>().abs() / 800.0 < 0.002);
    assert!(errors.iter().all(|row| row[4..9] == [0.0; 5]));
}

#[test]
fn sensor_bias_is_constant_in_an_episode_and_differs_between_episodes() {
    let [first, second] =
        [1, 2].map(|key| errors("sensor_bias = { velocities = { uniform = 0.1 } }", key));
    for episode in [&first, &second] {
        for row in episode {
            assert_eq!(row[..4], [0.0; 4]);
            for (error, bias) in row[4..9].iter().zip(&episode[0][4..9]) {
                assert!((error - bias).abs() < 1e-4 && bias.abs() <= 0.1 + 1e-6);
            }
        }
    }
    assert!((first[0][4] - second[0][4]).abs() > 1e-3);
}

#[test]
fn each_window_has_one_push_of_its_duration_in_a_random_direction() {
    let mut world = shown_to("critic", EVERYTHING);
    start(&mut *world, 1);
    let mut forces = Vec::new();
    for _ in 0..400 {
        let at = |axis| feature(&*world, &format!("disturbance.push.torso.{axis}"));
        assert_eq!([at("y"), at("z")], [0.0; 2], "the robot moves in the plane of x and z");
        forces.push(at("x"));
        step(&mut *world, [0.0; 2]);
    }
    let mut starts = Vec::new();
    // 0.4 s are 20 steps, 0.1 s five.
    for window in forces.chunks_exact(20) {
        let first = window.iter().position(|force| *force != 0.0).unwrap();
        let force = window[first];
        assert!((20.0..=50.0).contains(&force.abs()), "{force}");
        let expected =
            (0..20).map(|index| if (first..first + 5).contains(&index) { force } else { 0.0 });
        assert!(expected.eq(window.iter().copied()), "{window:?}");
        starts.push((first, force > 0.0));
    }
    let some = |test: fn(&(usize, bool)) -> bool| starts.iter().filter(|start| test(start)).count();
    assert!((3..=17).contains(&some(|(_, right)| *right)), "{starts:?}");
    assert!(some(|(first, _)| *first < 5) > 0 && some(|(first, _)| *first > 10) > 0, "{starts:?}");
}

#[test]
fn a_state_whose_flag_is_neither_0_nor_1_is_refused() {
    let mut world = with("[disturbance]\nfriction = [0.5, 0.5]");
    start(&mut *world, 1);
    let mut bytes = world.encode(0).unwrap();
    assert_eq!(bytes.len(), hopper(HOPPER).encode(0).unwrap().len() + 36);
    *bytes.iter_mut().rev().nth(3).unwrap() = 2;
    let refusal = world.restore(0, &bytes).unwrap_err().to_string();
    assert!(refusal.ends_with("whether it is disturbed is 2, not 0 or 1"), "{refusal}");
}

#[test]
fn a_push_that_cannot_act_is_refused() {
    for (row, part) in [
        ("duration_secs = 0.003", "duration_secs 0.003 is less than half a step of 0.02 s"),
        (
            "duration_secs = 0.1\naxes = [\"x\", \"y\"]",
            "axes has y, along which a planar robot cannot move; remove it",
        ),
    ] {
        let push = "[[disturbance.push]]\nlink = \"torso\"\nforce = [0, 1]\nperiod_secs = 2";
        let message = refusal(&format!("{HOPPER}\n{push}\n{row}\n"));
        assert!(message.contains(part), "{row}: {message}");
    }
}

#[test]
fn invalid_disturbances_are_refused_with_their_key() {
    let push = |rows: &str| format!("[[disturbance.push]]\nlink = \"torso\"\n{rows}");
    let times = "duration_secs = 0.1\nperiod_secs = 2";
    let payload = "[[disturbance.payload]]\nlink = \"torso\"\nmass = [0, 1]\n";
    for (lines, part) in [
        (
            "[disturbance]\nfriction = [1.5, 0.5]".to_owned(),
            "disturbance.friction must be [low, high] in 0..=10, is [1.5, 0.5]",
        ),
        ("[disturbance]\nfriktion = [1, 1]".to_owned(), "did you mean `friction`?"),
        (
            "[disturbance]\naction_delay = [0, 21]".to_owned(),
            "disturbance.action_delay must be [low, high] in 0..=20 steps, is [0, 21]",
        ),
        (
            "[disturbance]\nsensor_noise = { positions = { normal = -1 } }".to_owned(),
            "disturbance.sensor_noise.positions must lie in 0..=1000, is -1",
        ),
        (
            push("force = [0, 1]\nduration_secs = 3\nperiod_secs = 2"),
            "disturbance.push (torso): duration_secs 3 must not exceed period_secs 2",
        ),
        (push(&format!("force = [0, nan]\n{times}")), "disturbance.push (torso).force must be"),
        (push(&format!("force = [0, 1]\naxes = []\n{times}")), "axes is empty; write"),
        (
            push(&format!("force = [0, 1]\n{times}")).replace("torso", "tors"),
            "disturbance.push.link: the robot has no link with a mass that can move `tors`; did you mean `torso`?",
        ),
        (
            "[[disturbance.terrain]]\nbody = \"floor\"\nheight = [0, 1]".to_owned(),
            "the robot has no fixed body with a shape that is no plane `floor`",
        ),
        (
            "[disturbance]\nfriction = [1, 1, 1]".to_owned(),
            ", `friction`: an array of 2 is needed, it has 3 entries",
        ),
        (
            "[disturbance]\naction_delay = [0.5, 1]".to_owned(),
            ", `action_delay`: invalid type: floating point `0.5`, expected a whole number from 0",
        ),
        (
            "[disturbance]\nsensor_noise = 0.1".to_owned(),
            ", `sensor_noise`: invalid type: floating point `0.1`, expected a table",
        ),
        (
            "[disturbance]\nsensor_noise = { positions = { normal = 1 }, velocity = { normal = 1 } }"
                .to_owned(),
            "line 45: unknown field `velocity`",
        ),
        (
            "[disturbance]\nsensor_bias = {}".to_owned(),
            ", `sensor_bias`: it needs `positions` or `velocities`; add one, or remove the key",
        ),
        (format!("{payload}{payload}"), "disturbance.payload: the link `torso` is named twice"),
    ] {
        let message = refusal(&format!("{HOPPER}\n{lines}"));
        assert!(message.contains(part) && !message.contains('\n'), "{lines}: {message}");
    }
}
