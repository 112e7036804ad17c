//! Tests of robots that are loaded from MJCF models: masses and joints against MuJoCo's, one motion with a closed form
//! for each kind of element.

use super::{
    LOPSIDED, STEP, World, assert_continues_bit_for_bit, assert_near, document, motion, reference,
    robot, robot_with, world_of,
};
use crate::robot::{JointPlan, Physics};

/// A world with a floor, a step of a millisecond, and these bodies and actuators.
fn world(bodies: &str, actuators: &str) -> World {
    world_of(&document(bodies, actuators))
}

fn coordinates(world: &World) -> Vec<f32> {
    motion(world).0
}

fn velocities(world: &World) -> Vec<f32> {
    motion(world).1
}

fn hold(world: &mut World, controls: &[f32], secs: f32) {
    for _ in 0..(secs / STEP).round() as u32 {
        assert!(world.step(controls));
    }
}

fn numbers<const N: usize>(value: &serde_json::Value) -> [f32; N] {
    let number = |index: usize| value[index].as_f64().unwrap() as f32;
    std::array::from_fn(number)
}

#[test]
fn masses_centres_inertias_and_joints_are_equal_to_mujocos() {
    let reference = reference();
    for (name, model) in reference["models"].as_object().unwrap() {
        let world = world_of(model["mjcf"].as_str().unwrap());
        let poses = world.link_poses();
        let links = &world.robot().blueprint.links;
        for expected in model["links"].as_array().unwrap() {
            let body = expected["name"].as_str().unwrap();
            let index = links.iter().position(|link| link.name == body).unwrap();
            let what = format!("{name} {body}");
            let mass = expected["mass"].as_f64().unwrap() as f32;
            let (_, got, moments) = world.robot().masses().nth(index).unwrap();
            assert_near(&what, &[got], &[mass], 1e-5 * mass);
            let centre = poses[index].in_world(links[index].mass.local_com.to_array());
            assert_near(&what, &centre, &numbers::<3>(&expected["centre"]), 2e-6);
            let largest = expected["moments"][2].as_f64().unwrap() as f32;
            assert_near(&what, &moments, &numbers::<3>(&expected["moments"]), 1e-5 * largest);
        }
        for expected in model["joints"].as_array().unwrap() {
            let joint = expected["name"].as_str().unwrap();
            let what = format!("{name} {joint}");
            let found = links.iter().zip(&poses).find_map(|(link, pose)| match &link.joint {
                JointPlan::Hinge(hinge) if hinge.name == joint => Some((hinge, pose)),
                _ => None,
            });
            let (hinge, pose) = found.unwrap();
            let anchor = pose.in_world(hinge.anchor.to_array());
            assert_near(&what, &anchor, &numbers::<3>(&expected["anchor"]), 2e-6);
            let mut axis = [0.0; 3];
            axis[hinge.axis.free] = hinge.axis.sign;
            let axis = (hinge.axis.frame * rapier3d::math::Vector::from_array(axis)).to_array();
            let axis = crate::scene::rotated(pose.quaternion, axis);
            assert_near(&what, &axis, &numbers::<3>(&expected["axis"]), 2e-6);
        }
    }
}

#[test]
fn shapes_of_every_kind_come_to_rest_on_the_floor_at_their_heights() {
    let shapes = [
        ("type=\"box\" size=\"0.2 0.3 0.1\"", 0.1),
        ("type=\"cylinder\" size=\"0.2 0.1\"", 0.1),
        ("type=\"cylinder\" size=\"0.1 0.2\" quat=\"1 1 0 0\"", 0.1),
        ("type=\"ellipsoid\" size=\"0.3 0.2 0.1\"", 0.1),
        ("type=\"mesh\" mesh=\"slab\"", 0.1),
    ];
    let corners = [-1, 1].map(|z| [-1, 1].map(|y| [-3, 3].map(|x| format!("0.{x} 0.{y} 0.{z} "))));
    let corners = corners.concat().concat().concat().replace("0.-", "-0.");
    for (shape, height) in shapes {
        let body = format!("<body pos=\"0 0 0.12\"><freejoint/><geom {shape}/></body>");
        let asset = format!("<mujoco><asset><mesh name=\"slab\" vertex=\"{corners}\"/></asset>");
        let mjcf = document(&body, "").replace("<mujoco>", &asset);
        let mut world = world_of(&mjcf);
        hold(&mut world, &[], 1.5);
        let at = coordinates(&world);
        assert_near(shape, &at[2..3], &[height], 2e-3);
        assert_near(shape, &[world.lowest_point()], &[0.0], 2e-3);
        // Neither does it tip over.
        assert_near(shape, &[at[3].abs()], &[1.0], 1e-3);
    }
}

