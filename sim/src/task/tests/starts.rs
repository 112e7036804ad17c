//! Tests of starts, of the actions around them, of ends by features, and of warnings.

use super::*;

/// The example with a keyframe that bends hip and knee, whose rest is a rad off zero, and with these actuators and lines of
/// the task file.
fn kneeling(actuators: &str, lines: &str) -> Result<Box<dyn EnvironmentBatch>, String> {
    let file = changed("[start]\n", &format!("{lines}\n[start]\nkeyframe = \"home\"\n"));
    let mut config = config(&file, ObservationMode::FullId);
    let model = &mut config.definition.as_mut().unwrap().model;
    let section = model.find("<actuator>").unwrap()..model.find("</actuator>").unwrap();
    model.replace_range(section, &format!("<actuator>{actuators}"));
    *model = model.replace("name=\"knee\" range=\"-2 0\"", "name=\"knee\" range=\"-2 0\" ref=\"-1\"").replace(
        "</mujoco>",
        "<keyframe><key name=\"home\" qpos=\"0 -0.1 0.2 0.5 -1.5\" qvel=\"1 0 0 0 2\" ctrl=\"0.4 -0.9\"/>\
         <key qpos=\"0 0\"/><key name=\"free\" qpos=\"0 0 0 0.5 -1.5\"/></keyframe></mujoco>",
    );
    environments(&config, 1).map_err(|error| error.to_string())
}

const SERVOS: &str = "<position joint=\"hip\" kp=\"50\" ctrlrange=\"-0.5 1.5\"/>\
    <general joint=\"knee\" gainprm=\"40\" biastype=\"affine\" biasprm=\"4 -40 -2\" ctrlrange=\"-2 0\"/>";

fn feature(world: &dyn EnvironmentBatch, name: &str) -> f32 {
    let index = world.description().state.iter().position(|feature| feature.name == name);
    world.state_of(0)[index.unwrap()]
}

fn assert_range(world: &dyn EnvironmentBatch, agent: usize, expected: [f32; 2]) {
    let [found] = world.control_ranges(agent)[..] else { panic!("one control") };
    let off = (found[0] - expected[0]).abs().max((found[1] - expected[1]).abs());
    assert!(off < 1e-6, "{found:?} against {expected:?}");
}

#[test]
fn an_episode_starts_from_a_keyframe_in_the_models_own_coordinates() {
    let mut world = kneeling(SERVOS, "").unwrap();
    world.reset(0, 0, 1000, [1; 32]).unwrap();
    for (name, stated) in [
        ("rootz.position", -0.1),
        ("hip.position", 0.5),
        ("knee.position", -1.5),
        ("rootx.velocity", 1.0),
        ("knee.velocity", 2.0),
    ] {
        let value = feature(&*world, name);
        assert!((value - stated).abs() <= 0.005 && value != stated, "{name}: {value}");
    }
    let wrong = |name: &str, keys: &str| {
        let file = changed("[start]\n", &format!("[start]\nkeyframe = \"{name}\"\n"));
        let mut config = config(&file, ObservationMode::FullId);
        let model = &mut config.definition.as_mut().unwrap().model;
        *model = model.replace("</mujoco>", &format!("<keyframe>{keys}</keyframe></mujoco>"));
        environments(&config, 1).map(drop).map_err(|error| error.to_string())
    };
    let short = "<key name=\"home\" qpos=\"0 0\"/>";
    let lost = wrong("hom", short).unwrap_err();
    assert!(lost.contains("no keyframe `hom`; did you mean `home`?"), "{lost}");
    let short = wrong("home", short).unwrap_err();
    assert!(
        short.contains("`qpos` of the keyframe `home` has 2 numbers, the robot has 5"),
        "{short}"
    );
    let fast = wrong("home", "<key name=\"home\" qvel=\"0 0 0 0 1000\"/>").unwrap_err();
    assert!(fast.contains("start.keyframe: the speed of `knee` is 1000, at most 999.9"), "{fast}");
}

#[test]
fn actions_around_the_start_are_changes_of_its_controls() {
    let around = |lines: &str| kneeling(SERVOS, &format!("[actions]\naround = \"start\"\n{lines}"));
    // The keyframe states the controls 0.4 and -0.9.
    let scaled = around("scale = 0.25").unwrap();
    assert_range(&*scaled, 0, [0.15, 0.65]);
    assert_range(&*scaled, 1, [-1.15, -0.65]);
    assert_range(&*around("").unwrap(), 1, [-1.9, 0.1]);
    assert_eq!(scaled.warnings(), [""; 0]);
    for (scale, fault) in
        [("20", "has controls from -19.6 to 20.4"), ("0.0001", "has targets from")]
    {
        let warnings = around(&format!("scale = {scale}")).unwrap().warnings();
        let start = format!("the motor of `hip` {fault}");
        assert!(warnings[0].starts_with(&start), "{warnings:?}");
        assert!(warnings[0].contains("`actions.scale`"), "{warnings:?}");
    }
    let alone = kneeling(SERVOS, "[actions]\nscale = 0.25").err().unwrap();
    assert!(alone.contains("actions.scale needs around = \"start\""), "{alone}");
}

