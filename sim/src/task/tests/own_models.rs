//! Worlds of small models: what turns for long, stands on a base or rests tilted.

use super::disturbances::{start, step};
use super::*;

/// Environments of one task of a model with two motors, `hip` and `knee`.
fn world(file: &str, model: &str) -> Box<dyn EnvironmentBatch> {
    let mut config = config(file, ObservationMode::FullId);
    config.definition.as_mut().unwrap().model = model.to_owned();
    environments(&config, 1).unwrap()
}

const FILE: &str = r#"
robot = "hopper"
model = "hopper.xml"
frame_skip = 1000
episode_steps = 1000

[agents]
2x1 = [["hip"], ["knee"]]

[[reward]]
term = "alive"
weight = 1.0
"#;

/// A base with a mass, and a carriage with the mass 1 that the motors move.
const CARRIAGE: &str = r#"<mujoco><option timestep="0.002" gravity="0 0 0"/><worldbody>
<body name="base"><geom type="sphere" size="0.1" mass="9"/>
<body name="carriage" pos="0 0 5"><joint name="hip" type="slide" axis="1 0 0"/>
<joint name="knee" type="slide" axis="0 1 0"/><geom type="sphere" size="0.1" mass="1"/></body></body>
SPINNER</worldbody><actuator><motor joint="hip" ctrlrange="-1 1"/><motor joint="knee" ctrlrange="-1 1"/></actuator>
KEYS</mujoco>"#;

#[test]
fn a_body_that_turns_steadily_for_long_keeps_a_valid_orientation() {
    let spinner = "<body name=\"spinner\" pos=\"9 0 0\"><freejoint name=\"spin\"/><geom type=\"box\" size=\"0.1 0.1 0.1\"/></body>";
    let keys = "<keyframe><key name=\"spins\" qvel=\"0 0 0 0 0 0 0 1\"/></keyframe>";
    let model = CARRIAGE.replace("SPINNER", spinner).replace("KEYS", keys);
    let file = format!("{FILE}\n[start]\nkeyframe = \"spins\"\n");
    let [mut first, mut second] = [(); 2].map(|()| world(&file, &model));
    start(&mut *first, 1);
    // The squared length grows by 4e-5 in a step: without normalisation it leaves its bounds after 24.
    for _ in 0..30 {
        second.restore(0, &first.encode(0).unwrap()).unwrap();
        for world in [&mut first, &mut second] {
            assert!(!step(&mut **world, [0.1, -0.1]).fault);
        }
        assert_eq!(first.encode(0).unwrap(), second.encode(0).unwrap());
    }
}

#[test]
fn a_state_after_absurd_actions_can_be_restored() {
    let motors = "gear=\"1e-9\" ctrlrange=\"-1e6 1e6\"";
    let model = CARRIAGE.replace("SPINNER", "").replace("KEYS", "");
    let model = model.replace("ctrlrange=\"-1 1\"", motors);
    let cost = "\n[[cost]]\nterm = \"action_rate\"\nweight = 1e-20\n";
    let mut world = world(&format!("{FILE}{cost}"), &model);
    start(&mut *world, 1);
    let outcome = step(&mut *world, [1e5, -1e5]);
    assert!(!outcome.fault && outcome.reward.is_finite(), "{outcome:?}");
    let state = world.encode(0).unwrap();
    world.restore(0, &state).unwrap();
}

#[test]
fn the_mass_centre_is_that_of_what_moves() {
    let model = CARRIAGE.replace("SPINNER", "").replace("KEYS", "");
    let mut world = world(&format!("{FILE}\n[start]\ncoordinates = {{ hip = 0.5 }}\n"), &model);
    start(&mut *world, 1);
    assert_eq!(world.world(0).unwrap().centre_of_mass(), [0.5, 0.0, 5.0]);
}

#[test]
fn upright_of_a_planar_root_is_that_of_its_body() {
    let healthy = "\n[[healthy]]\nfeature = \"upright\"\nabove = 0.9\n";
    let rooty = "<joint name=\"rooty\" ";
    let model = include_str!("../../../assets/hopper.xml");
    for (from, to, ends) in [
        (rooty, rooty, false),
        // The reference moves the coordinate, not the body.
        (rooty, "<joint name=\"rooty\" ref=\"1\" ", false),
        ("<body name=\"torso\" ", "<body name=\"torso\" euler=\"0 1.57 0\" ", true),
    ] {
        assert!(model.contains(from), "{from}");
        let file = changed("forward_speed", "alive") + healthy;
        let mut world = world(&file, &model.replacen(from, to, 1));
        start(&mut *world, 1);
        assert_eq!(step(&mut *world, [0.0; 2]).terminated, ends, "{to}");
    }
}