#[test]
fn a_position_actuator_holds_an_angle_against_gravity_as_a_spring_does() {
    // 1 kg at 0.5 m on a level arm: kp (c - q) = m g l cos(q).
    let arm = "<body pos=\"0 0 1\"><joint name=\"j\" axis=\"0 -1 0\" damping=\"2\"/>\
        <geom type=\"sphere\" size=\"0.02\" pos=\"0.5 0 0\" mass=\"1\" contype=\"0\" conaffinity=\"0\"/></body>";
    let mut world = world(arm, "<position joint=\"j\" kp=\"50\" kv=\"3\" ctrlrange=\"-1 1\"/>");
    hold(&mut world, &[0.4], 5.0);
    let mut angle = 0.4_f32;
    for _ in 0..50 {
        angle = 0.4 - 9.81 * 0.5 * libm::cosf(angle) / 50.0;
    }
    assert_near("angle", &coordinates(&world), &[angle], 1e-3);
}

#[test]
fn a_velocity_actuator_reaches_the_speed_at_which_damping_balances_it() {
    // kv (c - v) = d v, with kv = 3, d = 1 and gear 1: v = 0.75 c.
    let wheel = "<body pos=\"0 0 1\"><joint name=\"j\" axis=\"0 0 1\" damping=\"1\"/>\
        <geom type=\"cylinder\" size=\"0.1 0.02\" mass=\"1\"/></body>";
    let mut world = world(wheel, "<velocity joint=\"j\" kv=\"3\" ctrlrange=\"-2 2\"/>");
    hold(&mut world, &[2.0], 1.0);
    assert_near("speed", &velocities(&world), &[1.5], 1e-3);
}

#[test]
fn a_force_range_limits_a_servo_and_a_torque_range_its_joint() {
    // Both accelerate an inertia of 0.5 x 2 x 0.1^2 kg m^2 with 0.05 N m: 5 rad/s^2.
    let accelerated = |joint: &str, actuator: &str| {
        let wheel = format!(
            "<body pos=\"0 0 1\"><joint name=\"j\" axis=\"0 0 1\" {joint}/>\
             <geom type=\"cylinder\" size=\"0.1 0.02\" mass=\"2\"/></body>"
        );
        let mut world = world(&wheel, actuator);
        hold(&mut world, &[1.0], 0.2);
        assert_near(actuator, &velocities(&world), &[1.0], 1e-3);
    };
    accelerated(
        "",
        "<position joint=\"j\" kp=\"9\" ctrlrange=\"-1 1\" forcerange=\"-0.05 0.05\"/>",
    );
    accelerated(
        "actuatorfrcrange=\"-0.05 0.05\"",
        "<motor joint=\"j\" gear=\"3\" ctrlrange=\"-1 1\"/>",
    );
    // Two actuators of one joint add up.
    let half = "<motor joint=\"j\" gear=\"0.025\" ctrlrange=\"-1 1\"/>";
    let wheel = "<body pos=\"0 0 1\"><joint name=\"j\" axis=\"0 0 1\"/>\
        <geom type=\"cylinder\" size=\"0.1 0.02\" mass=\"2\"/></body>";
    let mut both = world(wheel, &half.repeat(2));
    hold(&mut both, &[1.0, 1.0], 0.2);
    assert_near("two motors", &velocities(&both), &[1.0], 1e-3);
}

#[test]
fn a_pendulum_on_a_fixed_base_has_the_period_of_its_inertia() {
    // A rod of 1 m, hinged at its end: T = 2 pi sqrt(2 l / 3 g) for small angles.
    let rod = "<body name=\"stand\" pos=\"0 0 2\"><geom type=\"box\" size=\"0.1 0.1 0.1\" contype=\"0\" conaffinity=\"0\"/>\
        <body name=\"rod\"><joint name=\"j\" axis=\"0 1 0\"/>\
        <geom type=\"box\" size=\"0.005 0.005 0.5\" pos=\"0 0 -0.5\"/></body></body>";
    let mut world = world(rod, "");
    assert_eq!(world.link_poses().len(), 2);
    world.rebuild(&[0.05], &[0.0]);
    let period = std::f32::consts::TAU * (2.0 / (3.0 * 9.81_f32)).sqrt();
    hold(&mut world, &[], period);
    assert_near("angle after a period", &coordinates(&world), &[0.05], 2e-4);
}

