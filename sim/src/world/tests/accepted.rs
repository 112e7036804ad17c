//! Tests of what vendors' models contain: markers, missing control ranges, flags, and messages of several lines.

use std::sync::Arc;

use proto::{ActivationKind, ActuatorKind, ActuatorSpec};

use super::{LOPSIDED, World, document, robot, robot_of_files};
use crate::robot::{Robot, one_document};

/// A robot with an actuator of a joint from -0.5 to 1.5, whose torque is at most 20 N m.
fn driven(actuator: &str) -> Robot {
    driven_from(0.0, actuator)
}

/// As [`driven`], with this coordinate in the rest pose.
fn driven_from(reference: f32, actuator: &str) -> Robot {
    let body = format!(
        "<body pos=\"0 0 1\"><joint name=\"j\" axis=\"0 1 0\" range=\"-0.5 1.5\" ref=\"{reference}\" \
         actuatorfrcrange=\"-20 20\"/><geom size=\"0.1\"/></body>"
    );
    robot(&document(&body, actuator)).unwrap()
}

#[test]
fn the_shown_angle_of_a_joint_is_the_one_that_agents_observe() {
    let world = World::new(Arc::new(driven_from(0.3, "")));
    assert_eq!(world.joint_poses()[0].position, 0.3);
}

/// Control range of such an actuator.
fn range(actuator: &str) -> [f32; 2] {
    driven(actuator).actuators().next().unwrap().control
}

/// The law of a motor on the joint of [`driven`].
fn motor_law() -> ActuatorSpec {
    ActuatorSpec {
        name: "j".to_owned(),
        joint: "j".to_owned(),
        kind: ActuatorKind::Motor,
        control_limits: [-1.0, 1.0],
        gear: 4.0,
        gain: 1.0,
        constant: 0.0,
        kp: 0.0,
        kd: 0.0,
        force_range: None,
        torque_range: Some([-20.0, 20.0]),
        activation: None,
        time_constant_secs: None,
        activation_range: None,
        ball_axis: None,
        link: None,
        link_point: None,
        link_force: None,
        link_torque: None,
    }
}

#[test]
fn the_law_of_an_actuator_has_the_numbers_of_the_model() {
    let motor = motor_law();
    let servo = ActuatorSpec {
        kind: ActuatorKind::Position,
        gain: 50.0,
        kp: 50.0,
        kd: 3.0,
        force_range: Some([-5.0, 6.0]),
        ..motor.clone()
    };
    let speed = ActuatorSpec { kind: ActuatorKind::Velocity, gain: 7.0, kd: 7.0, ..motor.clone() };
    let general = ActuatorSpec {
        kind: ActuatorKind::General,
        gain: 9.0,
        constant: 2.0,
        kp: 50.0,
        kd: 3.0,
        activation: Some(ActivationKind::FilterExact),
        time_constant_secs: Some(0.25),
        activation_range: Some([-2.0, 2.0]),
        ..motor.clone()
    };
    let moved = ActuatorSpec {
        kind: ActuatorKind::General,
        gain: 50.0,
        constant: 2.0,
        kp: 50.0,
        kd: 3.0,
        ..motor.clone()
    };
    for (actuator, expected) in [
        ("motor", motor),
        ("general gainprm=\"50\" biastype=\"affine\" biasprm=\"2 -50 -3\"", moved),
        ("position kp=\"50\" kv=\"3\" forcerange=\"-5 6\"", servo),
        ("velocity kv=\"7\"", speed),
        (
            "general gainprm=\"9\" biastype=\"affine\" biasprm=\"2 -50 -3\" dyntype=\"filterexact\" dynprm=\"0.25\" \
             actrange=\"-2 2\"",
            general,
        ),
    ] {
        let actuator = format!("<{actuator} joint=\"j\" gear=\"4\" ctrlrange=\"-1 1\"/>");
        assert_eq!(driven(&actuator).actuator_spec(0), expected, "{actuator}");
        // The law is for the joint's coordinate as agents observe it, whatever its reference.
        assert_eq!(driven_from(0.3, &actuator).actuator_spec(0), expected, "{actuator}");
    }
}

