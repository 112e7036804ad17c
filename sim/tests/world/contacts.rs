//! Contacts after a rebuild. Colliders must be at the links' poses, or the first step misses the floor.

use crate::{cheetah, coordinates, random_actions, seeded, velocities};

#[test]
fn rebuilt_contact_states_keep_their_contacts() {
    let (mut rng, mut actions) = (seeded(11), [0.0; 6]);
    let (mut straight, mut rebuilt) = (cheetah(), cheetah());
    let (mut touching, mut kept) = (0, 0);
    while touching < 200 {
        for _ in 0..7 {
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
    println!("{kept} of {touching} contact states kept their contact");
    assert!(kept * 100 >= touching * 95, "{kept} of {touching} contact states kept their contact");
}

#[test]
fn the_floor_supports_the_whole_weight_of_the_cheetah() {
    let mut world = cheetah();
    for _ in 0..200 {
        world.step(&[0.0; 6]);
    }
    // The robot has 14 kg: the impulse of one physics step is m g h.
    let weight = 14.0 * 9.81 * 0.01;
    let impulse = world.contact_impulse();
    println!("{impulse} N s against {weight}");
    assert!((impulse - weight).abs() < 0.05 * weight, "{impulse} N s against {weight}");
    assert!(world.lowest_point() > -0.01);
}