#[test]
fn a_slide_falls_onto_its_spring_and_a_reference_shifts_its_coordinate() {
    // k (q - springref) = -m g along the vertical axis, with q = 0.3 in the rest pose.
    let cart = "<body pos=\"0 0 1\">\
        <joint name=\"j\" type=\"slide\" axis=\"0 0 1\" ref=\"0.3\" springref=\"0.3\" stiffness=\"200\" damping=\"30\"/>\
        <geom type=\"box\" size=\"0.1 0.1 0.1\" mass=\"2\"/></body>";
    let mut world = world(cart, "");
    hold(&mut world, &[], 3.0);
    let reference = world.robot().reference()[0];
    assert_near("height", &[coordinates(&world)[0] + reference], &[0.3 - 2.0 * 9.81 / 200.0], 1e-4);
}

#[test]
fn dry_friction_holds_a_joint_below_its_torque_and_not_above() {
    let moved = |friction: f32| {
        let arm = format!(
            "<body pos=\"0 0 1\"><joint name=\"j\" axis=\"0 1 0\" frictionloss=\"{friction}\"/>\
             <geom type=\"sphere\" size=\"0.02\" pos=\"0.5 0 0\" mass=\"1\" conaffinity=\"0\"/></body>"
        );
        let mut world = world(&arm, "");
        hold(&mut world, &[], 0.3);
        coordinates(&world)[0]
    };
    // The weight's torque is 4.9 N m.
    assert!(moved(5.5).abs() < 0.01 && moved(4.0) > 0.03, "{} {}", moved(5.5), moved(4.0));
}

#[test]
fn several_hinges_of_a_body_rotate_it_one_after_the_other() {
    let body = "<body pos=\"0 0 1\"><joint name=\"z\" axis=\"0 0 1\"/><joint name=\"x\" axis=\"1 0 0\"/>\
        <geom type=\"box\" size=\"0.1 0.2 0.3\"/></body>";
    let mut world = world(body, "");
    let quarter = std::f32::consts::FRAC_PI_2;
    world.rebuild(&[quarter, quarter], &[0.0; 2]);
    // The body's y axis first points up, then the outer hinge leaves it there; its x axis points along y.
    let turn = world.link_poses()[1].quaternion;
    assert_near("y axis", &crate::scene::rotated(turn, [0.0, 1.0, 0.0]), &[0.0, 0.0, 1.0], 1e-6);
    assert_near("x axis", &crate::scene::rotated(turn, [1.0, 0.0, 0.0]), &[0.0, 1.0, 0.0], 1e-6);
}

#[test]
fn the_mass_centre_of_an_off_centre_free_robot_follows_a_parabola() {
    let mut world = world(LOPSIDED, "");
    let mut at = world.robot().rest().to_vec();
    at[3..7].copy_from_slice(&[0.5, 0.5, -0.5, 0.5]);
    world.rebuild(&at, &[2.0, 0.5, 1.0, 1.0, 3.0, -2.0, 0.0]);
    let start = world.centre_of_mass();
    hold(&mut world, &[], STEP);
    let first = world.centre_of_mass();
    hold(&mut world, &[], 1.0 - STEP);
    let end = world.centre_of_mass();
    let speed: [f32; 3] = std::array::from_fn(|axis| (first[axis] - start[axis]) / STEP);
    let expected = [start[0] + speed[0], start[1] + speed[1], start[2] + speed[2] - 9.81 / 2.0];
    assert_near("centre", &end, &expected, 0.03);
    let motion = velocities(&world);
    assert!(motion[3..6].iter().any(|speed| speed.abs() > 1.0), "{motion:?}");
}

