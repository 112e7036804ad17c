//! What disturbances change of the physics: factors, pushes, slopes and terrain.

use super::disturbances::{action, start, step};
use super::{HOPPER, Robot, changed, config, environments, hopper};
use crate::config::ObservationMode;
use crate::environment_batch::{Disturbances, EnvironmentBatch};

/// Global states of 60 steps of the example with this model and these lines.
fn trace(lines: &str, [from, to]: [&str; 2]) -> Vec<Vec<f32>> {
    let mut config = config(&format!("{HOPPER}\n{lines}"), ObservationMode::FullId);
    let model = &mut config.definition.as_mut().unwrap().model;
    assert!(model.contains(from));
    *model = model.replace(from, to);
    let mut world = environments(&config, 1).unwrap();
    start(&mut *world, 1);
    let state = |index| {
        step(&mut *world, action(index));
        world.state_of(0)
    };
    (0..60).map(state).collect()
}

#[test]
fn factors_of_friction_strength_and_damping_are_those_of_a_changed_model() {
    for (line, change) in [
        ("friction = [0.5, 0.5]", ["friction=\"0.9 ", "friction=\"0.45 "]),
        ("motor_strength = [0.5, 0.5]", ["gear=\"80\"", "gear=\"40\""]),
        ("joint_damping = [2.0, 2.0]", ["damping=\"1\"", "damping=\"2\""]),
    ] {
        let disturbed = trace(&format!("[disturbance]\n{line}"), ["hopper", "hopper"]);
        assert_eq!(disturbed, trace("", change), "{line}");
        assert_ne!(disturbed, trace("", ["hopper", "hopper"]), "{line}");
    }
}

#[test]
fn a_servos_strength_scales_its_torque_at_every_control_and_motion() {
    let servo = |factor: f32| {
        let [kp, kv, force] = [40.0, 2.0, 10.0].map(|number| number * factor);
        format!(
            "<position joint=\"hip\" gear=\"2\" ctrlrange=\"-1 1\" kp=\"{kp}\" kv=\"{kv}\" \
             forcerange=\"-{force} {force}\"/>"
        )
    };
    let (motor, whole, half) =
        ("<motor name=\"hip\" joint=\"hip\" gear=\"80\"/>", servo(1.0), servo(0.5));
    let uneven = "[disturbance]\nmotor_strength = [0.5, 0.5]";
    // The other motor's strength is compensated by its gear.
    let strong = |servo: &str, gear: &str| {
        format!("{servo}<!-- --><motor name=\"knee\" joint=\"knee\" gear=\"{gear}\"/>")
    };
    let both = format!("{motor}\n    <motor name=\"knee\" joint=\"knee\" gear=\"80\"/>");
    let weakened = trace(uneven, [&both, &strong(&whole, "80")]);
    assert_eq!(weakened, trace("", [&both, &strong(&half, "40")]));
}

#[test]
fn a_push_accelerates_the_mass_centre_by_force_over_mass() {
    let start_high = "coordinates = { rootz = 10.0 }\npositions";
    let file = changed("positions", start_high);
    let push = "[[disturbance.push]]\nlink = \"shank\"\nforce = [10, 10]\nduration_secs = 10\nperiod_secs = 10";
    let centre = |disturbances| {
        let mut world = hopper(&format!("{file}\n{push}"));
        world.set_disturbances(disturbances);
        start(&mut *world, 1);
        for _ in 0..20 {
            step(&mut *world, [0.0; 2]);
        }
        world.world(0).unwrap().centre_of_mass()[0]
    };
    let moved = centre(Disturbances::AsInTraining) - centre(Disturbances::Off);
    let mass: f32 = Robot::masses(hopper(HOPPER).robot().unwrap()).map(|(_, m, _)| m).sum();
    // 80 semi-implicit steps of h = 5 ms: F / m h^2 (1 + 2 + ... + 80).
    let expected = 10.0 / mass * 2.5e-5 * 3240.0;
    assert!((moved.abs() / expected - 1.0).abs() < 0.01, "{moved} m against {expected} m");
}

