//! Task files with absurd values: each is refused by the name of its key, or runs without NaN.

use super::*;

/// A task file with every key, for a robot with a free joint and a wall.
const EVERYTHING: &str = concat!(
    r#"
robot = "hostile"
model = "ant.xml"
frame_skip = 2
episode_steps = 20

[agents]
2x4 = [["hip_4", "ankle_4", "hip_1", "ankle_1"], ["hip_2", "ankle_2", "hip_3", "ankle_3"]]

[[reward]]
term = "forward_speed"
coordinate = "root.x"
weight = 1.0

[[reward]]
term = "target_distance"
weight = 0.5
target = { "root.x" = 3.0, "root.y" = 0.0 }

[[reward]]
term = "in_range"
weight = 0.5
coordinate = "root.z"
range = [0.2, 1.0]

[[reward]]
term = "velocity_tracking"
weight = 1.0
components = ["forward", "yaw"]
sigma = 0.5

[[reward]]
term = "distance"
weight = 0.5
of = "torso"
to = [3.0, 0.0, 0.5]
along = ["y", "z"]
sigma = 0.5

[[reward]]
term = "spread"
weight = 0.5
bodies = ["torso", "world"]

[[cost]]
term = "action_rate"
weight = 0.1

[[healthy]]
coordinate = "root.z"
above = 0.1
at_least = 0.2
below = 2.0
at_most = 1.5

[[healthy]]
feature = "upright"
above = -0.9

[start]
keyframe = "home"
coordinates = { "root.z" = 0.8, hip_1 = 0.1 }
positions = { uniform = 0.01 }
noise = { "root.y" = { uniform = 0.05 } }
velocities = { normal = 0.1 }

[actions]
around = "start"
scale = 0.5

[state]
hidden = ["root.x"]
largest_velocity = 10.0
angular_velocity = "body"
contact_forces = true
disturbances = "critic"

[[state.bodies]]
of = "torso"
from = "thigh_1"
features = ["position", "orientation"]
along = ["x"]
axes = "world"

[command]
forward = [0.0, 1.0]
sideways = [0.0, 0.0]
yaw = [-0.5, 0.5]

[disturbance]
in_evaluations = true
"#,
    include_str!("disturbance.toml"),
    r#"axes = ["x", "y"]

[[disturbance.payload]]
link = "torso"
mass = [0.5, 1.0]

[[disturbance.terrain]]
body = "world"
height = [0.0, 0.1]

[neighbourhood]
edges = [["hip_1", "ankle_1"]]
touching = [{ joint = "hip_1", bodies = ["torso"] }]
globals = ["root.z.position"]

[physics]
integration = "euler"
margin = 0.001
self_contacts = false
limits = { time_constant_secs = 0.02, impedance = [0.9, 0.95], width = 0.001 }
contacts = { time_constant_secs = 0.02, impedance = [0.9, 0.95], width = 0.001 }
"#,
);

fn environments_of(file: &str) -> Result<Box<dyn EnvironmentBatch>, String> {
    let mut config = config(file, ObservationMode::FullId);
    config.task = "hostile-2x4".to_owned();
    let model = include_str!("../../../assets/ant.xml").replace(
        "<geom name=\"floor\"",
        "<geom type=\"box\" size=\"1 1 0.1\" pos=\"9 0 0\" conaffinity=\"1\"/><geom name=\"floor\"",
    );
    let servo = model.replace("<motor name=\"hip_4\"", "<position kp=\"1\" name=\"hip_4\"");
    let model = servo.replace("joint=\"hip_4\" gear=\"150\"", "joint=\"hip_4\"");
    let keyframe = "<keyframe><key name=\"home\" qpos=\"0 0 0.75 1 0 0 0 0 1 0 -1 0 -1 0 1\"/></keyframe></mujoco>";
    config.definition.as_mut().unwrap().model = model.replace("</mujoco>", keyframe);
    environments(&config, 1).map_err(|error| error.to_string())
}

/// Plays some steps, and returns whether all numbers are finite.
fn runs(world: &mut dyn EnvironmentBatch) -> bool {
    world.reset(0, 0, 20, [3; 32]).unwrap();
    let agents: usize = world.description().agents.iter().map(|agent| agent.action.size).sum();
    let mut outcome = [Outcome::default()];
    for step in 0..5 {
        world.step(&vec![(step % 2) as f32; agents], &mut outcome).unwrap();
        if outcome[0].terminated || outcome[0].truncated {
            break;
        }
    }
    outcome[0].reward.is_finite() && world.state_of(0).iter().all(|number| number.is_finite())
}