#[test]
fn the_law_of_an_actuator_on_a_site_or_a_ball_joint_has_its_direction() {
    let law = |joint: &str, actuator: &str| {
        let body = format!(
            "<body pos=\"0 0 1\">{joint}<site name=\"s\" pos=\"0.5 0 0\" euler=\"0 0 1.57079633\"/><geom size=\"0.1\"/></body>"
        );
        robot(&document(&body, actuator)).unwrap().actuator_spec(0)
    };
    let near = |found: Option<[f32; 3]>, expected: [f32; 3]| {
        let found = found.unwrap();
        let is_near = found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6);
        assert!(is_near, "{found:?} against {expected:?}");
    };
    // The site's x axis is the link's y axis.
    let free = "<freejoint/>";
    let site = law(free, "<motor site=\"s\" gear=\"4 0 0 0 0 -2\" ctrlrange=\"-1 1\"/>");
    assert!(site.joint == "s" && (site.gear - 4.0).abs() < 1e-6, "{site:?}");
    assert!(site.link.is_some() && site.ball_axis.is_none());
    near(site.link_point, [0.5, 0.0, 0.0]);
    near(site.link_force, [0.0, 1.0, 0.0]);
    near(site.link_torque, [0.0, 0.0, -0.5]);
    let ball = "<joint name=\"j\" type=\"ball\"/>";
    let one = law(ball, "<motor joint=\"j\" gear=\"0 0 3\" ctrlrange=\"-1 1\"/>");
    assert_eq!((one.gear, one.ball_axis, one.link), (3.0, Some([0.0, 0.0, 1.0]), None));
    let several = law(ball, "<motor joint=\"j\" gear=\"1 0 3\" ctrlrange=\"-1 1\"/>");
    assert_eq!((several.gear, several.ball_axis), (1.0, Some([1.0, 0.0, 3.0])));
}

#[test]
fn a_missing_control_range_follows_from_those_of_the_joint_and_the_force() {
    for (actuator, expected) in [
        ("<position joint=\"j\" kp=\"5\"/>", [-0.5, 1.5]),
        ("<position joint=\"j\" kp=\"5\" inheritrange=\"0.5\"/>", [0.0, 1.0]),
        ("<position joint=\"j\" kp=\"5\" gear=\"-2\"/>", [-3.0, 1.0]),
        ("<motor joint=\"j\" gear=\"4\"/>", [-5.0, 5.0]),
        ("<motor joint=\"j\" gear=\"4\" forcerange=\"-2 3\"/>", [-2.0, 3.0]),
        ("<motor joint=\"j\" ctrllimited=\"false\" ctrlrange=\"-1 1\"/>", [-20.0, 20.0]),
        ("<motor joint=\"j\" ctrlrange=\"-1 1\"/>", [-1.0, 1.0]),
    ] {
        assert_eq!(range(actuator), expected, "{actuator}");
    }
}

#[test]
fn a_mocap_body_is_fixed_in_both_documents() {
    let marker = "<body name=\"target\" mocap=\"true\" pos=\"1 0 1\">\
        <geom size=\"0.02\" contype=\"0\" conaffinity=\"0\"/><body name=\"tip\"/></body>";
    let mesh = "<geom type=\"mesh\" mesh=\"trough\"/>";
    let legs = "<body name=\"leg\"><joint name=\"j\"/><geom size=\"0.1\"/></body>";
    let mjcf = document(&format!("<body name=\"a\">{mesh}</body>{marker}{legs}"), "");
    let mjcf =
        mjcf.replace("<worldbody>", "<asset><mesh file=\"parts/trough.obj\"/></asset><worldbody>");
    let read = |path: &str| match path {
        "a.xml" => Ok(mjcf.clone().into_bytes()),
        _ => Ok(super::trough().into_bytes()),
    };
    let direct = robot_of_files(&mjcf, &read).unwrap();
    let flat = robot(&one_document("a.xml", read).unwrap()).unwrap();
    for robot in [direct, flat] {
        assert_eq!(robot.bodies(), ["world", "a", "target", "tip", "leg"]);
        assert_eq!(robot.coordinate_names(), ["j"]);
    }
}

