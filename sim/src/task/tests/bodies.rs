//! Features and terms that name bodies, by hand: two carts on rails, a ball and a goal.

use super::*;

/// No gravity and no contacts. The left cart faces along y and turns; the ball flies along y and spins.
const MODEL: &str = "<mujoco><compiler angle=\"radian\"/><option timestep=\"0.01\" gravity=\"0 0 0\"/>\
    <default><geom size=\"0.1\" contype=\"0\" conaffinity=\"0\"/><motor ctrlrange=\"-1 1\"/></default><worldbody>\
    <body name=\"left\" pos=\"0 0.5 0.2\"><joint name=\"left_x\" type=\"slide\" axis=\"1 0 0\"/>\
    <joint name=\"left_yaw\" axis=\"0 0 1\"/><geom/></body>\
    <body name=\"right\" pos=\"0 -0.5 0.2\"><joint name=\"right_x\" type=\"slide\" axis=\"1 0 0\"/><geom/></body>\
    <body name=\"ball\" pos=\"1 0 0.1\"><freejoint name=\"ball\"/><geom/></body>\
    <body name=\"goal\" pos=\"3 0 0.1\"/></worldbody>\
    <actuator><motor joint=\"left_x\"/><motor joint=\"left_yaw\"/><motor joint=\"right_x\"/></actuator>\
    <keyframe><key name=\"moving\" qpos=\"0 1.5707963 0 1 0 0.1 1 0 0 0\" qvel=\"1 2 0.5 0 3 0 0 0 4\"/></keyframe>\
    </mujoco>";

const FILE: &str = "robot = \"team\"\nmodel = \"team.xml\"\nframe_skip = 5\nepisode_steps = 100\n\
    [agents]\n2 = [[\"left_x\", \"left_yaw\"], [\"right_x\"]]\n[start]\nkeyframe = \"moving\"\n\
    [neighbourhood]\nglobals = [\"left_x.velocity\", \"right_x.velocity\", \"ball.z.position\"]\n";

/// A row of the left cart's view, one of the right cart's, and one that all agents observe.
const VIEWS: &str = "[[state.bodies]]\nof = \"ball\"\nfrom = \"left\"\n\
    features = [\"position\", \"velocity\", \"orientation\", \"angular_velocity\"]\n\
    [[state.bodies]]\nof = \"left\"\nfrom = \"right\"\naxes = \"world\"\nalong = [\"x\", \"y\"]\n\
    [[state.bodies]]\nof = \"goal\"\nfrom = \"ball\"\nfeatures = [\"position\"]\nalong = [\"x\"]\n\
    [[state.bodies]]\nof = \"ball\"\nfeatures = [\"position\"]\nalong = [\"y\"]\n";

fn team(lines: &str, mode: ObservationMode) -> Result<Box<dyn EnvironmentBatch>, String> {
    let mut config = config(&format!("{FILE}{lines}"), mode);
    config.task = "team-2".to_owned();
    config.definition.as_mut().unwrap().model = MODEL.to_owned();
    let mut world = environments(&config, 1).map_err(|error| error.to_string())?;
    world.reset(0, 0, 100, [1; 32]).unwrap();
    Ok(world)
}

/// Reward of the first step, with this term of weight 1.
fn reward(term: &str) -> f32 {
    let lines = format!("[[reward]]\nweight = 1.0\n{term}\n");
    let mut outcome = [Outcome::default()];
    team(&lines, ObservationMode::FullId).unwrap().step(&[0.0; 3], &mut outcome).unwrap();
    outcome[0].reward
}

#[test]
fn a_body_is_observed_in_the_axes_of_the_observing_body_or_of_the_world() {
    let world = team(VIEWS, ObservationMode::FullId).unwrap();
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let state = world.state_of(0);
    let mut compared = 0;
    for (name, expected) in [
        // The ball is at (1, -0.5, -0.1) from the cart, whose x axis is the world's y.
        ("ball/left.x.position", -0.5),
        ("ball/left.y.position", -1.0),
        ("ball/left.z.position", -0.1),
        // It moves by (0, 3, 0) m/s, the cart by (1, 0, 0).
        ("ball/left.x.velocity", 3.0),
        ("ball/left.y.velocity", 1.0),
        ("ball/left.z.velocity", 0.0),
        // From the cart's axes to the ball's by -90 degrees.
        ("ball/left.qw.position", half),
        ("ball/left.qx.position", 0.0),
        ("ball/left.qy.position", 0.0),
        ("ball/left.qz.position", -half),
        ("ball/left.wx.velocity", 0.0),
        ("ball/left.wy.velocity", 0.0),
        ("ball/left.wz.velocity", 2.0),
        ("left/right.x.position", 0.0),
        ("left/right.y.position", 1.0),
        ("left/right.x.velocity", 0.5),
        ("left/right.y.velocity", 0.0),
        ("goal/ball.x.position", 2.0),
        ("ball/world.y.position", 0.0),
    ] {
        let features = &world.description().state;
        let place = features.iter().position(|feature| feature.name == name).expect(name);
        assert!((state[place] - expected).abs() < 1e-6, "{name}: {}", state[place]);
        compared += 1;
    }
    // Of the joints, 10 positions and 9 velocities.
    assert_eq!(state.len(), compared + 19);
}