/// Bytes of a value: to the end of its brackets, or of its word.
fn length(value: &str) -> usize {
    let mut depth = 0_i32;
    for (at, letter) in value.char_indices() {
        depth += match letter {
            '[' | '{' => 1,
            ']' | '}' => -1,
            _ => 0,
        };
        match (depth, letter) {
            (0, ']' | '}') => return at + 1,
            (0, ',' | '\n') | (-1, _) => return at,
            _ => {}
        }
    }
    value.len()
}

/// Keys and the places of their values, with those of inline tables.
fn values() -> Vec<(&'static str, std::ops::Range<usize>)> {
    let place = |(at, sign): (usize, &str)| {
        let key = EVERYTHING[..at].rsplit(['\n', ' ']).next().unwrap().trim_matches('"');
        let start = at + sign.len();
        (key, start..start + length(&EVERYTHING[start..]))
    };
    EVERYTHING.match_indices(" = ").map(place).collect()
}

#[test]
fn an_absurd_value_of_any_key_is_refused_by_its_name_or_does_no_harm() {
    assert!(runs(&mut *environments_of(EVERYTHING).unwrap()));
    let (mut seen, mut wrong) = (0, Vec::new());
    for (key, place) in values() {
        for value in [
            "nan",
            "inf",
            "-inf",
            "1e30",
            "-1e300",
            "1e-30",
            "-1",
            "0",
            "99999999999",
            "\"\"",
            "\"lost\"",
            "[]",
            "{}",
            "true",
            "[nan, nan]",
            "[1e30, 1e30]",
            "[2.0, 1.0]",
            "[-1e30, 1e30]",
            "[0, 4000000000]",
            "[1, 2, 3]",
            "[\"lost\"]",
            "[[]]",
            "{ uniform = inf }",
            "{ normal = -1 }",
            "{ \"root.z\" = nan }",
        ] {
            seen += 1;
            let mut file = EVERYTHING.to_owned();
            file.replace_range(place.clone(), value);
            let result = environments_of(&file).map(|mut world| runs(&mut *world));
            let line = EVERYTHING[..place.start].rsplit('\n').next().unwrap();
            let outer = line.split(' ').next().unwrap();
            let is_right = match &result {
                Ok(is_finite) => *is_finite,
                Err(reason) => {
                    let is_named = [key, outer, "line ", "agents", "there is no task"]
                        .iter()
                        .any(|word| reason.contains(word));
                    is_named && !reason.contains('\n')
                }
            };
            if !is_right {
                wrong.push(format!("{key} = {value}: {result:?}"));
            }
        }
    }
    assert!(wrong.is_empty() && seen > 1500, "{seen}\n{}", wrong.join("\n"));
}

#[test]
fn an_entry_that_is_stated_twice_is_refused() {
    for (from, to, expected) in [
        (
            "[\"forward\", \"yaw\"]",
            "[\"yaw\", \"yaw\"]",
            "reward.velocity_tracking.components names an entry twice",
        ),
        ("[\"x\", \"y\"]", "[\"x\", \"x\"]", "disturbance.push (torso).axes names an entry twice"),
        ("[\"hip_1\", \"ankle_1\"]", "[\"hip_1\", \"hip_1\"]", "edges names an entry twice"),
        ("[\"root.x\"]", "[\"root.x\", \"root.x\"]", "state.hidden names an entry twice"),
        (
            "[neighbourhood]",
            "[[disturbance.terrain]]\nbody = \"world\"\nheight = [0.0, 1.0]\n[neighbourhood]",
            "disturbance.terrain.body names an entry twice",
        ),
    ] {
        let file = EVERYTHING.replacen(from, to, 1);
        assert_ne!(file, EVERYTHING);
        let reason = environments_of(&file).err().unwrap();
        assert!(reason.contains(expected), "{reason}");
    }
}

#[test]
fn a_value_of_another_type_is_refused_with_the_type_in_words() {
    for (from, to, expected) in [
        ("[\"root.x\"]", "{}", "a table, expected a list; one of tables has rows [[NAME]]"),
        ("[\"root.x\"]", "\"root.x\"", "expected a list, such as [..]"),
    ] {
        let reason = environments_of(&EVERYTHING.replacen(from, to, 1)).err().unwrap();
        assert!(reason.contains(expected), "{reason}");
    }
}

#[test]
fn an_edge_of_a_single_joint_is_refused() {
    let file = EVERYTHING.replacen("[\"hip_1\", \"ankle_1\"]", "[\"hip_1\"]", 1);
    let reason = environments_of(&file).err().unwrap();
    assert!(reason.contains("neighbourhood.edges: an edge needs at least two joints"), "{reason}");
}

