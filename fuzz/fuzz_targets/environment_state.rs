//! Encoded environment states from untrusted hands: refused ones change nothing, the others lead to a world that can be
//! stepped and whose numbers are finite.
#![no_main]

use std::cell::RefCell;

use fuzz::{TASKS, world};
use libfuzzer_sys::fuzz_target;
use sim::{EnvironmentBatch, Outcome};

thread_local! {
    static WORLDS: RefCell<Vec<Box<dyn EnvironmentBatch>>> = RefCell::new(TASKS.map(world).into());
}

fuzz_target!(|data: &[u8]| {
    let Some((task, bytes)) = data.split_first() else { return };
    WORLDS.with_borrow_mut(|worlds| {
        let at = usize::from(*task) % worlds.len();
        take_up(&mut *worlds[at], bytes);
    });
});

fn take_up(world: &mut dyn EnvironmentBatch, bytes: &[u8]) {
    let before = encode(world);
    if world.restore(0, bytes).is_err() {
        assert_eq!(encode(world), before, "a refused state changes nothing");
        return;
    }
    assert!(same_state(&encode(world), bytes), "a state is encoded as it came");
    let sizes = world.description().agents.iter().map(|agent| agent.action.size);
    let actions = vec![0.0; sizes.sum()];
    let mut outcome = [Outcome::default()];
    world.step(&actions, &mut outcome).expect("zero is an action everywhere");
    assert!(outcome[0].reward.is_finite() && !(outcome[0].terminated && outcome[0].truncated));
    let mut state = vec![0.0; world.description().state.len()];
    world.state(0, &mut state);
    assert!(state.iter().all(|number| number.is_finite()));
}

fn encode(world: &dyn EnvironmentBatch) -> Vec<u8> {
    world.encode(0).expect("the simulator encodes")
}

/// Equal up to the sign of a zero, which a game of whole numbers does not keep.
fn same_state(encoded: &[u8], given: &[u8]) -> bool {
    const HEADER_BYTES: usize = 28;
    let number = |bytes: &[u8; 4]| f32::from_le_bytes(*bytes);
    let numbers = |bytes: &[u8]| {
        bytes[HEADER_BYTES..].as_chunks::<4>().0.iter().map(number).collect::<Vec<_>>()
    };
    encoded[..HEADER_BYTES] == given[..HEADER_BYTES] && numbers(encoded) == numbers(given)
}