#[test]
fn a_slope_tilts_gravity_by_its_angle() {
    let file = changed("positions", "coordinates = { rootz = 10.0 }\npositions");
    let centre = |disturbances| {
        let mut world = hopper(&format!("{file}\n[disturbance]\nslope = [0.2, 0.2]"));
        world.set_disturbances(disturbances);
        start(&mut *world, 1);
        for _ in 0..20 {
            step(&mut *world, [0.0; 2]);
        }
        world.world(0).unwrap().centre_of_mass()
    };
    let [sloped, flat] = [Disturbances::AsInTraining, Disturbances::Off].map(centre);
    // 80 semi-implicit steps of h = 5 ms: g h^2 (1 + 2 + ... + 80), times the sine, and less the cosine.
    let fall = 9.81 * 2.5e-5 * 3240.0;
    assert!(((sloped[0] - flat[0]).abs() - fall * 0.198_67).abs() < 1e-3, "{sloped:?} {flat:?}");
    assert!((sloped[2] - flat[2] - fall * (1.0 - 0.980_07)).abs() < 1e-3, "{sloped:?} {flat:?}");
}

/// The example half a metre above a box whose upper side is at the height `top`, m, with these lines.
fn over_box(top: f32, lines: &str) -> Box<dyn EnvironmentBatch> {
    let file = changed("positions = { uniform = 0.005 }", "coordinates = { rootz = 0.5 }");
    let mut config = config(&format!("{file}\n{lines}"), ObservationMode::FullId);
    let floor = "<geom name=\"floor\"";
    let steps = format!(
        "<geom type=\"box\" size=\"3 3 0.1\" pos=\"0 0 {}\" conaffinity=\"1\"/>{floor}",
        top - 0.1
    );
    let model = &mut config.definition.as_mut().unwrap().model;
    *model = model.replacen(floor, &steps, 1);
    environments(&config, 1).unwrap()
}

/// Height of the example after it has fallen onto such a box, m.
fn landed(top: f32, lines: &str) -> f32 {
    let mut world = over_box(top, lines);
    start(&mut *world, 1);
    for _ in 0..16 {
        step(&mut *world, [0.0; 2]);
    }
    world.world(0).unwrap().lowest_point()
}

#[test]
fn terrain_raises_the_fixed_shapes_of_its_body() {
    let raised = "[[disturbance.terrain]]\nbody = \"world\"\nheight = [0.3, 0.3]";
    let (low, high, changed) = (landed(0.0, ""), landed(0.3, ""), landed(0.0, raised));
    assert!((high - changed).abs() < 2e-3, "{high} {changed}");
    assert!(high - low > 0.2, "{high} {low}");
}

#[test]
fn a_start_inside_the_highest_terrain_is_a_warning() {
    for (height, is_inside) in [("[0.0, 0.3]", false), ("[0.0, 0.6]", true)] {
        let rows = format!("[[disturbance.terrain]]\nbody = \"world\"\nheight = {height}");
        let warnings = over_box(0.0, &rows).warnings();
        let found = warnings.iter().any(|warning| warning.contains("[[disturbance.terrain]]"));
        assert_eq!(found, is_inside, "{warnings:?}");
    }
}

/// Why the example with this change of its model and these lines is refused.
fn refusal_of([from, to]: [&str; 2], lines: &str) -> String {
    let mut config = config(&format!("{HOPPER}\n{lines}"), ObservationMode::FullId);
    let model = &mut config.definition.as_mut().unwrap().model;
    assert!(model.contains(from), "{from}");
    *model = model.replace(from, to);
    environments(&config, 1).err().expect(lines).to_string()
}