#[test]
fn an_array_in_the_place_of_a_table_is_refused() {
    for table in ["sensor_noise", "sensor_bias"] {
        let reason = refusal(&format!("{HOPPER}\n[disturbance]\n{table} = []\n"));
        let expected = format!("`{table}`: invalid type: sequence, expected a table");
        assert!(reason.contains(&expected), "{reason}");
    }
    let reason = refusal(&changed("[state]\nhidden = [\"rootx\"]", "").replacen(
        "robot",
        "state = []\nrobot",
        1,
    ));
    assert!(reason.contains("`state`: invalid type: sequence, expected a table"), "{reason}");
}

#[test]
fn a_model_without_a_name_is_refused() {
    let reason = refusal(&changed("model = \"hopper.xml\"", "model = \"\""));
    assert!(reason.contains("model is empty; name an MJCF file"), "{reason}");
}

/// After a fault, what is observed is what an environment observes that continues from the encoded state.
#[test]
fn after_a_fault_everything_seen_is_that_of_the_state_which_is_encoded() {
    let mut first = environments_of(EVERYTHING).unwrap();
    let mut second = environments_of(EVERYTHING).unwrap();
    first.reset(0, 0, 20, [3; 32]).unwrap();
    let bounds = first.state_bounds().unwrap().clone();
    let mut state = crate::state::State::from_bytes(&first.encode(0).unwrap(), &bounds).unwrap();
    state.velocities[0] = bounds.fastest;
    state.coordinates[0] = bounds.coordinates[0][1];
    first.restore(0, &state.to_bytes(&bounds.kind)).unwrap();
    let mut outcome = [Outcome::default()];
    first.step(&[0.0; 8], &mut outcome).unwrap();
    assert!(outcome[0].fault);
    second.restore(0, &first.encode(0).unwrap()).unwrap();
    assert_eq!(first.state_of(0), second.state_of(0));
    let seen = |world: &dyn EnvironmentBatch| {
        let mut seen = vec![0.0; world.description().agents[0].observation.len()];
        world.observation(0, 0, &mut seen);
        seen
    };
    assert_eq!(seen(&*first), seen(&*second));
}

#[test]
fn keys_without_an_effect_are_refused_with_the_reason() {
    let hidden = "hidden = [\"rootx\"]";
    let critic = changed(hidden, &format!("{hidden}\ndisturbances = \"critic\""));
    let edges = "edges = [[\"hip\", \"knee\"]]";
    let touching = "touching = [{ joint = \"hip\", bodies = [] }]";
    let healthy = |feature: &str| format!("[[healthy]]\nfeature = \"{feature}\"\nabove = -1");
    let drawn = format!("{}\n[command]\nforward = [0, 1]", healthy("command.forward"));
    let approach = "[[reward]]\nterm = \"approach\"\nweight = 1\nof = \"world\"\nto = [1, 0, 0]";
    let added = |lines: &str| format!("{HOPPER}\n{lines}");
    for (file, part) in [
        (added("[command]\nof = \"torso\""), "command.of needs a target: forward, sideways or yaw"),
        (
            added("[disturbance]\nin_evaluations = true"),
            "in_evaluations has no effect without a disturbance; remove",
        ),
        (critic, "state.disturbances has no effect, because [disturbance] states nothing that"),
        (changed(edges, touching), "neighbourhood.touching: the row of `hip` has no bodies; name"),
        (added(approach), "reward.approach is constant, because all its bodies are fixed to the"),
        (
            added("[actions]\naround = \"start\"\nscale = 1"),
            "actions.scale is for servos of the position, and the model has none",
        ),
        (
            added(&healthy("rootx.position")),
            "healthy.feature: state.hidden hides `rootx.position`; write `coordinate = \"rootx\"`",
        ),
        (
            added(&drawn),
            "healthy.feature: `command.forward` is drawn, not measured; name a position",
        ),
    ] {
        let message = refusal(&file);
        assert!(message.contains(part), "{message}");
    }
    for (key, from, to, part) in [
        (
            "joint_damping",
            "damping=\"1\"",
            "",
            "joint_damping is a factor of damping, and no hinge or slide",
        ),
        (
            "slope",
            "gravity=\"0 0 -9.81\"",
            "gravity=\"0 0 0\"",
            "slope tilts the ground under gravity along -z",
        ),
    ] {
        let file = added(&format!("[disturbance]\n{key} = [0, 1]"));
        let mut config = config(&file, ObservationMode::FullId);
        let definition = config.definition.as_mut().unwrap();
        assert!(definition.model.contains(from), "{from}");
        definition.model = definition.model.replace(from, to);
        let message = environments(&config, 1).err().expect(key).to_string();
        assert!(message.contains(part), "{message}");
    }
}