#[test]
fn only_a_body_that_moves_has_a_term_and_only_what_agents_may_see_is_a_neighbour() {
    let height = "\n[[reward]]\nterm = \"height\"\nweight = 1\nof = \"base\"\n";
    let mut config = config(&format!("{FILE}{height}"), ObservationMode::FullId);
    let model = CARRIAGE.replace("SPINNER", "").replace("KEYS", "");
    config.definition.as_mut().unwrap().model = model;
    let message = environments(&config, 1).err().expect("a constant term").to_string();
    assert!(message.contains("reward.height is constant"), "{message}");
    let hidden = "hidden = [\"rootx\"]";
    let globals = "globals = [\"rootz.position\", \"rooty.position\"]";
    let file = changed(hidden, &format!("{hidden}\ndisturbances = \"critic\""));
    let file = file.replace(globals, "globals = [\"disturbance.friction\"]");
    let message = refusal(&format!("{file}\n[disturbance]\nfriction = [0.5, 1]\n"));
    assert!(message.contains("neighbourhood.globals: the robot has no feature"), "{message}");
}

#[test]
fn a_start_in_a_fixed_body_is_a_warning_unless_that_is_the_robots_base() {
    let model = CARRIAGE.replace("SPINNER", "").replace("KEYS", "").replace("0 0 5", "0 0 0.1");
    let apart = model
        .replace("<body name=\"carriage\"", "</body><body name=\"carriage\"")
        .replace("</body></body>", "</body>");
    for (model, expected) in [
        (&model, ""),
        (&apart, "what starts inside other shapes is pushed out, `carriage` by 0.100 m in `base`"),
    ] {
        let warnings = world(FILE, model).warnings();
        let inside = warnings.iter().find(|warning| warning.contains("inside other shapes"));
        let inside = inside.map_or("", String::as_str);
        assert!(
            inside.starts_with(expected) && inside.is_empty() == expected.is_empty(),
            "{inside}"
        );
    }
}

/// A craft with a rotor at each end.
const CRAFT: &str = "<mujoco><worldbody><body name=\"craft\"><freejoint name=\"root\"/><geom size=\".1\"/>\
    <site name=\"hip\" pos=\".2 0 0\"/><site name=\"knee\" pos=\"-.2 0 0\"/></body></worldbody>\
    <actuator><motor site=\"hip\" gear=\"0 0 1\" ctrlrange=\"0 50\"/>\
    <motor site=\"knee\" gear=\"0 0 1\" ctrlrange=\"0 50\"/></actuator></mujoco>";

#[test]
fn agents_of_rotors_observe_their_root_and_need_no_floor() {
    let build = |file: &str| {
        let mut config = config(file, ObservationMode::KNearest);
        config.definition.as_mut().unwrap().model = CRAFT.to_owned();
        environments(&config, 1).map_err(|error| error.to_string())
    };
    let blind = build(FILE).err().unwrap();
    assert!(blind.contains("agent_0 observes nothing; name features in"), "{blind}");
    let world =
        build(&format!("{FILE}[neighbourhood]\nglobals = [\"root.z.position\"]\n")).unwrap();
    for agent in &world.description().agents {
        let observed: Vec<&str> = agent.observation.iter().map(|own| own.name.as_str()).collect();
        assert_eq!(observed, ["root.z.position"]);
    }
    assert!(!world.warnings().iter().any(|warning| warning.contains("no floor")));
}

#[test]
fn links_are_driven_by_the_agents_of_their_joints_tendons_and_sites() {
    let drivers = |motor: &str| {
        let model = format!(
            "<mujoco><worldbody><body name=\"craft\" pos=\"0 0 2\"><freejoint/><geom size=\".1\"/><site name=\"hip\"/>\
             <body name=\"arm\" pos=\".3 0 0\"><joint name=\"a\"/><geom size=\".1\"/><body name=\"hand\" pos=\".3 0 0\">\
             <joint name=\"b\"/><geom size=\".1\"/></body></body></body></worldbody>\
             <tendon><fixed name=\"t\"><joint joint=\"a\" coef=\"1\"/><joint joint=\"b\" coef=\"1\"/></fixed></tendon>\
             <actuator><motor site=\"hip\" gear=\"0 0 1 0 0 0\" ctrlrange=\"0 9\"/>\
             <motor name=\"knee\" {motor} ctrlrange=\"-9 9\"/></actuator></mujoco>"
        );
        let world = world(FILE, &model);
        let drivers = crate::drivers(&*world);
        let links = world.pose(0).links.into_iter().map(|link| link.name);
        let named = links.zip(drivers).collect::<std::collections::BTreeMap<_, _>>();
        ["craft", "arm", "hand"].map(|link| named[link])
    };
    assert_eq!(drivers("tendon=\"t\""), [Some(0), Some(1), Some(1)]);
    assert_eq!(drivers("joint=\"b\""), [Some(0), None, Some(1)]);
}