#[test]
fn without_controls_of_a_keyframe_an_action_of_0_holds_the_start() {
    let file = changed(
        "[start]\n",
        "[actions]\naround = \"start\"\nscale = 0.5\n[start]\ncoordinates = { hip = 0.3, knee = -0.8 }\n",
    );
    let mut config = config(&file, ObservationMode::FullId);
    let model = &mut config.definition.as_mut().unwrap().model;
    let section = model.find("<actuator>").unwrap()..model.find("</actuator>").unwrap();
    model.replace_range(section, &format!("<actuator>{SERVOS}"));
    let world = environments(&config, 1).unwrap();
    // 50 (c - 0.3) = 0, and 40 c + 4 - 40 (-0.8) = 0.
    assert_range(&*world, 0, [-0.2, 0.8]);
    assert_range(&*world, 1, [-1.4, -0.4]);
}

#[test]
fn an_episode_ends_when_a_feature_or_the_tilt_leaves_its_range() {
    let steps = |healthy: &str| {
        let row =
            HOPPER.find("coordinate = \"rootz\"").unwrap()..HOPPER.find("\n# Noise on").unwrap();
        let mut file = HOPPER.to_owned();
        file.replace_range(row, healthy);
        let mut world = hopper(&file);
        world.reset(0, 0, 1000, [1; 32]).unwrap();
        let mut outcome = [Outcome::default()];
        (1..).find(|_| {
            world.step(&[0.0, 0.0], &mut outcome).unwrap();
            outcome[0].is_end()
        })
    };
    assert_eq!(steps("feature = \"upright\"\nbelow = 0.9"), Some(1));
    // It tips over by 60 degrees.
    assert!(steps("feature = \"upright\"\nabove = 0.5") > Some(20));
    assert_eq!(steps("feature = \"rootx.velocity\"\nabove = 100.0"), Some(1));
    let both = refusal(&changed(
        "coordinate = \"rootz\"",
        "coordinate = \"rootz\"\nfeature = \"upright\"",
    ));
    assert!(both.contains("either a `coordinate` or a `feature`"), "{both}");
    let lost = refusal(&changed("coordinate = \"rootz\"", "feature = \"rootz.velociti\""));
    assert!(lost.contains("did you mean `rootz.velocity`?"), "{lost}");
}

/// Warnings about the example with a changed model and other coordinates of its start.
fn warnings([from, to]: [&str; 2], coordinates: &str) -> Vec<String> {
    let file = changed("[start]\n", &format!("[start]\ncoordinates = {{ {coordinates} }}\n"));
    let mut config = config(&file, ObservationMode::FullId);
    let model = &mut config.definition.as_mut().unwrap().model;
    assert!(model.contains(from));
    *model = model.replace(from, to);
    environments(&config, 1).unwrap().warnings()
}

#[test]
fn a_reward_that_is_the_same_in_all_episodes_is_named() {
    let rewards = HOPPER.find("[[reward]]\n").unwrap()..HOPPER.find("# The episode ends").unwrap();
    let alive = "[[reward]]\nterm = \"alive\"\nweight = 1\n";
    let weightless = "[[cost]]\nterm = \"control\"\nweight = 0\n";
    for (reward, count) in [("", 1), (weightless, 1), (alive, 0)] {
        let mut file = HOPPER.to_owned();
        file.replace_range(rewards.clone(), reward);
        let warnings = hopper(&file).warnings();
        assert_eq!(warnings.len(), count, "{reward}: {warnings:?}");
        assert!(warnings.iter().all(|line| line.starts_with("all episodes have the same return")));
    }
}

#[test]
fn a_start_that_cannot_be_meant_is_named() {
    let same = ["hopper", "hopper"];
    assert_eq!(warnings(same, ""), [""; 0]);
    // The foot is a sphere of 0.04 m around z = 1.2 - 0.2 - 0.4 - 0.5 = 0.1 m.
    let deep = warnings(same, "rootz = -0.26");
    assert!(deep[0].contains("` starts 0.200 m deep in the floor"), "{deep:?}");
    let bent = warnings(same, "knee = 0.25, hip = -0.6");
    let expected = "2 joints start outside the limits, `hip` by 0.100 rad, `knee` by 0.250 rad";
    assert!(bent.len() == 1 && bent[0].starts_with(expected), "{bent:?}");
    let plane = "<geom name=\"floor\" type=\"plane\" size=\"40 40 40\" friction=\"0.9 0.1 0.1\" conaffinity=\"1\"/>";
    let bottomless = warnings([plane, ""], "");
    assert!(bottomless[0].contains("has no floor that it can touch"), "{bottomless:?}");
    let slab = "<body pos=\"0 0 -1\"><geom type=\"box\" size=\"40 40 1\"/></body>";
    assert_eq!(warnings([plane, slab], ""), [""; 0]);
    let ghost = warnings(["conaffinity=\"1\"", "conaffinity=\"2\""], "");
    assert!(ghost[0].contains("has no floor that it can touch"), "{ghost:?}");
}