#[test]
fn agents_with_local_observations_see_what_their_own_robot_and_objects_see() {
    let world = team(VIEWS, ObservationMode::KNearest).unwrap();
    let seen = |agent: usize| {
        let features = &world.description().agents[agent].observation;
        features.iter().map(|feature| feature.name.clone()).collect::<Vec<_>>()
    };
    let (left, right) = (seen(0), seen(1));
    for (name, of_left, of_right) in [
        ("ball/left.x.position", true, false),
        ("left/right.y.velocity", false, true),
        ("goal/ball.x.position", true, true),
        ("ball/world.y.position", true, true),
        ("ball.z.position", true, true),
    ] {
        let found = [&left, &right].map(|seen| seen.iter().any(|own| own == name));
        assert_eq!(found, [of_left, of_right], "{name}");
    }
    // Its own speed is one of its joints; as a global feature, that of the other cart is not shown.
    assert!(!left.contains(&"right_x.velocity".to_owned()), "{left:?}");
}

#[test]
fn terms_of_bodies_have_their_formulas() {
    // After the step of 0.05 s, the ball is at (1, 0.15, 0.1).
    let spread = (4.0225_f32.sqrt() + 1.0325_f32.sqrt() + 9.01_f32.sqrt()) / 3.0;
    for (term, expected) in [
        ("term = \"distance\"\nof = \"ball\"\nto = [1.0, 0.0, 0.5]\nalong = [\"x\", \"y\"]", 0.15),
        ("term = \"distance\"\nof = \"ball\"\nto = [1, 0, 0.1]\nsigma = 0.15", libm::expf(-1.0)),
        ("term = \"distance\"\nof = \"ball\"\nto = \"goal\"", 4.0225_f32.sqrt()),
        ("term = \"approach\"\nof = \"ball\"\nto = \"goal\"\nalong = [\"y\"]", -3.0),
        ("term = \"progress\"\nof = \"ball\"\nalong = [\"y\"]", 3.0),
        ("term = \"progress\"\nof = \"left\"", 1.0),
        ("term = \"height\"\nof = \"ball\"", 0.1),
        ("term = \"spread\"\nbodies = [\"ball\", \"goal\", \"world\"]", spread),
        ("term = \"upright\"\nof = \"ball\"", 1.0),
        // The ball turns by 0.2 rad.
        (
            "term = \"velocity_tracking\"\nsigma = 0.5\n[command]\nof = \"ball\"\nforward = [0, 0]\nsideways = [3, 3]",
            libm::expf(-18.0 * (1.0 - libm::cosf(0.2)) / 0.25),
        ),
    ] {
        let found = reward(term);
        assert!((found - expected).abs() < 1e-5, "{term}: {found}");
    }
}

#[test]
fn a_term_of_the_root_is_a_warning_if_several_robots_have_motors() {
    let warnings = |term: &str| {
        let lines = format!("[[reward]]\nweight = 1.0\nterm = {term}\n");
        team(&lines, ObservationMode::FullId).unwrap().warnings().concat()
    };
    let warned = warnings("\"forward_speed\"");
    let expected = "several robots have motors: `reward.forward_speed` read that of `left.left_x`; name a body";
    assert!(warned.contains(expected), "{warned}");
    let named = warnings("\"forward_speed\"\ncoordinate = \"right_x\"");
    assert!(!named.contains("several robots"), "{named}");
}

#[test]
fn an_episode_ends_by_a_feature_of_bodies() {
    for (bound, ends) in [("above = 1.9", false), ("below = 1.9", true)] {
        let lines = format!("{VIEWS}[[healthy]]\nfeature = \"goal/ball.x.position\"\n{bound}\n");
        let mut outcome = [Outcome::default()];
        team(&lines, ObservationMode::FullId).unwrap().step(&[0.0; 3], &mut outcome).unwrap();
        assert_eq!(outcome[0].terminated, ends, "{bound}");
    }
}