/// As in MuJoCo 4.0.0.
#[test]
fn of_a_class_that_acts_early_only_general_actuators_do() {
    let body = "<body><joint name=\"j\" range=\"-1 1\"/><geom size=\"0.1\"/></body>";
    let is_early = |default: &str, actuator: &str| {
        let actuator = format!("<{actuator} joint=\"j\" ctrlrange=\"-1 1\"/>");
        let class = format!("<default><general actearly=\"true\"/>{default}</default><worldbody>");
        let mjcf = document(body, &actuator).replace("<worldbody>", &class);
        robot(&mjcf).unwrap().blueprint.motors[0].activation.unwrap().is_early
    };
    let (filter, servo) =
        ("general dyntype=\"filter\" dynprm=\"0.1\"", "position timeconst=\"0.1\"");
    assert!(is_early("", filter) && !is_early("", servo));
    assert!(!is_early("<position kp=\"3\"/>", filter));
}

/// MuJoCo 4.0.0 has these names and places.
#[test]
fn replicated_elements_are_moved_and_turned_and_have_numbers() {
    let leg = "<body name=\"leg\" pos=\"0 0.2 0\"><joint name=\"j\"/><geom size=\"0.1\"/></body>";
    let turn = std::f64::consts::FRAC_PI_2;
    let legs = format!(
        "<replicate count=\"4\" sep=\"_\" offset=\"1 0 0.1\" euler=\"0 0 {turn}\">{leg}</replicate>"
    );
    let robot = robot(&document(&legs, "")).unwrap();
    assert_eq!(robot.bodies(), ["world", "leg_0", "leg_1", "leg_2", "leg_3"]);
    assert_eq!(robot.coordinate_names(), ["j_0", "j_1", "j_2", "j_3"]);
    let places = [[0.0, 0.2, 0.0], [0.8, 0.0, 0.1], [1.0, 0.8, 0.2], [0.2, 1.0, 0.3]];
    for (body, place) in (1..).zip(places) {
        let found = robot.place(body).motion(&[0.0; 4], &[0.0; 4]).position.to_array();
        let off = found.iter().zip(place).map(|(a, b): (&f64, f64)| (a - b).abs());
        assert!(off.fold(0.0, f64::max) < 1e-6, "{body}: {found:?}");
    }
    let many = document(&legs.replace("\"4\"", "\"10\""), "");
    assert_eq!(super::robot(&many).unwrap().bodies()[10], "leg_09");
    let none = super::robot(&many.replace("\"10\"", "\"0\"")).err().unwrap();
    assert!(none.contains("<replicate>: `count` must be at least 1"), "{none}");
    let endless = super::robot(&many.replace("\"10\"", "\"2000000000\"")).err().unwrap();
    assert!(
        endless.contains("<replicate>: the model has more than 20000 elements; remove some"),
        "{endless}"
    );
}

/// MuJoCo 4.0.0 has these places (`xpos`): the rotation of a copy has the angles of `euler` times its index.
#[test]
fn copies_that_turn_about_several_axes_have_multiples_of_their_angles() {
    let [degrees, radians] = ["<compiler/>", "<compiler angle=\"radian\" eulerseq=\"ZyX\"/>"];
    for (compiler, step, places) in [
        (
            degrees,
            "offset=\"0 0 1\" euler=\"90 90 0\"",
            [[1.0, 0.0, 0.0], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]],
        ),
        (
            degrees,
            "offset=\".3 .02 .1\" euler=\"10 20 30\"",
            [[1.0, 0.0, 0.0], [1.113798, 0.563838, -0.104874], [0.951967, 1.107018, 0.131642]],
        ),
        (
            radians,
            "offset=\".3 .02 .1\" euler=\".3 .5 -.4\"",
            [[1.0, 0.0, 0.0], [1.138387, 0.072174, -0.442573], [1.037338, -0.29061, -0.800007]],
        ),
        (
            degrees,
            "offset=\".3 .02 .1\" euler=\"0 20 0\"",
            [[1.0, 0.0, 0.0], [1.239693, 0.02, -0.24202], [1.382154, 0.04, -0.551424]],
        ),
    ] {
        let robot = robot(&format!(
            "<mujoco>{compiler}<worldbody><replicate count=\"3\" {step}><body name=\"r\" pos=\"1 0 0\"><joint/>\
             <geom size=\".1\"/></body></replicate></worldbody></mujoco>"
        ));
        let robot = robot.unwrap();
        for (body, place) in (1..).zip(places) {
            let found = robot.place(body).motion(&[0.0; 3], &[0.0; 3]).position.to_array();
            let off = found.iter().zip(place).map(|(a, b): (&f64, f64)| (a - b).abs());
            assert!(off.fold(0.0, f64::max) < 2e-6, "{step} {body}: {found:?}");
        }
    }
}