#[test]
fn ranges_that_look_like_degrees_for_radians_or_radians_for_degrees_are_named() {
    let knee = |range: &str| ["name=\"knee\" range=\"-2 0\"", range].map(str::to_owned);
    for (range, unit) in [("-0.02 0", "radian"), ("-110 0", "degree")] {
        let [from, to] = knee(&format!("name=\"knee\" range=\"{range}\""));
        let found = warnings([&from, &to], "");
        assert_eq!(found.len(), 1, "{found:?}");
        assert!(
            found[0]
                .starts_with("ranges of driven joints look like angles in another unit, `knee` ")
        );
        assert!(
            found[0].ends_with(&format!("set `angle=\"{unit}\"` of the <compiler>")),
            "{found:?}"
        );
    }
    // Whole turns may be meant.
    let [from, to] = knee("name=\"knee\" range=\"-6 6\"");
    assert_eq!(warnings([&from, &to], ""), [""; 0]);
    let [from, to] = knee("name=\"knee\" range=\"-150 -30\"");
    let mut config = config(HOPPER, ObservationMode::FullId);
    let model = &mut config.definition.as_mut().unwrap().model;
    *model = model.replacen(&from, &to, 1);
    let refused = environments(&config, 1).err().unwrap().to_string();
    assert!(refused.contains("in degrees, set `angle=\"degree\"` of the <compiler>"), "{refused}");
}

#[test]
fn an_actuator_with_the_name_of_the_joint_of_another_is_named() {
    let own =
        "<motor name=\"hip\" joint=\"hip\" gear=\"80\"/>\n    <motor name=\"knee\" joint=\"knee\"";
    let exchanged =
        "<motor name=\"knee\" joint=\"hip\" gear=\"80\"/><motor name=\"hip\" joint=\"knee\"";
    let found = warnings([own, exchanged], "");
    assert_eq!(found.len(), 1, "{found:?}");
    assert!(found[0].contains("sites of other actuators, `knee`, `hip`: "), "{found:?}");
}

/// The shank ends 0.06 m above the floor, and what is added 0.08 m above it.
#[test]
fn a_start_inside_a_fixed_shape_or_another_robot_is_named() {
    let shapes = [
        (
            "<geom name=\"step\" type=\"box\" size=\"1 1 0.08\" conaffinity=\"1\"/>",
            "`shank` by 0.020 m in `step`",
        ),
        (
            "<geom type=\"hfield\" hfield=\"h\" pos=\"0 0 0.08\" conaffinity=\"1\"/>",
            "`shank` by 0.020 m in `a fixed shape`",
        ),
        (
            "<body name=\"block\" pos=\"0 0 0.04\"><freejoint/><geom type=\"box\" size=\"0.1 0.1 0.04\" conaffinity=\"1\"/></body>",
            "`block` by 0.020 m in `shank`",
        ),
    ];
    for (shape, expected) in shapes {
        let asset = "<asset><hfield name=\"h\" nrow=\"2\" ncol=\"2\" size=\"1 1 1 1\"/></asset>";
        let found = warnings(["</worldbody>", &format!("{shape}</worldbody>{asset}")], "");
        assert!(found.len() == 1 && found[0].contains(expected), "{found:?}");
    }
}

#[test]
fn an_episode_starts_at_the_stated_coordinates() {
    let file = changed(
        "positions = { uniform = 0.005 }",
        "coordinates = { rootz = 0.1, knee = -0.4 }\npositions = { uniform = 0.005 }",
    );
    let mut world = hopper(&file);
    world.reset(0, 0, 1000, [1; 32]).unwrap();
    let features = world.description().state.iter().map(|feature| feature.name.clone());
    let features: Vec<String> = features.collect();
    let mut state = vec![0.0; features.len()];
    world.state(0, &mut state);
    for (name, stated) in [("rootz", 0.1), ("rooty", 0.0), ("hip", 0.0), ("knee", -0.4)] {
        let name = format!("{name}.position");
        let value = state[features.iter().position(|feature| *feature == name).unwrap()];
        assert!((value - stated).abs() <= 0.005 && value != stated, "{name}: {value}");
    }
}