#[test]
fn noise_of_single_coordinates_moves_only_them() {
    let file = FILE.replace("[start]", "[start]\nnoise = { \"ball.y\" = { uniform = 0.5 } }");
    let mut config = config(&file, ObservationMode::FullId);
    config.task = "team-2".to_owned();
    config.definition.as_mut().unwrap().model = MODEL.to_owned();
    let mut world = environments(&config, 1).unwrap();
    world.reset(0, 0, 100, [2; 32]).unwrap();
    let (moved, still) =
        (world.state_of(0), team("", ObservationMode::FullId).unwrap().state_of(0));
    // The features are the coordinates, of which the fifth is the ball's y, and the velocities.
    let changed: Vec<usize> = (0..moved.len()).filter(|k| moved[*k] != still[*k]).collect();
    assert_eq!(changed, [4]);
    assert!(moved[4].abs() <= 0.5);
}

#[test]
fn invalid_rows_of_bodies_are_refused_with_their_key() {
    let row = |lines: &str| format!("[[state.bodies]]\n{lines}\n");
    let term = |lines: &str| format!("[[reward]]\nweight = 1.0\n{lines}\n");
    for (lines, part) in [
        (row("of = \"bal\""), "state.bodies.of: the robot has no body `bal`; did you mean `ball`?"),
        (row("of = \"ball\"\nfrom = \"lef\""), "state.bodies.from: the robot has no body `lef`"),
        (
            row("of = \"ball\"\nfeatures = []"),
            "state.bodies (ball/world): `features` or `along` is empty",
        ),
        (
            [row("of = \"ball\""), row("of = \"ball\"")].concat(),
            "state.bodies states the feature `ball/world.x.position` twice",
        ),
        (term("term = \"height\""), "reward.height needs the key `of`"),
        (term("term = \"height\"\nof = \"cup\""), "reward.height.of: the robot has no body `cup`"),
        (term("term = \"approach\"\nof = \"ball\""), "reward.approach needs the key `to`"),
        (
            term("term = \"distance\"\nof = \"ball\"\nto = 3"),
            "`to` must be the name of a body or a point [x, y, z]",
        ),
        (
            term("term = \"distance\"\nof = \"ball\"\nto = [0, 0, nan]"),
            "reward.distance.to must lie in -100000..=100000, is NaN",
        ),
        (
            term("term = \"progress\"\nof = \"ball\"\nalong = [\"x\", \"y\"]"),
            "reward.progress.along must name one axis",
        ),
        (
            term("term = \"spread\"\nbodies = [\"ball\"]"),
            "reward.spread.bodies must name at least two bodies",
        ),
        (term("term = \"alive\"\nof = \"ball\""), "reward.alive has no key `of`"),
        (
            term("term = \"upright\"\nof = \"cup\""),
            "reward.upright.of: the robot has no body `cup`",
        ),
        (term("term = \"upright\""), "reward.upright needs a free root or a planar root"),
        (term("term = \"upright\"\nof = \"goal\""), "reward.upright is constant, because its body"),
        (
            "[[healthy]]\nfeature = \"upright\"\nof = \"world\"\nabove = 0\n".to_owned(),
            "healthy.upright is constant, because its body is fixed to the world; name one that moves",
        ),
        (
            "[[healthy]]\ncoordinate = \"ball.x\"\nof = \"ball\"\nabove = 0\n".to_owned(),
            "healthy has the key `of` only with `feature = \"upright\"`",
        ),
        (
            "[start.noise]\n\"ball.w\" = { uniform = 0.1 }\n".to_owned(),
            "start.noise: the robot has no coordinate `ball.w`",
        ),
    ] {
        let message = team(&lines, ObservationMode::FullId).err().expect(part);
        assert!(message.contains(part) && !message.contains('\n'), "{part}: {message}");
    }
}

#[test]
fn a_body_is_not_measured_from_itself() {
    let row = |lines: &str| format!("[[state.bodies]]\n{lines}\n");
    let term = |lines: &str| format!("[[reward]]\nweight = 1.0\n{lines}\n");
    for (lines, part) in [
        (
            row("of = \"ball\"\nfrom = \"ball\""),
            "state.bodies (ball/ball): `of` and `from` are the same body; name another one",
        ),
        (row("of = \"world\""), "state.bodies (world/world): `of` and `from` are the same body"),
        (
            term("term = \"distance\"\nof = \"ball\"\nto = \"ball\""),
            "reward.distance measures from `ball` to itself; name another body or a point in `to`",
        ),
        (
            term("term = \"approach\"\nof = \"ball\"\nto = \"ball\""),
            "reward.approach measures from `ball` to itself",
        ),
    ] {
        let message = team(&lines, ObservationMode::FullId).err().expect(part);
        assert!(message.contains(part) && !message.contains('\n'), "{part}: {message}");
    }
}