#[test]
fn without_contacts_walls_touch_nothing() {
    let wall = format!("<geom type=\"box\" size=\"1 1 1\"/>{LOPSIDED}");
    let off = document(&wall, "")
        .replace("/><worldbody>", "><flag contact=\"disable\"/></option><worldbody>");
    assert!(off.contains("disable"));
    let robot = robot(&off).unwrap();
    assert!(robot.blueprint.grounds.is_empty() && robot.left_out().is_empty());
}

/// MuJoCo 4.0.0 loads it.
#[test]
fn an_empty_reference_or_orientation_counts_as_none() {
    let body = "<body quat=\"\" zaxis=\"\"><joint name=\"j\"/><geom name=\"\" mesh=\"\" size=\"0.1\"/></body>";
    let motor = "<motor joint=\"\" jointinparent=\"j\" ctrlrange=\"-1 1\"/>";
    robot(&document(body, motor)).unwrap();
}

#[test]
fn everything_that_cannot_be_built_is_named_in_lines_of_their_own() {
    let bodies = "<body><joint name=\"a\" type=\"ball\" range=\"1 2\"/>\n<geom type=\"hfield\"/>\n\
        <body><joint name=\"b\" damping=\"-1\"/></body></body>";
    let actuators = "\n<motor joint=\"a\" ctrlrange=\"-1 1\"/>\n<muscle joint=\"b\"/>";
    let text = robot(&document(bodies, actuators)).err().unwrap();
    let lines: Vec<&str> = text.lines().map(str::trim).collect();
    assert!(lines[0].ends_with("5 things are not supported:"), "{text}");
    for (line, start) in lines[1..].iter().zip([
        "(1) line 4, <geom>: a height field must be fixed to the world",
        "(2) line 3, <joint name=\"a\">: the `range` of a ball joint",
        "(3) line 5, <joint name=\"b\">: `damping` must lie in 0..=",
        "(4) line 5, <body>: a body that moves must have a mass",
        "(5) line 9, <muscle joint=\"b\">: this actuator",
    ]) {
        assert!(line.starts_with(start), "{line} instead of {start}");
    }
}

#[test]
fn a_second_end_of_the_root_is_ignored() {
    let mjcf = document(LOPSIDED, "");
    assert!(robot(&format!("{mjcf}\n</mujoco> </mujoco>\n")).is_ok());
    assert!(robot(&format!("{mjcf}</body></mujoco>")).is_err());
}

#[test]
fn a_default_is_named_with_its_own_line_and_the_element_that_has_it() {
    let defaults = "<default>\n<joint stiffness=\"1\"/>\n</default><option magnetic=\"0 0 1\"/>\n<option density=\"0\"/>";
    let free =
        "<body pos=\"0 0 1\"><joint name=\"root\" type=\"free\"/><geom size=\"0.1\"/></body>";
    let mjcf = document(free, "").replace("<worldbody>", &format!("{defaults}<worldbody>"));
    let text = robot(&mjcf).err().unwrap();
    let stiffness = "line 2, <joint>: `stiffness` of a free joint must be 0; use <freejoint/>, or set stiffness=\"0\" here; \
        it is the default of line 6, <joint name=\"root\">";
    assert!(text.contains(stiffness), "{text}");
    assert!(
        text.contains("line 3, <option>: magnetic=\"0 0 1\" is not supported; set 0 -0.5 0"),
        "{text}"
    );
}

