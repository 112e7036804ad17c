//! Forces from outside and conditions of an episode, compared with MuJoCo and with changed models.

use rapier3d::math::Vector;

use super::{document, motion, world_of};
use crate::world::{EpisodeConditions, World};

/// A double pendulum whose lower link has a bend and a motor of 2 N m.
fn pendulum(lower: &str) -> World {
    let bodies = format!(
        "<body name=\"upper\" pos=\"0 0 2\"><joint name=\"s\" axis=\"0 1 0\" damping=\"0.2\"/>\
         <geom type=\"capsule\" size=\"0.05\" fromto=\"0 0 0 0 0 -0.5\"/>\
         <body name=\"lower\" pos=\"0 0 -0.5\"><joint name=\"e\" axis=\"0 1 0\" damping=\"0.1\"/>\
         {lower}</body></body>"
    );
    let motor = "<motor joint=\"e\" gear=\"2\" ctrlrange=\"-1 1\"/>";
    world_of(&document(&bodies, motor))
}

const CAPSULE: &str = "<geom type=\"capsule\" size=\"0.05\" fromto=\"0 0 0 0.2 0 -0.4\"/>";

/// Angles after 0.2 s with half the motor's torque.
fn swung(mut world: World, force: Vector, payload: f32) -> [f32; 2] {
    let lower = world.robot().masses().position(|(link, ..)| link == "lower").unwrap();
    let hinges = world.robot().hinges().count();
    world.set_conditions(EpisodeConditions {
        friction: 1.0,
        gravity: None,
        rises: Vec::new(),
        payloads: vec![(lower, payload)],
        motor_strengths: vec![1.0],
        joint_dampings: vec![1.0; hinges],
    });
    world.rebuild(&[0.0; 2], &[0.0; 2]);
    world.push(&[(lower, force)]);
    for _ in 0..200 {
        assert!(world.step(&[0.5]));
    }
    motion(&world).0.try_into().unwrap()
}

#[test]
fn a_force_and_a_payload_on_a_link_have_mujocos_effect() {
    // MuJoCo 4.0.0: `qpos` after 200 steps of 0.001 s with `xfrc_applied`, or 1 kg added to `body_mass`.
    for (force, payload, expected) in [
        (Vector::ZERO, 0.0, [-0.144_444, 0.623_728]),
        (Vector::new(5.0, 0.0, 3.0), 0.0, [-0.162_378, 0.587_182]),
        (Vector::ZERO, 1.0, [-0.163_105, 0.683_797]),
    ] {
        let angles = swung(pendulum(CAPSULE), force, payload);
        for (angle, expected) in angles.iter().zip(expected) {
            assert!((angle - expected).abs() < 1e-5, "{force} {payload}: {angles:?}");
        }
    }
}

#[test]
fn a_payload_is_the_model_with_that_mass_at_the_links_mass_centre() {
    let inertial = |mass| {
        let moments = "diaginertia=\"0.01 0.02 0.015\"";
        pendulum(&format!("<inertial pos=\"0.1 0 -0.2\" mass=\"{mass}\" {moments}/>{CAPSULE}"))
    };
    let loaded = swung(inertial(1.0), Vector::ZERO, 3.0);
    assert_eq!(loaded, swung(inertial(4.0), Vector::ZERO, 0.0));
    assert_ne!(loaded, swung(inertial(1.0), Vector::ZERO, 0.0));
}
