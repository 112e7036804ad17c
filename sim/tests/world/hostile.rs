//! States from untrusted sources.

use crate::{environments, step};
use sim::{SimError, State, StateError};

fn refusal(change: impl Fn(&mut Vec<u8>)) -> StateError {
    let mut world = environments("halfcheetah-2x3", 1);
    world.reset(0, 4, 500, [2; 32]).unwrap();
    step(&mut *world, &[0.1; 6]);
    let before = world.encode(0).unwrap();
    let mut bytes = before.clone();
    change(&mut bytes);
    let refused = world.restore(0, &bytes).unwrap_err();
    assert_eq!(world.encode(0).unwrap(), before, "a rejected state changes nothing");
    let SimError::State(error) = refused else { panic!("{refused}") };
    error
}

fn set(bytes: &mut [u8], at: usize, value: [u8; 4]) {
    bytes[at..at + 4].copy_from_slice(&value);
}

#[test]
fn every_invalid_field_of_a_state_is_rejected_by_name() {
    let numbers = 28;
    assert!(matches!(refusal(Vec::clear), StateError::Length { got: 0, expected: 100, .. }));
    assert!(matches!(refusal(|b| b.push(0)), StateError::Length { got: 101, .. }));
    assert_eq!(refusal(|b| b[0] = 0), StateError::Mark);
    assert!(matches!(refusal(|b| b[4] = 9), StateError::Version { got: 9, expected: 1 }));
    assert!(matches!(refusal(|b| b[8] ^= 1), StateError::Kind { .. }));
    assert!(matches!(
        refusal(|b| set(b, 24, 1001_u32.to_le_bytes())),
        StateError::Limit { limit: 1001, longest: 1000 }
    ));
    assert!(matches!(refusal(|b| set(b, 24, [0; 4])), StateError::Limit { limit: 0, .. }));
    assert_eq!(
        refusal(|b| set(b, 20, 500_u32.to_le_bytes())),
        StateError::Over { step: 500, limit: 500 }
    );
    assert_eq!(
        refusal(|b| set(b, numbers, f32::NAN.to_le_bytes())),
        StateError::NotFinite { field: "coordinate", index: 0 }
    );
    assert_eq!(
        refusal(|b| set(b, numbers + 4 * 10, f32::INFINITY.to_le_bytes())),
        StateError::NotFinite { field: "velocity", index: 1 }
    );
    assert!(matches!(
        refusal(|b| set(b, numbers + 4 * 17, (-2e3_f32).to_le_bytes())),
        StateError::Beyond { field: "velocity", index: 8, .. }
    ));
    assert!(matches!(
        refusal(|b| set(b, numbers + 4 * 3, 9.0_f32.to_le_bytes())),
        StateError::Beyond { field: "coordinate", index: 3, .. }
    ));
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