#[test]
fn a_bound_that_an_episode_cannot_end_by_is_refused() {
    let with = |condition: &str| {
        let state = "[state]\nlargest_velocity = 5\n";
        team(&format!("{state}{VIEWS}[[healthy]]\n{condition}\n"), ObservationMode::FullId)
    };
    for (condition, part) in [
        (
            "feature = \"ball.y.velocity\"\nat_most = 8",
            "healthy.ball.y.velocity.at_most = 8 has no effect, since the number is always in -5..=5, by state.largest_velocity;",
        ),
        (
            "feature = \"ball/left.x.velocity\"\nabove = -6",
            "healthy.ball/left.x.velocity.above = -6 has",
        ),
        ("feature = \"upright\"\nof = \"ball\"\nat_least = -1", "the number is always in -1..=1;"),
        ("feature = \"ball/left.qw.position\"\nabove = -0.5", "the number is always in 0..=1;"),
        ("coordinate = \"ball.qz\"\nbelow = 1.5", "healthy.ball.qz.below = 1.5 has no effect"),
        ("feature = \"ball.qz.position\"\nbelow = 1.5", "the number is always in -1..=1;"),
    ] {
        let message = with(condition).err().expect(condition);
        assert!(message.contains(part) && !message.contains('\n'), "{part}: {message}");
    }
    for condition in
        ["feature = \"ball.y.velocity\"\nbelow = 5", "coordinate = \"ball.z\"\nbelow = 8"]
    {
        assert_eq!(with(condition).err(), None, "{condition}");
    }
}

#[test]
fn what_is_constant_between_bodies_of_a_link_is_refused() {
    let hand = "<body name=\"hand\" pos=\"0 0 0.1\"/>";
    let model = MODEL.replace(
        "<joint name=\"left_yaw\" axis=\"0 0 1\"/><geom/>",
        &format!("<joint name=\"left_yaw\" axis=\"0 0 1\"/><geom/>{hand}"),
    );
    let message = |lines: &str| {
        let mut config = config(&format!("{FILE}{lines}"), ObservationMode::FullId);
        config.task = "team-2".to_owned();
        config.definition.as_mut().unwrap().model = model.clone();
        environments(&config, 1).err().map(|error| error.to_string()).unwrap_or_default()
    };
    let row = |lines: &str| format!("[[state.bodies]]\nof = \"hand\"\nfrom = \"left\"\n{lines}\n");
    let term = |lines: &str| format!("[[reward]]\nweight = 1.0\n{lines}\n");
    let distance = "term = \"distance\"\nof = \"hand\"\nto = \"left\"";
    let one_link = "its bodies are parts of one link; name one of another link";
    for (lines, part) in [
        (term(distance), one_link),
        (term(&distance.replace("distance", "approach")), one_link),
        (term("term = \"spread\"\nbodies = [\"left\", \"hand\"]"), one_link),
        (term(&format!("{distance}\nalong = [\"x\"]")), ""),
        (term("term = \"spread\"\nbodies = [\"left\", \"hand\", \"right\"]"), ""),
        (
            row(""),
            "(hand/left): `position` is constant, because `hand` and `left` are parts of one link; state",
        ),
        (row("features = [\"angular_velocity\"]"), "`angular_velocity` is constant"),
        (row("features = [\"velocity\"]"), ""),
        (row("features = [\"position\"]\naxes = \"world\""), ""),
        (
            row("features = [\"velocity\"]").replace("left", "world").replace("hand", "goal"),
            "are fixed to the world; state",
        ),
    ] {
        let message = message(&lines);
        assert!(
            message.contains(part) && message.is_empty() == part.is_empty(),
            "{lines}: {message}"
        );
    }
}

#[test]
fn agents_observe_each_feature_once() {
    let with = |global: &str, lines: &str| {
        let file = FILE.replace("\"ball.z.position\"", &format!("\"{global}\""));
        let mut config = config(&format!("{file}{lines}{VIEWS}"), ObservationMode::KNearest);
        config.task = "team-2".to_owned();
        config.definition.as_mut().unwrap().model = MODEL.to_owned();
        environments(&config, 1).map_err(|error| error.to_string())
    };
    // The first cart observes its own speed, which is a global feature, as its joint's, and what it sees of the ball itself.
    let world = with("ball/left.x.position", "").unwrap();
    let features = &world.description().agents[0].observation;
    for feature in features {
        let same = features.iter().filter(|own| own.name == feature.name).count();
        assert!(same == 1 || feature.name == "padding", "{}", feature.name);
    }
    let drawn = "[state]\ndisturbances = \"agents\"\n[disturbance]\naction_delay = [0, 1]\n";
    for (global, lines) in [("goal/ball.x.position", ""), ("disturbance.action_delay", drawn)] {
        let message = with(global, lines).err().expect(global);
        let part =
            format!("neighbourhood.globals: all agents observe `{global}` without it; remove");
        assert!(message.contains(&part), "{message}");
    }
}
