//! Safetensors files, and policies in them, as the learner broadcasts them and a checkpoint keeps them. A policy that is
//! taken in must be able to act.
#![no_main]

use libfuzzer_sys::fuzz_target;
use policy::arrays::{from_safetensors, sha256, to_safetensors};
use policy::{ActorPolicy, PolicySnapshot, Scratch};

/// A policy that needs more numbers than this is not run; what it takes is in its arrays.
const MOST_NUMBERS: usize = 1 << 20;

fuzz_target!(|data: &[u8]| {
    if let Ok((arrays, metadata)) = from_safetensors(data) {
        let bytes = to_safetensors(&arrays, &metadata).expect("what was read can be written");
        let (again, same) = from_safetensors(&bytes).expect("what was written can be read");
        // Hashes, because a number that is none does not equal itself.
        assert_eq!((sha256(&again), same), (sha256(&arrays), metadata));
    }
    if let Ok(snapshot) = PolicySnapshot::from_bytes(data) {
        let bytes = snapshot.to_bytes().expect("what was read can be written");
        let again = PolicySnapshot::from_bytes(&bytes).expect("what was written can be read");
        assert_eq!(again.to_bytes().expect("as before"), bytes);
        snapshot.agents.iter().for_each(act);
    }
});

fn act(policy: &ActorPolicy) {
    let sizes = [policy.observation_size(), policy.hidden_size(), policy.output_size()];
    if sizes.iter().any(|size| *size > MOST_NUMBERS) {
        return;
    }
    let [observation, mut hidden, mut output] = sizes.map(|size| vec![0.0; size]);
    policy.forward(1, &observation, &mut hidden, &mut output, &mut Scratch::default());
    let mut action = vec![0.0; policy.action_size()];
    policy.mode(&output, &mut action);
    let _density = policy.log_prob(&output, &action);
}
