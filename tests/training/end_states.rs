//! Encoded states of environments: those of an actor are checked before they count, and a run continues from a checkpoint with
//! invalid ones.

use learner::lease::end_states::StateReader;
use learner::lease::slots::ConnectionId;
use policy::CoreKind;
use proto::{PushHeader, Reason, Refusal, TrajectoryChunk};

use crate::actor::push;
use crate::one_slot::{exchange, lease, origin, rolled_out};
use crate::settings::{launch_in, resumed};
use crate::{hopper, train};

/// The answer to the last chunk of a slot whose end states `change` has changed.
fn answer(change: impl Fn(&mut TrajectoryChunk)) -> Option<Refusal> {
    let (run, policy, mut chunks) = rolled_out(CoreKind::Gru);
    let (exchange, connection) = (exchange(run, &policy), ConnectionId(1));
    let lease = lease(&exchange, connection);
    change(chunks.last_mut().unwrap());
    let mut answer = None;
    for chunk in chunks {
        let header = PushHeader::of(&lease, chunk.digest(&origin()));
        answer = push(&exchange, connection, &header, chunk).err();
    }
    answer
}

/// The two end states of a chunk.
fn states(chunk: &mut TrajectoryChunk) -> &mut [Vec<u8>] {
    &mut chunk.end.as_mut().unwrap().environments
}

#[test]
fn end_states_that_cannot_be_decoded_or_do_not_continue_the_episodes_are_refused() {
    assert_eq!(answer(|_| {}), None);
    type Change = fn(&mut TrajectoryChunk);
    let changes: [(Change, usize, &str); 4] = [
        (|chunk| states(chunk)[1].truncate(9), 1, "it has 9 bytes"),
        (|chunk| states(chunk)[0][12] = 7, 0, "step 5 of 10 of episode 7"),
        (|chunk| states(chunk)[1][20] = 9, 1, "its environment is at step 8 of 10 of episode 0"),
        (|chunk| states(chunk).swap(0, 1), 0, "its environment is at step 5 of 10 of episode 1"),
    ];
    for (change, environment, detail) in changes {
        let refusal = answer(change).unwrap();
        let field = format!("chunk.end.environments[{environment}]");
        assert_eq!((refusal.reason, refusal.field), (Reason::BadValue, field));
        assert!(refusal.detail.contains(detail), "{}", refusal.detail);
    }
}

#[test]
fn a_run_goes_on_from_a_checkpoint_whose_states_nothing_can_restore_with_the_same_result_each_time()
{
    let finished = |decoder: StateReader| {
        let folder = tempfile::tempdir().unwrap();
        train(launch_in(folder.path(), 2), 2);
        let mut launch = resumed(launch_in(folder.path(), 4));
        launch.states = decoder;
        train(launch, 2).state_sha256
    };
    // A resume first reads the states of the checkpoint, one for each of the four environments.
    let rejects = || {
        let strict = hopper::states();
        let checked = std::sync::atomic::AtomicUsize::new(0);
        StateReader::new(move |state| {
            match checked.fetch_add(1, std::sync::atomic::Ordering::Relaxed) {
                0..4 => Err("nothing can restore it".to_owned()),
                _ => strict.decode(state),
            }
        })
    };
    let [undisturbed, first, second] = [hopper::states(), rejects(), rejects()].map(finished);
    assert_eq!(first, second);
    assert_ne!(first, undisturbed);
}
