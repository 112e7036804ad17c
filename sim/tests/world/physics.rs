//! Masses, friction, free flight and energy of the HalfCheetah.

use crate::{cheetah, coordinates, random_actions, seeded, velocities};

fn close(got: f64, expected: f64) -> bool {
    (got - expected).abs() < 1e-3 * expected.abs()
}

#[test]
fn masses_and_inertias_are_equal_to_mujocos() {
    let expected = [
        ("torso", 6.250209, [0.01796092, 0.88565545, 0.89711769]),
        ("bthigh", 1.543515, [0.00157602, 0.01684434, 0.01684434]),
        ("bshin", 1.587448, [0.0016225, 0.01826742, 0.01826742]),
        ("bfoot", 1.095397, [0.00110191, 0.00635242, 0.00635242]),
        ("fthigh", 1.438075, [0.00146447, 0.01373964, 0.01373964]),
        ("fshin", 1.200837, [0.00121347, 0.00822211, 0.00822211]),
        ("ffoot", 0.884519, [0.0008788, 0.00352911, 0.00352911]),
    ];
    let world = cheetah();
    assert_eq!(world.robot().masses().count(), expected.len());
    for ((name, mass, inertia), (link, kilograms, moments)) in world.robot().masses().zip(expected)
    {
        assert_eq!(name, link);
        assert!(close(f64::from(mass), kilograms), "{name}: {mass} kg against {kilograms}");
        for (got, expected) in inertia.into_iter().zip(moments) {
            assert!(close(f64::from(got), expected), "{name}: {got} kg m^2 against {expected}");
        }
    }
    let total: f32 = world.robot().masses().map(|(_, mass, _)| mass).sum();
    assert!(close(f64::from(total), 14.0));
}

#[test]
fn a_cheetah_sliding_at_four_metres_a_second_stops_after_two_metres() {
    let mut world = cheetah();
    for _ in 0..100 {
        world.step(&[0.0; 6]);
    }
    let settled = coordinates(&world);
    let mut sliding = vec![0.0; 9];
    sliding[0] = 4.0;
    world.rebuild(&settled, &sliding);
    for _ in 0..100 {
        world.step(&[0.0; 6]);
    }
    let distance = coordinates(&world)[0] - settled[0];
    println!("slid {distance} m");
    assert!((1.8..2.3).contains(&distance), "slid {distance} m; MuJoCo 2.08");
    assert!(velocities(&world)[0].abs() < 0.02);
}

#[test]
fn the_mass_centre_of_a_spinning_cheetah_in_flight_follows_a_parabola() {
    let mut world = cheetah();
    let mut at = vec![0.0; 9];
    at[1] = 30.0;
    let mut motion = vec![0.0; 9];
    motion[..3].copy_from_slice(&[2.0, 1.0, 3.0]);
    world.rebuild(&at, &motion);
    let start = world.centre_of_mass();
    world.step(&[0.0; 6]);
    let first = world.centre_of_mass();
    let steps = 40;
    for _ in 1..steps {
        world.step(&[0.0; 6]);
    }
    let end = world.centre_of_mass();
    // The start velocity of the mass centre comes from the first step: v = dx/dt, and dz/dt + g (dt + h) / 2, because
    // the semi-implicit integrator with h = 0.01 s falls g h / 2 too far in each second.
    let (dt, h, g) = (0.05_f32, 0.01_f32, 9.81_f32);
    let seconds = steps as f32 * dt;
    let vx = (first[0] - start[0]) / dt;
    let vz = (first[2] - start[2]) / dt + g * (dt + h) / 2.0;
    let flight =
        [start[0] + vx * seconds, 0.0, start[2] + vz * seconds - g * seconds * (seconds + h) / 2.0];
    let error = (0..3).map(|axis| (end[axis] - flight[axis]).abs()).fold(0.0, f32::max);
    println!("off the parabola by {error} m after {seconds} s");
    assert!(error < 0.03, "{end:?} against {flight:?}");
    assert!(velocities(&world)[2].abs() > 0.5, "the robot still spins");
}

#[test]
fn without_control_energy_never_rises() {
    let mut rng = seeded(3);
    let (mut worst, mut fallen) = (f64::NEG_INFINITY, 0.0);
    for _ in 0..40 {
        let mut world = cheetah();
        let (mut at, mut motion) = ([0.0; 9], [0.0; 9]);
        random_actions(&mut rng, &mut at);
        random_actions(&mut rng, &mut motion);
        let mut at = at.map(|number| 0.3 * number);
        let motion = motion.map(|number| 3.0 * number);
        world.rebuild(&at, &motion);
        // A start inside the floor would add energy that no spring contains.
        at[1] -= world.lowest_point();
        world.rebuild(&at, &motion);
        let mut energy = world.mechanical_energy();
        for _ in 0..60 {
            world.step(&[0.0; 6]);
            let now = world.mechanical_energy();
            worst = worst.max(now - energy);
            fallen += energy - now;
            energy = now;
        }
    }
    println!("largest rise {worst} J, mean loss {} J an episode", fallen / 40.0);
    assert!(worst < 0.5, "rose by {worst} J in a step");
    assert!(fallen > 40.0);
}