#[test]
fn a_disturbance_of_a_missing_part_is_refused() {
    let floor = "<geom name=\"floor\"";
    let step = format!(
        "<body name=\"step\"><geom type=\"box\" size=\"1 1 0.1\" pos=\"3 0 0\"/></body>{floor}"
    );
    let ball = "<body name=\"ball\" pos=\"5 0 1\"><joint name=\"ball\" type=\"ball\" damping=\"1\" limited=\"false\"/>\
        <geom type=\"sphere\" size=\"0.1\"/></body>";
    let undamped = "damping=\"0\"";
    for (change, lines, part) in [
        (
            [floor, step.as_str()],
            "[[disturbance.terrain]]\nbody = \"step\"\nheight = [0, 0.1]",
            "disturbance.terrain.body: the shapes of `step` are a robot's base, since the model has no free joint; move them",
        ),
        (
            ["conaffinity=\"1\"", "conaffinity=\"2\""],
            "[disturbance]\nfriction = [0.5, 1]",
            "disturbance.friction is a factor of the friction of contacts, and nothing in the model can touch; remove it",
        ),
    ] {
        let message = refusal_of(change, lines);
        assert!(message.contains(part), "{message}");
    }
    let with_ball = format!("{ball}</worldbody>");
    let mut config = config(
        &format!("{HOPPER}\n[disturbance]\njoint_damping = [0.5, 1]"),
        ObservationMode::FullId,
    );
    let model = &mut config.definition.as_mut().unwrap().model;
    *model = model.replace("damping=\"1\"", undamped).replace("</worldbody>", &with_ball);
    let message = environments(&config, 1).err().unwrap().to_string();
    assert!(message.contains("and no hinge or slide of the model has any"), "{message}");
}

/// The example in the plane of y and z, next to these bodies.
fn turned(bodies: &str, lines: &str) -> Box<dyn EnvironmentBatch> {
    let state = "[state]\nhidden = [\"rootx\"]";
    let file = changed(state, &format!("{state}\ndisturbances = \"critic\""));
    let file = file.replacen("\"forward_speed\"", "\"forward_speed\"\ncoordinate = \"rootx\"", 1);
    let mut config = config(&format!("{file}\n{lines}"), ObservationMode::FullId);
    let model = &mut config.definition.as_mut().unwrap().model;
    let torso = "<body name=\"torso\" ";
    assert!(model.contains(torso));
    let quarter = format!("{bodies}{torso}euler=\"0 0 1.5707963\" ");
    *model = model.replacen(torso, &quarter, 1);
    environments(&config, 1).unwrap()
}

/// Whether any of 19 episodes disturbs the horizontal directions x and y by features of this name.
fn directions(mut world: Box<dyn EnvironmentBatch>, name: &str) -> [bool; 2] {
    let mut found = [false; 2];
    for key in 1..20 {
        start(&mut *world, key);
        let state = world.state_of(0);
        for (found, axis) in found.iter_mut().zip(["x", "y"]) {
            let name = format!("disturbance.{name}.{axis}");
            let mut features = world.description().state.iter();
            let place = features.position(|feature| feature.name == name).expect(&name);
            *found |= state[place].abs() > 1e-3;
        }
    }
    found
}

#[test]
fn pushes_and_slopes_have_the_directions_in_which_planar_robots_can_move() {
    let slope = "[disturbance]\nslope = [0.2, 0.2]";
    let push = "[[disturbance.push]]\nlink = \"torso\"\nforce = [9, 9]\nduration_secs = 1\nperiod_secs = 1";
    let other = "<body name=\"other\" pos=\"9 0 1\"><joint name=\"x\" type=\"slide\" axis=\"1 0 0\" limited=\"false\" \
        damping=\"0\" armature=\"0\"/><joint name=\"z\" type=\"slide\" axis=\"0 0 1\" limited=\"false\" damping=\"0\" armature=\"0\"/>\
        <joint name=\"pitch\" limited=\"false\" damping=\"0\" armature=\"0\"/><geom type=\"sphere\" size=\"0.1\"/></body>";
    assert_eq!(directions(turned("", push), "push.torso"), [false, true]);
    assert_eq!(directions(turned("", slope), "gravity"), [false, true]);
    assert_eq!(directions(turned(other, slope), "gravity"), [true, true]);
    let flat = hopper(&changed(
        "hidden = [\"rootx\"]",
        &format!("hidden = [\"rootx\"]\ndisturbances = \"critic\"\n{slope}"),
    ));
    assert_eq!(directions(flat, "gravity"), [true, false]);
}