/// In MuJoCo 4.0.0, `tendon_lengthspring` of these tendons is 0.523599 for the automatic length, less the 0.174533 of the
/// rest pose here; two lengths are what they say.
#[test]
fn the_spring_of_a_tendon_rests_where_the_springs_of_its_joints_do_unless_lengths_are_stated() {
    let joint = "<body pos=\"0 0 9\"><joint name=\"j\" ref=\"0.174533\" springref=\"0.523599\"/>\
        <geom size=\"0.1\"/></body>";
    let cases = [
        ("", [0.349066; 2]),
        ("springlength=\"-1\"", [0.349066; 2]),
        ("springlength=\"-1 1\"", [-1.174533, 0.825467]),
    ];
    for (lengths, expected) in cases {
        let tendon =
            format!("<tendon><fixed {lengths}><joint joint=\"j\" coef=\"1\"/></fixed></tendon>");
        let mjcf = document(joint, "").replace("</mujoco>", &format!("{tendon}</mujoco>"));
        let found = robot(&mjcf).unwrap().blueprint.tendons[0].slack;
        let off = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(off < 1e-6, "{lengths}: {found:?}");
    }
}

#[test]
fn flags_with_mujocos_defaults_are_accepted_and_other_values_of_them_refused() {
    let flagged = |flags: &str| {
        let option = format!("><flag {flags}/></option><worldbody>");
        robot(&document(LOPSIDED, "").replace("/><worldbody>", &option))
    };
    for (flag, value, other) in [
        ("spring", "enable", "disable"),
        ("damper", "enable", "disable"),
        ("passive", "enable", "disable"),
        ("sleep", "disable", "enable"),
        ("override", "disable", "enable"),
    ] {
        assert_eq!(flagged(&format!("{flag}=\"{value}\"")).unwrap().left_out(), [""; 0]);
        let stated = format!("{flag}=\"{other}\"");
        let reason = flagged(&stated).err().unwrap();
        assert!(reason.contains(&format!("{stated} is not supported; remove it")), "{reason}");
    }
}

/// MuJoCo 4.0.0 has this mass, mass centre and these principal moments.
#[test]
fn a_mesh_is_seen_from_its_reference_frame_before_it_is_scaled() {
    let mesh = "<asset><mesh name=\"m\" vertex=\"0 0 0 1 0 0 0 2 0 0 0 3\" refpos=\".1 .2 .3\" refquat=\"2 1 0 .5\" \
        scale=\"1 2 -1\" inertia=\"exact\"/></asset>";
    let body = "<body name=\"b\"><freejoint/><geom type=\"mesh\" mesh=\"m\"/></body>";
    let mjcf = document(body, "").replace("<worldbody>", &format!("{mesh}<worldbody>"));
    let built = robot(&mjcf).unwrap();
    let mass = &built.blueprint.links[0].mass;
    let mut moments = mass.principal_inertia().to_array();
    moments.sort_by(f32::total_cmp);
    let found = [&[mass.mass()], &mass.local_com.to_array()[..], &moments].concat();
    let expected = [2000.0, 0.335714, 0.885714, -0.078571, 472.472, 1909.126, 2291.191];
    for (got, want) in found.iter().zip(expected) {
        assert!((got - want).abs() <= 1e-4 * want.abs(), "{found:?}");
    }
    let turned = robot(&mjcf.replace("2 1 0 .5", "0 0 0 0")).err().unwrap();
    assert!(turned.contains("`refquat` has no direction"), "{turned}");
}

#[test]
fn a_spatial_tendon_that_exerts_no_force_is_accepted() {
    for attributes in ["", "stiffness=\"0\" damping=\"0.0\"", "limited=\"false\" range=\"0 .5\""] {
        let tendon = format!("<tendon><spatial {attributes}/></tendon></mujoco>");
        let mjcf = document(LOPSIDED, "").replace("</mujoco>", &tendon);
        assert!(robot(&mjcf).is_ok(), "{attributes}");
    }
}
