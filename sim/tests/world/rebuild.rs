//! Reset and restore: later steps depend only on the encoded state and the actions.

use crate::{environments, key, random_actions, seeded, step};
use sim::EnvironmentBatch;

fn bits(world: &dyn EnvironmentBatch, environment: usize) -> Vec<u8> {
    world.encode(environment).unwrap()
}

#[test]
fn a_reset_world_equals_a_fresh_one_bit_for_bit_over_a_thousand_steps() {
    let (mut used, mut fresh) =
        (environments("halfcheetah-6x1", 1), environments("halfcheetah-6x1", 1));
    let (mut rng, mut actions) = (seeded(5), [0.0; 6]);
    for _ in 0..500 {
        random_actions(&mut rng, &mut actions);
        step(&mut *used, &actions);
    }
    used.reset(0, 7, 1000, [6; 32]).unwrap();
    fresh.reset(0, 7, 1000, [6; 32]).unwrap();
    for index in 0..1000 {
        random_actions(&mut rng, &mut actions);
        assert_eq!(step(&mut *used, &actions), step(&mut *fresh, &actions), "step {index}");
        assert_eq!(bits(&*used, 0), bits(&*fresh, 0), "step {index}");
    }
}

#[test]
fn two_restores_of_the_same_bytes_continue_identically_in_any_position() {
    let mut source = environments("halfcheetah-2x3", 1);
    let (mut rng, mut actions) = (seeded(8), [0.0; 6]);
    source.reset(0, 3, 900, key(&mut rng)).unwrap();
    for _ in 0..137 {
        random_actions(&mut rng, &mut actions);
        step(&mut *source, &actions);
    }
    let bytes = source.encode(0).unwrap();
    let mut slot = environments("halfcheetah-2x3", 3);
    source.restore(0, &bytes).unwrap();
    slot.restore(2, &bytes).unwrap();
    assert_eq!(bits(&*slot, 2), bytes, "a restored state encodes to its own bytes");
    let position = slot.position(2);
    assert_eq!((position.episode, position.step), (3, 137));
    let mut outcome = [sim::Outcome::default(); 3];
    for index in 137..900 {
        random_actions(&mut rng, &mut actions);
        let mut joint = [0.5; 18];
        joint[12..].copy_from_slice(&actions);
        slot.step(&joint, &mut outcome).unwrap();
        assert_eq!(outcome[2], step(&mut *source, &actions));
        assert_eq!(bits(&*slot, 2), bits(&*source, 0), "step {index}");
        assert_eq!(outcome[2].truncated, index == 899);
    }
}

#[test]
fn a_restored_episode_stays_close_to_the_uninterrupted_one() {
    let (mut straight, mut cut) =
        (environments("halfcheetah-2x3", 1), environments("halfcheetah-2x3", 1));
    let (mut rng, mut actions) = (seeded(9), [0.0; 6]);
    let (mut worst, mut sum, states) = (0.0_f32, 0.0, 300);
    for episode in 0..states {
        straight.reset(0, episode, 1000, key(&mut rng)).unwrap();
        for _ in 0..20 {
            random_actions(&mut rng, &mut actions);
            step(&mut *straight, &actions);
        }
        cut.restore(0, &straight.encode(0).unwrap()).unwrap();
        random_actions(&mut rng, &mut actions);
        step(&mut *straight, &actions);
        step(&mut *cut, &actions);
        let pair = [
            crate::coordinates(straight.world(0).unwrap()),
            crate::coordinates(cut.world(0).unwrap()),
        ];
        let off = pair[0].iter().zip(&pair[1]).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        worst = worst.max(off);
        sum += off;
    }
    let mean = sum / states as f32;
    println!("after one step of full random torque: mean {mean} rad, largest {worst} rad");
    // Only the contact impulses with which the solver's single iteration starts differ.
    assert!(mean < 0.006 && worst < 0.1, "mean {mean} rad, largest {worst} rad");
}

#[test]
fn environments_can_be_sent_to_another_thread() {
    let mut world = environments("halfcheetah-2x3", 1);
    let here = step(&mut *environments("halfcheetah-2x3", 1), &[0.3; 6]);
    let there = std::thread::Builder::new()
        .name("stepping".to_owned())
        .spawn(move || step(&mut *world, &[0.3; 6]))
        .unwrap();
    assert_eq!(there.join().unwrap(), here);
}

#[test]
fn the_probe_is_repeatable_and_finite() {
    let probe = sim::probe();
    assert_eq!(probe, sim::probe());
    assert!(probe.len() > 100_000, "{}", probe.len());
    assert!(probe.chunks_exact(4).all(|b| f32::from_le_bytes(b.try_into().unwrap()).is_finite()));
}
