//! States from untrusted sources.

use crate::{environments, step};
use sim::{SimError, State};

fn refusal(change: impl Fn(&mut Vec<u8>)) -> String {
    let mut world = environments("halfcheetah-2x3", 1);
    world.reset(0, 4, 500, [2; 32]).unwrap();
    step(&mut *world, &[0.1; 6]);
    let before = world.encode(0).unwrap();
    let mut bytes = before.clone();
    change(&mut bytes);
    let refused = world.restore(0, &bytes).unwrap_err();
    assert_eq!(world.encode(0).unwrap(), before, "a rejected state changes nothing");
    let SimError::State(error) = refused else { panic!("{refused}") };
    error.to_string()
}

fn set(bytes: &mut [u8], at: usize, value: [u8; 4]) {
    bytes[at..at + 4].copy_from_slice(&value);
}

#[test]
fn every_invalid_field_of_a_state_is_rejected_by_name() {
    let numbers = 28;
    let with = |at: usize, number: f32| refusal(|b| set(b, at, number.to_le_bytes()));
    for (line, expected) in [
        (refusal(Vec::clear), "it has 0 bytes; a state of rapier/halfcheetah has 100"),
        (refusal(|b| b.push(0)), "it has 101 bytes; a state of rapier/halfcheetah has 100"),
        (refusal(|b| b[0] = 0), "it does not start with the magic bytes of a state"),
        (refusal(|b| b[4] = 9), "its layout version is 9; this program reads 1"),
        (refusal(|b| b[8] ^= 1), "it is not a state of rapier/halfcheetah"),
        (
            refusal(|b| set(b, 24, 1001_u32.to_le_bytes())),
            "its episode limit is 1001; it must be 1 to 1000",
        ),
        (refusal(|b| set(b, 24, [0; 4])), "its episode limit is 0; it must be 1 to 1000"),
        (refusal(|b| set(b, 20, 500_u32.to_le_bytes())), "its episode is over: step 500 of 500"),
        (with(numbers, f32::NAN), "coordinate 0 is not finite"),
        (with(numbers + 4 * 10, f32::INFINITY), "velocity 1 is not finite"),
        (with(numbers + 4 * 17, -2e3), "velocity 8 is -2000; it must be between "),
        (with(numbers + 4 * 3, 9.0), "coordinate 3 is 9; it must be between "),
    ] {
        assert!(line.starts_with(expected), "{line}");
    }
}

#[test]
fn a_changed_byte_is_rejected_or_gives_a_finite_state() {
    let mut world = environments("halfcheetah-6x1", 1);
    let bounds = world.state_bounds().unwrap().clone();
    let bytes = world.encode(0).unwrap();
    for at in 0..bytes.len() {
        for flip in [0x01, 0x80, 0xff] {
            let mut hostile = bytes.clone();
            hostile[at] ^= flip;
            let restored = world.restore(0, &hostile);
            assert_eq!(
                State::from_bytes(&hostile, &bounds).is_ok(),
                restored.is_ok(),
                "byte {at} ^ {flip}"
            );
            if restored.is_ok() {
                step(&mut *world, &[1.0; 6]);
                assert!(
                    State::from_bytes(&world.encode(0).unwrap(), world.state_bounds().unwrap())
                        .is_ok()
                );
            }
        }
    }
}