#[test]
fn a_start_outside_the_bounds_of_a_state_is_refused() {
    for (start, part) in [
        ("positions = { uniform = -1 }", "start.positions must lie in"),
        (
            "positions = { uniform = 9.0 }",
            "(a joint's limits, 3 rad or m wider); lower its noise in start.positions",
        ),
        ("coordinates = { hipp = 0.1 }", "did you mean `hip`?"),
        ("coordinates = { knee = nan }", "start.coordinates: `knee` starts at NaN, outside"),
    ] {
        let message = refusal(&changed("positions = { uniform = 0.005 }", start));
        assert!(message.contains(part) && !message.contains('\n'), "{start}: {message}");
    }
}

#[test]
fn a_joint_stands_for_all_its_actuators_and_an_actuator_for_one_of_them() {
    let built = |agents: &str| {
        let mut config =
            config(&changed("[[\"hip\"], [\"knee\"]]", agents), ObservationMode::KNearest);
        let definition = config.definition.as_mut().unwrap();
        let (from, to) = ("</actuator>", "<motor joint=\"knee\" gear=\"8\"/></actuator>");
        assert!(definition.model.contains(from));
        definition.model = definition.model.replacen(from, to, 1);
        environments(&config, 1).map_err(|error| error.to_string())
    };
    let mut world = built("[[\"hip\"], [\"knee\"]]").unwrap();
    let joints = world.description().agents.iter().map(|agent| agent.joints.as_slice());
    assert_eq!(joints.collect::<Vec<_>>(), [["hip"].as_slice(), &["knee", "knee"]]);
    let mut outcome = [Outcome::default()];
    world.step(&[0.0, 0.5, -0.25], &mut outcome).unwrap();
    // Both act on the joint: 80 x 0.5 - 8 x 0.25.
    assert_eq!(world.world(0).unwrap().efforts().collect::<Vec<_>>(), [0.0, 38.0]);
    let apart = built("[[\"hip\", \"knee.motor\"], [\"knee\"]]").err().unwrap();
    assert!(apart.contains("`knee` stands for an actuator that has an agent already"), "{apart}");
}

#[test]
fn a_task_without_agents_or_actuators_is_refused() {
    let none = refusal(&changed("[[\"hip\"], [\"knee\"]]", "[]"));
    assert!(none.contains("a partition needs at least one agent"), "{none}");
    let mut config = config(HOPPER, ObservationMode::FullId);
    let model = &mut config.definition.as_mut().unwrap().model;
    let section = model.find("<actuator>").unwrap()..model.find("</actuator>").unwrap();
    model.replace_range(section, "<actuator>");
    let none = environments(&config, 1).err().unwrap().to_string();
    assert!(none.contains("the model has no actuators"), "{none}");
}

#[test]
fn the_height_of_a_height_field_is_drawn_as_that_of_other_fixed_shapes() {
    let hidden = "hidden = [\"rootx\"]";
    let file = changed(hidden, &format!("{hidden}\ndisturbances = \"critic\""));
    let file = file + "\n[[disturbance.terrain]]\nbody = \"world\"\nheight = [0.5, 0.5]\n";
    let mut config = config(&file, ObservationMode::FullId);
    let model = &mut config.definition.as_mut().unwrap().model;
    *model = model.replace(
        "<worldbody>",
        "<asset><hfield name=\"h\" nrow=\"2\" ncol=\"2\" size=\"1 1 1 1\"/></asset>\
         <worldbody><geom type=\"hfield\" hfield=\"h\" contype=\"1\" conaffinity=\"1\"/>",
    );
    let mut world = environments(&config, 1).unwrap();
    world.reset(0, 0, 1000, [1; 32]).unwrap();
    assert_eq!(feature(&*world, "disturbance.terrain.world.0"), 0.5);
    let shapes = world.world(0).unwrap().fixed_shapes();
    assert_eq!(shapes.iter().map(|shape| shape.position).collect::<Vec<_>>(), [[0.0, 0.0, 0.5]]);
}

#[test]
fn a_start_that_does_not_meet_a_condition_is_named_with_its_value() {
    for (row, expected) in [
        ("feature = \"upright\"\nat_least = 2", "`healthy.upright` (at_least = 2, is 1)"),
        (
            "feature = \"rootx.velocity\"\nabove = 0.5\nbelow = 9",
            "`healthy.rootx.velocity` (above = 0.5, below = 9, is 0)",
        ),
        ("coordinate = \"rootz\"\nbelow = -1", "`healthy.rootz` (below = -1, is "),
    ] {
        let file = changed("[[healthy]]\n", &format!("[[healthy]]\n{row}\n[[healthy]]\n"));
        let found = environments(&config(&file, ObservationMode::FullId), 1).unwrap().warnings();
        let start = format!("the start does not meet {expected}");
        assert!(found.len() == 1 && found[0].starts_with(&start), "{found:?}");
    }
}
