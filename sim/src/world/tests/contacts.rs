//! Tests of contacts, joint limits and dry friction against motion that MuJoCo computes.

use super::{World, motion, world_of};

/// Models with their motion in MuJoCo.
fn reference() -> serde_json::Value {
    serde_json::from_str(include_str!("../../../tests/data/mujoco-contacts.json")).unwrap()
}

pub(super) fn numbers(value: &serde_json::Value) -> Vec<f32> {
    value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap() as f32).collect()
}

/// Largest difference of two motions' coordinates; a quaternion and its negative are the same rotation.
fn difference(world: &World, got: &[f32], expected: &[f32]) -> f32 {
    let orientations = &world.robot().layout.orientations;
    let sign = |index: usize| {
        let turn =
            orientations.iter().find(|own| (own.coordinate..own.coordinate + 4).contains(&index));
        let product = |first: usize| (first..first + 4).map(|k| got[k] * expected[k]).sum::<f32>();
        turn.map_or(1.0, |own| product(own.coordinate).signum())
    };
    let differences = got.iter().zip(expected).enumerate();
    differences.map(|(index, (a, b))| (a - sign(index) * b).abs()).fold(0.0, f32::max)
}

fn start(world: &mut World, speeds: &[f32]) {
    let (at, mut velocities) = motion(world);
    velocities[..speeds.len()].copy_from_slice(speeds);
    world.rebuild(&at, &velocities);
}

/// Plays the models of a reference, whose coordinates differ by less than `most(name)`.
pub(super) fn assert_moves_as_in_mujoco(reference: &serde_json::Value, most: impl Fn(&str) -> f32) {
    let steps = numbers(&reference["steps"]);
    for (name, model) in reference["models"].as_object().unwrap() {
        let mut world = world_of(model["mjcf"].as_str().unwrap());
        start(&mut world, &numbers(&model["speeds"]));
        let controls = model.get("controls").map(numbers).unwrap_or_default();
        let mut step = 0;
        for (last, expected) in steps.iter().zip(model["coordinates"].as_array().unwrap()) {
            while step < *last as u32 {
                assert!(world.step(&controls), "{name}");
                step += 1;
            }
            let (got, expected) = (motion(&world).0, numbers(expected));
            let off = difference(&world, &got, &expected);
            assert!(off < most(name), "{name}, step {step}, {off}: {got:?} against {expected:?}");
        }
    }
}

#[test]
fn contacts_limits_and_dry_friction_move_robots_as_in_mujoco() {
    assert_moves_as_in_mujoco(&reference(), |name| match name {
        // Both engines choose among many points.
        "box on a height field" => 1e-2,
        // MuJoCo's normal is rough where the centre of the ball is in the ground.
        "ball that sinks deep into a height field" => 5e-2,
        "wheels that touch" => 2e-4,
        // MuJoCo's normals of these shapes are off by 0.004 rad.
        "cylinder on an ellipsoid" => 2e-2,
        // It slides and turns for a second.
        "box with a pair of friction=\"0.3\"" => 2e-2,
        "capsule on an ellipsoid"
        | "capsule on a tilted cylinder"
        | "capsule on a height field" => 5e-3,
        name if name.contains("finger") => 1e-3,
        _ => 5e-5,
    });
}

/// MuJoCo 4.0.0: after 0.1 s, the upper one of two parallel capsules of 3 cm is 9.72 mm above the lower one.
#[test]
fn a_small_capsule_rests_along_another_one() {
    let mut world = world_of(
        "<mujoco><worldbody><geom type=\"capsule\" size=\".005 .01\" euler=\"90 0 0\"/>\
         <body name=\"b\" pos=\"0 0 .011\" euler=\"90 0 30\"><freejoint name=\"b\"/>\
         <geom type=\"capsule\" size=\".005 .01\" mass=\".01\"/></body></worldbody></mujoco>",
    );
    start(&mut world, &[]);
    for _ in 0..50 {
        assert!(world.step(&[]));
    }
    let height = motion(&world).0[2];
    assert!((height - 0.00972).abs() < 5e-5, "{height}");
}