#[test]
fn an_off_centre_free_robot_continues_from_its_numbers_bit_for_bit() {
    let at = [1.0, -2.0, 4.0, 0.5, 0.5, -0.5, 0.5, 0.3];
    let speeds = [0.1, 0.2, -0.3, 1.0, 2.0, -1.0, 0.5];
    let worlds = [world(LOPSIDED, ""), world(LOPSIDED, "")];
    assert_continues_bit_for_bit(worlds, &at, &speeds, &[]);
    // In the air, then on the floor.
    let worlds = [world(LOPSIDED, ""), world(LOPSIDED, "")];
    let at = [0.0, 0.0, 0.28, 1.0, 0.0, 0.0, 0.0, 0.1];
    assert_continues_bit_for_bit(worlds, &at, &[0.0; 7], &[]);
}

#[test]
fn a_frictionless_shape_slides_on_and_masks_decide_what_touches_the_floor() {
    let slid = |geom: &str| {
        let body = format!(
            "<body pos=\"0 0 0.1\"><freejoint/><geom type=\"box\" size=\"0.1 0.1 0.1\" {geom}/></body>"
        );
        let floor =
            "<geom type=\"plane\" size=\"1 1 1\" condim=\"1\" contype=\"2\" conaffinity=\"4\"/>";
        let mjcf = document(&body, "").replace("<geom type=\"plane\" size=\"1 1 1\"/>", floor);
        let mut world = world_of(&mjcf);
        let at = world.robot().rest().to_vec();
        world.rebuild(&at, &[1.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        hold(&mut world, &[], 0.5);
        let at = coordinates(&world);
        (at[0], at[2])
    };
    let (x, z) = slid("condim=\"1\" conaffinity=\"2\"");
    assert_near("frictionless", &[x, z], &[0.5, 0.1], 2e-3);
    let (x, z) = slid("condim=\"3\" contype=\"4\" conaffinity=\"0\"");
    assert_near("stopped by friction", &[x, z], &[1.0 / (2.0 * 9.81), 0.1], 1e-2);
    assert!(slid("contype=\"1\" conaffinity=\"1\"").1 < -1.0, "it falls through the floor");
}

/// As in MuJoCo: an outermost class is the main one, and several of them are one.
#[test]
fn outermost_defaults_hold_for_shapes_without_a_class() {
    let mass = |defaults: &str| {
        let body = "<body name=\"b\"><joint name=\"j\"/><geom size=\"0.1\"/></body>";
        let mjcf = document(body, "").replace("<worldbody>", &format!("{defaults}<worldbody>"));
        robot(&mjcf).unwrap().masses().map(|(_, mass, _)| mass).sum::<f32>()
    };
    let water = mass("");
    let named = "<default class=\"main\"><geom density=\"500\"/></default>";
    let inner = "<default class=\"\"><default class=\"c\"/></default>";
    assert_near(
        "density",
        &[mass(named), mass(&format!("{named}{inner}"))],
        &[water / 2.0; 2],
        1e-6,
    );
}

#[test]
fn what_is_left_out_is_listed() {
    let chain = "<body pos=\"0 0 1\"><joint/><geom size=\"0.1\"/>".repeat(3) + &"</body>".repeat(3);
    let mjcf = document(&chain, "");
    let left_out = |mjcf: &str, self_contacts| {
        let physics = Physics { self_contacts, ..Physics::default() };
        let robot = robot_with(mjcf, physics, &|path| Err(path.to_owned())).unwrap();
        robot.left_out().join("; ")
    };
    assert_eq!(left_out(&mjcf, None), "");
    // Those of a body and its child are not among them.
    let stated = left_out(&mjcf, Some(false));
    assert_eq!(stated, "links do not touch each other: contacts between 2 shapes");
    // Links of different trees always touch.
    assert_eq!(
        left_out(
            &document(&"<body pos=\"0 0 1\"><joint/><geom size=\"0.1\"/></body>".repeat(2), ""),
            Some(false)
        ),
        ""
    );
    let one_way = mjcf.replace("<geom size", "<geom conaffinity=\"0\" size");
    assert_eq!(left_out(&one_way, Some(false)), "");
    for (stated, expected) in [
        (
            "<option><flag refsafe=\"disable\" eulerdamp=\"enable\"/></option>",
            "the time constant of `solref` is at least two steps, as with the flag `refsafe`",
        ),
        (
            "<compiler fusestatic=\"true\"/>",
            "bodies without joints are not fused: their contacts are as with fusestatic=\"false\"",
        ),
        ("<compiler fusestatic=\"false\"/>", ""),
    ] {
        let mjcf = mjcf.replace("<worldbody>", &format!("{stated}<worldbody>"));
        assert_eq!(left_out(&mjcf, None), expected);
    }
}

#[test]
fn what_differs_of_integrators_servos_and_hulls_is_listed() {
    let body = "<body><joint name=\"j\"/><geom type=\"mesh\" mesh=\"m\"/></body>";
    let cube = "0 0 0 1 0 0 0 1 0 0 0 1 1 1 0 1 0 1 0 1 1 1 1 1";
    let mesh = format!("<asset><mesh name=\"m\" maxhullvert=\"8\" vertex=\"{cube}\"/></asset>");
    let servo = "<velocity joint=\"j\" kv=\"1\" ctrlrange=\"-1 1\"/>";
    let left_out = |from: &str, to: &str| {
        let mjcf = document(body, servo).replace("<worldbody>", &format!("{mesh}<worldbody>"));
        let mjcf = mjcf.replace("<option ", "<option integrator=\"implicitfast\" ");
        robot(&mjcf.replace(from, to)).unwrap().left_out().join("; ")
    };
    assert_eq!(left_out("", ""), "");
    assert_eq!(
        left_out("maxhullvert=\"8\"", "maxhullvert=\"6\""),
        "`maxhullvert` has no effect: 1 hulls have more corners"
    );
    assert_eq!(
        left_out("implicitfast", "Euler"),
        "the speed terms of servos are implicit, as with integrator=\"implicitfast\": 1 actuators"
    );
    assert_eq!(
        left_out("implicitfast", "implicit"),
        "the integrator is `implicitfast`: only single free bodies have derivatives of gyroscopic forces"
    );
    assert_eq!(
        left_out("<option ", "<option viscosity=\"0.1\" "),
        "the forces of the fluid are explicit, as with integrator=\"Euler\""
    );
}

#[test]
fn limits_in_qpos_are_those_of_the_document() {
    let body = "<body><joint name=\"j\" ref=\"0.5\" range=\"-1 1.5\"/><geom size=\"0.1\"/></body>";
    let robot = robot(&document(body, "<motor joint=\"j\" ctrlrange=\"-1 1\"/>")).unwrap();
    assert_eq!(robot.limits_in_qpos().collect::<Vec<_>>(), [Some([-1.0, 1.5])]);
    assert_eq!(robot.hinges().next(), Some(("j", Some([-1.5, 1.0]))));
}

#[test]
fn keyframes_that_move_mocap_bodies_are_listed() {
    let bodies = "<body mocap=\"true\"><geom size=\"0.1\"/></body><body><joint name=\"j\"/><geom size=\"0.1\"/></body>";
    let servo = "<motor joint=\"j\" ctrlrange=\"-1 1\"/>";
    let left_out = |key: &str| {
        let keys = format!("</worldbody><keyframe><key qpos=\"0.1\"/><key {key}/></keyframe>");
        let mjcf = document(bodies, servo).replace("</worldbody>", &keys);
        robot(&mjcf).unwrap().left_out().join("; ")
    };
    assert_eq!(left_out("qpos=\"0\""), "");
    let moved =
        "`mpos` or `mquat` has no effect, mocap bodies stay where they are: 1 of the keyframes";
    assert_eq!(left_out("mpos=\"0 0 1\""), moved);
}

#[test]
fn a_runge_kutta_step_of_rotations_in_space_is_listed_as_less_accurate() {
    let left_out = |joint: &str, integrator: &str| {
        let body = format!("<body pos=\"0 0 1\">{joint}<geom size=\"0.1\"/></body>");
        let option = format!("<option integrator=\"{integrator}\" ");
        let mjcf = document(&body, "").replace("<option ", &option);
        robot(&mjcf).unwrap().left_out().join("; ")
    };
    let listed = "the Runge-Kutta step of rotations in space has an error of second order, MuJoCo's of fourth: 1 free and \
        ball joints";
    for (joint, integrator, expected) in [
        ("<freejoint/>", "RK4", listed),
        ("<joint type=\"ball\"/>", "RK4", listed),
        ("<joint/>", "RK4", ""),
        ("<freejoint/>", "Euler", ""),
    ] {
        assert_eq!(left_out(joint, integrator), expected, "{joint} {integrator}");
    }
}
